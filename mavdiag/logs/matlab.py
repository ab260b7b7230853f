"""Matrices out of MATLAB files of version 5, as far as a file reaches; `scipy.io` reads what they are.

Layout (MathWorks, "MAT-File Format"): a header of 128 bytes, then elements of a tag (u32 type, u32 bytes) and their
data. A file may be cut off and may claim any size, so its elements are inflated within a bound, and numbers are read
here: scipy's reader of these ends the process at a type that does not exist.
"""

import struct
import zlib
from collections.abc import Mapping
from importlib import import_module
from io import BytesIO

import numpy as np

from mavdiag.errors import InputError
from mavdiag.telemetry import FloatArray

HEADER_BYTES = 128
TAG_BYTES = 8
BYTE_ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}  # version 0x0100 and the mark of the byte order
NEWER = b"MATLAB 7.3"  # HDF5 behind the header of 128 bytes
COMPRESSED = 15  # type of an element
NUMERIC = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
COMPLEX = 0x800  # of a matrix's flags, the first word behind two tags
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}  # types of data
HEAD_BYTES = 4096  # flags, dimensions and name of a matrix fit in them
MAX_BYTES = 2**28  # of all matrices as float64 (our choice): more than the longest recording has, twice; more is damage

# What scipy lets through on damaged files.
_SCIPY_ERRORS = (ValueError, TypeError, LookupError, ArithmeticError, OSError, MemoryError, AttributeError)


def is_mat(head: bytes) -> bool:
    """Whether a file's first bytes are those of a MATLAB file of version 5 or 7.3."""
    return len(head) >= HEADER_BYTES and (head[124:128] in BYTE_ORDERS or head.startswith(NEWER))


def read_matrices(data: bytes, wanted: Mapping[str, int]) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """The wanted matrices (rows by name) of a file as (n, rows), and what is wrong with it, one sentence each.

    Raises InputError if a file is of another version or damaged, or a matrix is absent, of another shape or too long.
    """
    if data.startswith(NEWER):
        raise InputError("it is of MATLAB's version 7.3; save it again with -v7")
    if not is_mat(data):
        raise InputError("its first bytes are not those of a MATLAB file")
    header, order = data[:HEADER_BYTES], BYTE_ORDERS[data[124:128]]
    found: dict[str, FloatArray] = {}
    notes: list[str] = []
    position, left = HEADER_BYTES, MAX_BYTES
    while position + TAG_BYTES <= len(data) and len(found) < len(wanted):
        kind, size = struct.unpack_from(order + "II", data, position)
        begin, position = position, position + TAG_BYTES + size
        stream, element = None, data[begin:position]
        try:
            if kind == COMPRESSED:
                stream = zlib.decompressobj()
                element = stream.decompress(element[TAG_BYTES:], HEAD_BYTES)
            name, rows, columns = _claimed(header + element[:HEAD_BYTES])
            if name not in wanted or name in found:
                continue
            if rows != wanted[name]:
                raise InputError(f"{name} is {rows} x {columns}, but a recording has {wanted[name]} rows, one a signal")
            claimed = TAG_BYTES + int(struct.unpack_from(order + "I", element, 4)[0])
            if max(8 * rows * columns, claimed - HEAD_BYTES) > left:
                raise InputError(f"{name} is too long to be a flight")
            if stream:
                element += stream.decompress(stream.unconsumed_tail, claimed + 1)
        except zlib.error as error:
            raise InputError(f"its compressed data are damaged ({error}); download it again") from error
        values_at = 56 + (-(-len(name) // 8) * 8 if len(name) > 4 else 0)  # a short name stands in its tag
        if len(element) < values_at:
            continue
        type_of_data, flags = (struct.unpack_from(order + "I", element, at)[0] for at in (values_at - TAG_BYTES, 16))
        if type_of_data not in NUMBERS:
            raise InputError(f"{name} is damaged: its numbers are of no type; download it again")
        if flags & COMPLEX:
            raise InputError(f"{name} is of complex numbers: it is another recording")
        numbers = np.dtype(order + NUMBERS[type_of_data])
        whole = min(columns, (min(len(element), claimed) - values_at) // (rows * numbers.itemsize))
        if whole <= 0:
            continue
        if whole < columns:
            notes.append(f"{name}: only {whole} of {columns} samples are there: it was cut off")
        elif stream and not stream.eof:
            notes.append(f"{name}: its checksum is cut off")
        values = np.frombuffer(element, numbers, rows * whole, values_at).reshape(whole, rows)
        with np.errstate(invalid="ignore"):
            found[name] = values.astype(np.float64)
        left -= found[name].nbytes
    if lacking := [name for name in wanted if name not in found]:
        remedy = "it was cut off; download it again" if position > len(data) else "it is another recording, or cut off"
        raise InputError(f"it holds no {' and no '.join(lacking)}: {remedy}")
    return found, tuple(notes)


def _claimed(file: bytes) -> tuple[str, int, int]:
    """Name, rows and columns of the matrix of a file that holds one element; no name if it is no numeric matrix."""
    try:
        # Not at the start of a program that reads no such file; and its stubs know no file but those on disk.
        name, (rows, columns), kind = import_module("scipy.io").whosmat(BytesIO(file))[0]
        return (str(name), int(rows), int(columns)) if kind in NUMERIC and min(rows, columns) > 0 else ("", 0, 0)
    except _SCIPY_ERRORS:
        return "", 0, 0
