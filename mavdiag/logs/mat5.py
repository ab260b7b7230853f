"""Numeric matrices out of MATLAB files of version 5, as far as a file reaches.

Layout (MathWorks, "MAT-File Format"): a header of 128 bytes, then elements of a tag (u32 type, u32 bytes) and their
data. A compressed element holds one zlib stream with one matrix element inside; a matrix holds array flags,
dimensions, name and its real part, column after column. `scipy.io.loadmat` gives nothing back from a file that is
cut off; here the whole columns before the cut are kept. The tests compare the two on sound files.
"""

import math
import struct
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import InputError
from mavdiag.telemetry import FloatArray

__all__ = ["Matrix", "is_mat", "read_matrices"]

HEADER_BYTES = 128
TAG_BYTES = 8
LITTLE, BIG = b"\x00\x01IM", b"\x01\x00MI"  # version 0x0100 and the mark of the byte order
NEWER = b"MATLAB 7.3"  # HDF5 behind the header of 128 bytes
COMPRESSED, MATRIX, DIMENSIONS, FLAGS, NAME = 15, 14, 5, 6, 1  # types of elements
NUMERIC_CLASSES = range(6, 16)  # mxDOUBLE_CLASS to mxUINT64_CLASS
COMPLEX = 0x0800  # of the array flags
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
HEAD_BYTES = 4096  # flags, dimensions and name of a matrix fit in them
MAX_BYTES = 2**28  # of all matrices as float64 (our choice): more than the longest recording has, twice; more is damage


@dataclass(frozen=True, slots=True, eq=False)
class Matrix:
    """A matrix, one row a column of the file.

    values: (n, rows) as float64.
    note: what is wrong with it though it can be used; empty if nothing is.
    """

    values: FloatArray
    note: str = ""


@dataclass(frozen=True, slots=True)
class _Shape:
    """What stands before the values of a matrix: name, rows and columns, type of the values, where they begin."""

    name: str
    rows: int
    columns: int
    stored: np.dtype[np.generic]
    begin: int


def is_mat(head: bytes) -> bool:
    """Whether a file's first bytes are those of a MATLAB file of version 5 or 7.3."""
    return len(head) >= HEADER_BYTES and (head[124:128] in (LITTLE, BIG) or head.startswith(NEWER))


def read_matrices(data: bytes, wanted: Mapping[str, int]) -> dict[str, Matrix]:
    """The wanted matrices of a file, with whole columns up to where it was cut off.

    wanted: their names, and how many rows each must have. Other variables are passed over.
    Raises InputError if a file is of another version or damaged, or one of the matrices is absent or of another shape.
    """
    if data.startswith(NEWER):
        raise InputError("it is of MATLAB's version 7.3; save it again with -v7")
    if not is_mat(data):
        raise InputError("its first bytes are not those of a MATLAB file")
    order = "<" if data[124:128] == LITTLE else ">"
    found: dict[str, Matrix] = {}
    position, cut = HEADER_BYTES, False
    while position + TAG_BYTES <= len(data) and len(found) < len(wanted):
        kind, size = struct.unpack_from(order + "II", data, position)
        body = data[position + TAG_BYTES : position + TAG_BYTES + size]
        cut = len(body) < size
        if kind == COMPRESSED:
            _take(found, wanted, order, *_inflated(body, wanted.keys() - found, order, _left(found)))
        elif kind == MATRIX:
            _take(found, wanted, order, data[position : position + TAG_BYTES + size], "")
        position += TAG_BYTES + size
    lacking = [name for name in wanted if name not in found]
    if lacking:
        remedy = "it was cut off; download it again" if cut else "it is another recording, or cut off"
        raise InputError(f"it holds no {' and no '.join(lacking)}: {remedy}")
    return found


def _left(found: Mapping[str, Matrix]) -> int:
    """How many bytes further matrices may have."""
    return MAX_BYTES - sum(one.values.nbytes for one in found.values())


