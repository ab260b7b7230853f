"""Files (edge): only regular files of a bounded size are read, and files are written atomically.

A `Shelf` puts arrays aside that are too many for the memory, and a `Column` those that come piece by piece.
"""

import ctypes
import errno
import mmap
import os
import re
import secrets
import stat
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.errors import InputError, UsageError

Arrays: TypeAlias = tuple[NDArray[Any], ...]

TOML_BYTES = 32 << 10  # the longest of ours has 7 kB; tomllib takes seconds for a larger one's worst (our choice)
TEXT_BYTES = 8 << 20  # baselines have some hundred kilobytes (our choice)
SHELF_BYTES = 8 << 20  # of arrays that a shelf keeps in memory before it opens its file (our choice)
COLUMN_BYTES = 8 << 20  # of a column that comes piece by piece, until it goes into a file (our choice)
COLUMN_ROWS = 512  # that it has room for at first: what a live link brings in two seconds (our choice)
COLLECT_AT = 20_000  # containers more than before; a tick of a full link makes some thousands (our choice; Python: 700)
KEPT = 8  # our choice: fewer are given back and faulted in again for each flight, and the most memory is the same
MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1  # options of mallopt(3)
MADV_COLLAPSE = 25  # of madvise(2), since Linux 6.1
HUGE_BYTES = 2 << 20  # the largest huge page: a larger one stays empty for the most part (our choice)
HUGE_S = 0.01  # in which memory is moved at a time, for nothing else is done meanwhile (our choice)
ROOM_BYTES = 50_000_000  # of a disk that recordings leave to journals and open inspections (our choice)
KIND_BYTES = 64  # of a file, which tell its kind (our choice)
WRITE_BYTES = 1 << 20  # that are written at a time: many together take three times as long (our choice)


@contextmanager
def open_regular(path: Path, most_bytes: int) -> Iterator[BinaryIO]:
    """A regular file of at most so many bytes: no device without end, no pipe to wait for. Raises InputError."""
    try:
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder; name a file") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    with file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path}: is not a regular file; name a file")
        if found.st_size > most_bytes:
            size = f"{found.st_size // 1024:,} KiB, and {most_bytes // 1024:,} KiB is the most that is read"
            raise InputError(f"{path}: is too large ({size})")
        try:
            yield file
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def read_text(path: Path, most_bytes: int = TEXT_BYTES) -> str:
    """The text of a file. Raises InputError, naming it, if it cannot be read."""
    try:
        with open_regular(path, most_bytes) as file:
            return file.read(os.fstat(file.fileno()).st_size).decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read (not UTF-8 text)") from error


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file. Raises InputError, naming it, if it cannot be used."""
    return parse_toml(read_text(path, TOML_BYTES), str(path))


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The content of a TOML text. name: of the file. Raises InputError, naming it, if it cannot be used."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"{name}: not TOML: nested too deep") from error
    except ValueError as error:  # a number of thousands of digits is one too
        raise InputError(f"{name}: not TOML: {error}") from error


def check_writable(path: Path) -> None:
    """Raise UsageError unless a file can be written here: new, or a regular one that may be replaced by a new one."""
    if str(path) == "-":
        raise UsageError("-: the standard output is no place for a file; name a file to write")
    if path.is_symlink() or (path.exists() and not path.is_file()):
        kind = "a symbolic link" if path.is_symlink() else "a folder" if path.is_dir() else "not a regular file"
        raise UsageError(f"{path}: is {kind}; name a file to write")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: cannot be written, there is no folder {path.parent}; make it, or name another file")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"{path}: cannot be written (no permission); name a folder you can write to")


def leave_room(file: BinaryIO) -> None:
    """Raise OSError if its disk has no room for more than what matters more than this file: see `ROOM_BYTES`."""
    disk = os.fstatvfs(file.fileno())
    if disk.f_blocks and disk.f_bavail * disk.f_frsize < ROOM_BYTES:  # some file systems do not tell
        raise OSError(errno.ENOSPC, f"less than {ROOM_BYTES // 1_000_000} MB are left there")


def check_apart(path: Path, *others: Path | None) -> None:
    """Raise UsageError if a file to write is one of the others of the command, by whatever name. None is no file."""
    for other in filter(None, others):
        same = False
        with suppress(OSError):  # of one that is absent
            same = path.resolve() == other.resolve() or path.samefile(other)
        if same:
            raise UsageError(f"{path}: is named twice in this command, and would be lost; name another file to write")


def begins(path: Path, pattern: bytes) -> bool:
    """Whether a file begins so, by a regular expression; also if it is empty or absent. Raises InputError."""
    if not path.is_file() or path.stat().st_size == 0:
        return True
    with open_regular(path, 1 << 63) as file:
        return re.match(pattern, file.read(KIND_BYTES), re.DOTALL) is not None


def write_atomically(path: Path, content: str | bytes, *, durable: bool = True) -> None:
    """Write a file as `replacing` does; a text as UTF-8. Raises UsageError if that fails."""
    with replacing(path, durable=durable) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[BinaryIO]:
    """A temporary file beside it to write to, which takes its place if the block ends well; else the old one stays.

    durable: wait until the disk has it; without, a loss of power may leave an empty file.
    Raises UsageError if that fails, also out of the block.
    """
    check_writable(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        try:
            with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
                yield file
                file.flush()
                if durable:
                    os.fsync(file.fileno())
                if path.exists():
                    os.fchmod(file.fileno(), stat.S_IMODE(path.stat().st_mode))
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror or error}); name another file") from error


class Shelf:
    """Puts arrays aside: the first `most_bytes` in memory (None: 32 MB), all others in a file of the temporary folder.

    The file has no name, so nothing is left of it however the program ends. Close the shelf, or use it with `with`.
    """

    def __init__(self, most_bytes: int | None = None) -> None:
        self._left, self._end = SHELF_BYTES if most_bytes is None else most_bytes, 0
        self._file: BinaryIO | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def put(self, arrays: Sequence[NDArray[Any]]) -> Callable[[], Arrays]:
        """Keep these arrays. What is returned gives them as often as it is called while the shelf is open.

        What is written to those that come from the file, this call alone has. Raises UsageError if the disk is full.
        """
        size = sum(one.nbytes for one in arrays)
        if size <= self._left:
            self._left -= size
            kept = tuple(one.copy("K") for one in arrays)  # of a longer array no more than this
            return lambda: kept
        self._left, places = 0, []
        with enough_room(size):
            file = self._file = self._file or tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # as long as this is
            for array in arrays:
                places.append(partial(np.memmap, file, array.dtype, "c", self._end, array.shape, "F"))
                _write(file, array.T)
                self._end += array.nbytes
                forget(array)
        return lambda: tuple(mapped().view(np.ndarray) for mapped in places)


class Column:
    """Rows that come piece by piece: in memory, and from `COLUMN_BYTES` on in a file of the temporary folder.

    The file has no name, and is there as long as the array that is mapped from it.
    """

    def __init__(self, like: NDArray[Any]) -> None:
        self._rows, self._count = np.empty((COLUMN_ROWS, *like.shape[1:]), like.dtype), 0
        self._file: BinaryIO | None = None

    def add(self, rows: NDArray[Any]) -> None:
        """Put rows behind those that came. Raises UsageError if the disk is full."""
        first, self._count = self._count, self._count + len(rows)
        if self._file is None:
            if self._count > len(self._rows):  # room for as much again
                before, room = self._rows[:first], max(self._count, 2 * first)
                self._rows = np.empty((room, *before.shape[1:]), before.dtype)
                self._rows[:first] = before
            self._rows[first : self._count] = rows
            if self._rows[: self._count].nbytes < COLUMN_BYTES:
                return
            self._file, rows = tempfile.TemporaryFile(buffering=0), self._rows[: self._count]  # noqa: SIM115  # until it is mapped
            self._rows = rows[:0].copy()
        with enough_room(rows.nbytes):
            _write(self._file, rows)

    def whole(self) -> NDArray[Any]:
        """All rows, read-only if they lie in a file."""
        if self._file is None:
            self._rows.resize((self._count, *self._rows.shape[1:]), refcheck=False)
            return self._rows
        with self._file as file:
            return np.memmap(file, self._rows.dtype, "r", shape=(self._count, *self._rows.shape[1:])).view(np.ndarray)


def forget(*arrays: NDArray[Any]) -> None:
    """Take what was read of mapped arrays out of memory; it comes from the file again when it is asked for."""
    for array in arrays:
        base: Any = array
        while isinstance(base, np.ndarray):
            base = base.base
        if isinstance(base, mmap.mmap):
            base.madvise(mmap.MADV_DONTNEED)


def give_back() -> None:
    """Give memory that was freed back to the system, where the C library keeps it (glibc: half of a long log)."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def keep_freed(size: int) -> None:
    """Have the C library (glibc) keep what is freed for what is made next: `KEPT` arrays of up to this size [bytes]."""
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(MMAP_THRESHOLD, size)
        set_option(TRIM_THRESHOLD, KEPT * size)


