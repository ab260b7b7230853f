"""The one place that touches numba: typed decorators, and a compiled cache that cannot go stale.

numba keys its on-disk cache by the time stamp of the file of the cached function; what that function calls in another
file may change without notice. So only the outermost function is cached (`cached`), and its key holds a digest of every
file that defined a compiled function. numba counts references to every array that a function touches, which took two
thirds of the time; it is left out (`_nrt`, an undocumented option) of all but `allocating` and `cached` functions.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NoReturn, ParamSpec, TypeVar, cast

from mavdiag.errors import UsageError, missing_extra

try:
    import numba
except ImportError:
    numba = None  # type: ignore[assignment]  # a module or None: every use below asks

P = ParamSpec("P")
R = TypeVar("R")

_sources: set[Path] = set()


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` when a compiled function first calls it. No fast-math: results are reproducible."""
    return _compiled(function, "never")


def allocating(function: Callable[P, R]) -> Callable[P, R]:
    """As `jit`, for a function that makes arrays."""
    return _compiled(function, "never", counts=True)


def inline(function: Callable[P, R]) -> Callable[P, R]:
    """As `jit`, but merged into its caller: no cost for passing large tuples."""
    return _compiled(function, "always")


def cached(function: Callable[P, R]) -> Callable[P, R]:
    """Compile on the first call, and keep the machine code. `function` must close over `source_digest()`."""
    if function.__closure__ is None:
        raise UsageError(f"{function.__name__} must close over source_digest() to be cached")
    if numba is None:
        return cast(Callable[P, R], _missing)
    return cast(Callable[P, R], numba.njit(cache=True, error_model="numpy")(function))


def source_digest() -> int:
    """A digest (63 bits) of all files that have defined a compiled function so far."""
    digest = hashlib.sha256()
    for path in sorted(_sources):
        digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:8], "little") >> 1


def _compiled(function: Callable[P, R], inline: Literal["never", "always"], counts: bool = False) -> Callable[P, R]:
    _sources.add(Path(function.__code__.co_filename))
    if numba is None:
        return cast(Callable[P, R], _missing)
    options: Any = {"error_model": "numpy", "inline": inline, "_nrt": counts}
    return cast(Callable[P, R], numba.njit(**options)(function))


def check_numba() -> None:
    """Raise UsageError, saying what to install, if nothing can be compiled. Commands ask before they make a file."""
    if numba is None:
        _missing()


def _missing(*_arguments: object) -> NoReturn:
    raise missing_extra("the plant", "numba", "plant")
