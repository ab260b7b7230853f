"""The one place that touches numba: typed decorators, and a compiled cache that cannot go stale.

numba keys its on-disk cache by the time stamp of the file that holds the cached function. A function that it calls in
another file may change without the cache noticing. So only the outermost function is cached (`cached`), and its key
also holds a digest of every file that defined a compiled function.

numba counts references to every array that a function touches. In a loop that takes most of the time, so it is left out
(`_nrt`, an option of numba that is not documented) of all functions but those that make arrays (`allocating`,
`cached`); numba says so if another one does.
"""

import hashlib
from collections.abc import Callable
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

    A function that calls compiled ones of other files must close over `source_digest()`, so that a change of any of
    them changes numba's cache key.
    """
    return _kept(function)


def cached_loop(function: Callable[P, R]) -> Callable[P, R]:
    """As `cached`, for a function that makes no arrays, and calls only functions of its own file or adds the digest."""
    return _kept(function, _nrt=False)


def source_digest() -> int:
    """A digest (63 bits) of all files that have defined a compiled function so far."""
    digest = hashlib.sha256()
    for path in sorted(_sources):
        digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:8], "little") >> 1


def _kept(function: Callable[P, R], **more: Any) -> Callable[P, R]:
    options: Any = {"error_model": "numpy", **more}
    try:
        return cast(Callable[P, R], numba.njit(cache=True, **options)(function))
    except RuntimeError:  # nowhere to keep it
        return cast(Callable[P, R], numba.njit(**options)(function))


def _compiled(function: Callable[P, R], inline: Literal["never", "always"], **more: Any) -> Callable[P, R]:
    _sources.add(Path(function.__code__.co_filename))
    options: Any = {"error_model": "numpy", "inline": inline, "_nrt": False, **more}
    return cast(Callable[P, R], numba.njit(**options)(function))
