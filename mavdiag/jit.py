"""The one place that touches numba: typed decorators, and a compiled cache that cannot go stale.

numba keys its on-disk cache by the time stamp of the file that holds the cached function. A function that it calls in
another file may change without the cache noticing. So only the outermost function is cached (`cached`), and its key
also holds a digest of the files that it may call.

numba counts references to every array that a function touches. In a loop that takes most of the time, so it is left out
(`_nrt`, an option of numba that is not documented) of all functions but those that make arrays (`allocating`,
`cached`); numba says so if another one does.
"""

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

_sources: set[Path] = set()


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` when a compiled function first calls it. No fast-math: results are reproducible."""
    return _compiled(function, inline="never")


def summing(function: Callable[P, R]) -> Callable[P, R]:
    """As `jit`, where sums may be formed in any order: several terms at a time, always in the same way."""
    return _compiled(function, inline="never", fastmath={"reassoc", "contract", "nsz"})


def allocating(function: Callable[P, R]) -> Callable[P, R]:
    """As `jit`, for a function that makes arrays."""
    return _compiled(function, inline="never", _nrt=True)


def inline(function: Callable[P, R]) -> Callable[P, R]:
    """As `jit`, but merged into its caller: no cost for passing large tuples."""
    return _compiled(function, inline="always")


def cached(function: Callable[P, R]) -> Callable[P, R]:
    """Compile on the first call and keep the machine code on disk, where there is a place for it.

    numba keys the code by the function and its file; here also by all files of its folder and of `mavdiag/rows`, where
    everything stands that it may call.
    """
    options: Any = {"error_model": "numpy"}
    try:
        compiled: Any = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # nowhere to keep it
        return cast(Callable[P, R], numba.njit(**options)(function))
    if hasattr(compiled, "_cache"):  # not with NUMBA_DISABLE_JIT=1
        digest = tuple(map(_digest, (Path(function.__code__.co_filename).parent, Path(__file__).parent / "rows")))
        kept = compiled._cache  # noqa: SLF001  # numba has no other way in
        own_key = kept._index_key  # noqa: SLF001
        kept._index_key = lambda *asked: (*own_key(*asked), *digest)  # noqa: SLF001
    return cast(Callable[P, R], compiled)


@lru_cache
def _digest(folder: Path) -> str:
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.glob("*.py")))).hexdigest()


def source_digest() -> int:
    """A digest (63 bits) of all files that have defined a compiled function so far."""
    digest = hashlib.sha256()
    for path in sorted(_sources):
        digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:8], "little") >> 1


def _compiled(function: Callable[P, R], inline: Literal["never", "always"], **more: Any) -> Callable[P, R]:
    _sources.add(Path(function.__code__.co_filename))
    options: Any = {"error_model": "numpy", "inline": inline, "_nrt": False, **more}
    return cast(Callable[P, R], numba.njit(**options)(function))