def use_huge_pages(place: int = 0) -> int:
    """Move what this process has in memory from an address on into huge pages, where the system has them (Linux).

    What runs shortly after each pause finds its caches cold, and looks up anew where each of its pages lies. It takes
    `HUGE_S` at most, and returns where to go on; 0 if it is through.
    """
    pages, advise = Path("/sys/kernel/mm/transparent_hugepage"), getattr(ctypes.CDLL(None), "madvise", None)
    try:
        size, switch = int((pages / "hpage_pmd_size").read_text()), (pages / "enabled").read_text()
        regions = [line.split(maxsplit=5) for line in Path("/proc/self/maps").read_text().splitlines()]
    except (OSError, ValueError):
        return 0
    if advise is None or size > HUGE_BYTES or "[never]" in switch:
        return 0
    until_s = time.monotonic() + HUGE_S
    for span, rights, _, _, inode, *name in regions:
        if rights == "rw-p" and inode == "0" and name in ([], ["[heap]"]):
            first, end = (int(address, 16) for address in span.split("-"))
            for page in range(-(-max(first, place) // size) * size, end - size + 1, size):
                if time.monotonic() > until_s:
                    return page
                advise(ctypes.c_void_p(page), ctypes.c_size_t(size), MADV_COLLAPSE)
    return 0


@contextmanager
def enough_room(size: int) -> Iterator[None]:
    """Say of an error of the disk in the block what to do about it. size: of what is put aside [bytes]."""
    try:
        yield
    except OSError as error:
        room = f"no room to put {size >> 20} MB aside ({error.strerror or error})"
        raise UsageError(f"{tempfile.gettempdir()}: {room}; set TMPDIR to a folder with more") from error


def _write(file: BinaryIO, rows: NDArray[Any]) -> None:
    """Write an array piece by piece, of which the system may take less."""
    left = memoryview(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)
    while len(left):
        left = left[file.write(left[:WRITE_BYTES]) :]