def _inflated(body: bytes, wanted: Collection[str], order: str, left: int) -> tuple[bytes, str]:
    """The content of a zlib stream as far as it reaches, and what is wrong with its end. Others' are not inflated.

    left: bytes that its values may have. Raises InputError for a stream that is damaged or of an impossible length.
    """
    stream = zlib.decompressobj(-zlib.MAX_WBITS)  # its 2 bytes of header and 4 of checksum are looked at here
    try:
        head = stream.decompress(body[2:], HEAD_BYTES)
        shape = _shape(head, order)
        if shape is None or shape.name not in wanted:
            return head, ""
        _check_size(shape, left)
        rest = b"" if stream.eof else stream.decompress(stream.unconsumed_tail, left)
    except zlib.error as error:
        raise InputError(f"its compressed data are damaged ({error}); download it again") from error
    if stream.unconsumed_tail and not stream.eof:
        raise InputError(f"{shape.name} is too long to be a flight")
    content = head + rest
    trailer = stream.unused_data[:4]
    if len(trailer) < 4:
        return content, "its checksum is cut off"
    if int.from_bytes(trailer, "big") != zlib.adler32(content):
        raise InputError(f"the checksum of {shape.name} is wrong; download it again")
    return content, ""


def _check_size(shape: _Shape, left: int) -> None:
    """Raise InputError for a matrix of more than so many bytes."""
    if 8 * shape.rows * shape.columns > left:
        raise InputError(f"{shape.name} is too long to be a flight")


def _take(found: dict[str, Matrix], wanted: Mapping[str, int], order: str, content: bytes, note: str) -> None:
    """Add a matrix element to what is found, if it is wanted. Raises InputError if it has another shape."""
    shape = _shape(content, order)
    if shape is None or shape.name not in wanted or shape.name in found:
        return
    if shape.rows != wanted[shape.name]:
        wrong = f"{shape.rows} x {shape.columns}"
        raise InputError(f"{shape.name} is {wrong}, but a recording has {wanted[shape.name]} rows, one a signal")
    _check_size(shape, _left(found))
    whole = min(shape.columns, (len(content) - shape.begin) // (shape.rows * shape.stored.itemsize))
    if whole < shape.columns:
        note = f"only {whole} of {shape.columns} samples are there: it was cut off"
    if whole <= 0:
        return
    values = np.frombuffer(content, shape.stored, whole * shape.rows, shape.begin).reshape(whole, shape.rows)
    with np.errstate(invalid="ignore"):
        found[shape.name] = Matrix(values.astype(np.float64), f"{shape.name}: {note}" if note else "")


def _shape(content: bytes, order: str) -> _Shape | None:
    """What a matrix element says of itself; None if it is no real numeric matrix, or ends before it has said so."""
    if len(content) < TAG_BYTES or struct.unpack_from(order + "I", content)[0] != MATRIX:
        return None
    position, parts = TAG_BYTES, []
    for wanted in (FLAGS, DIMENSIONS, NAME):
        kind, begin, size, position = _part(content, position, order)
        if kind != wanted or begin + size > len(content):
            return None
        parts.append(content[begin : begin + size])
    flags, dimensions, name = parts
    if len(flags) != 8 or len(dimensions) != 8:
        return None
    word = struct.unpack_from(order + "I", flags)[0]
    rows, columns = struct.unpack(order + "ii", dimensions)
    kind, begin, size, _ = _part(content, position, order)
    if kind not in STORED or word & 0xFF not in NUMERIC_CLASSES or word & COMPLEX or min(rows, columns) <= 0:
        return None
    stored: np.dtype[np.generic] = np.dtype(order + STORED[kind])
    if math.prod((rows, columns, stored.itemsize)) != size:
        return None
    return _Shape(name.decode("latin-1"), rows, columns, stored, begin)


def _part(content: bytes, position: int, order: str) -> tuple[int, int, int, int]:
    """Type, begin and size of the data element at a position, and where the next one starts; type 0 past the end."""
    if position + TAG_BYTES > len(content):
        return 0, position, 0, position
    kind, size = struct.unpack_from(order + "II", content, position)
    if kind >> 16:  # small data element: the size in the upper half, the data in the tag itself
        return kind & 0xFFFF, position + 4, kind >> 16, position + TAG_BYTES
    begin = position + TAG_BYTES
    return kind, begin, size, begin + -(-size // 8) * 8
