"""The one place that touches numba: typed decorators, and a compiled cache that cannot go stale.

numba keys its on-disk cache by the time stamp of the file that holds the cached function. A function that it calls in
another file may change without the cache noticing. So only the outermost function is cached (`cached`), and its key
also holds a digest of the files of all functions that it reaches.

numba counts references to every array that a function touches. In a loop that takes most of the time, so it is left out
(`_nrt`, an option of numba that is not documented) of all functions but those that make arrays (`allocating`,
`cached`); numba says so if another one does.
"""

import hashlib
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, ParamSpec, Protocol, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


class Decorator(Protocol):
    """What compiles a function and keeps its signature."""

    def __call__(self, function: Callable[P, R], /) -> Callable[P, R]:
        """The compiled function."""


def _compiled(*, keep: bool = False, **more: Any) -> Decorator:
    options: Any = {"error_model": "numpy", "_nrt": False, **more}

    def compiled(function: Any) -> Any:
        try:
            made: Any = numba.njit(cache=keep, **options)(function)
        except RuntimeError:  # nowhere to keep it
            made = numba.njit(**options)(function)
        if not hasattr(made, "get_call_template"):  # with NUMBA_DISABLE_JIT=1
            return made
        # Have compiled callers ask for plain types: numba compiles anew for each literal number, a loop's first 0 too.
        own, plain = made.get_call_template, cast(Any, numba.types.unliteral)
        made.get_call_template = lambda args, kws: own([*map(plain, args)], {k: plain(v) for k, v in kws.items()})
        kept = made._cache  # noqa: SLF001  # numba has no other way in
        if hasattr(kept, "_index_key"):
            own_key = kept._index_key  # noqa: SLF001
            kept._index_key = lambda *asked: (*own_key(*asked), _digest(made))  # noqa: SLF001
            _take_over(Path(kept.cache_path), Path(function.__code__.co_filename), kept._impl.filename_base)  # noqa: SLF001
        return made

    return compiled


jit = _compiled()  # when a compiled function first calls it; no fast-math: results are reproducible
summing = _compiled(fastmath={"reassoc", "contract", "nsz"})  # sums in any order, always in the same one
allocating = _compiled(_nrt=True)  # as `jit`, for a function that makes arrays
inline = _compiled(inline="always")  # as `jit`, but merged into its caller: no cost for passing large tuples
cached = _compiled(keep=True, _nrt=True)  # on the first call; the machine code stays on disk, where there is a place
cached_loop = _compiled(keep=True)  # as `cached`, for a function that makes no arrays


def _take_over(own: Path, source: Path, base: str) -> None:
    """Copy the machine code beside the source, which another user's `mavdiag warm` put there, into our folder."""
    if own == source.with_name("__pycache__") or (own / f"{base}.nbi").exists():
        return
    for part in sorted(source.with_name("__pycache__").glob(f"{base}.*nb[ci]")):  # the index comes last
        new = own / f"{part.name}.{os.getpid()}"
        shutil.copyfile(part, new)
        new.replace(own / part.name)


def _digest(compiled: Any) -> str:
    """A digest of the files of a compiled function and of all that it calls, and of the constants that these read."""
    reached: dict[int, Any] = {}
    constants = list[str]()
    _collect(compiled, reached, constants)
    files = sorted({one.py_func.__code__.co_filename for one in reached.values()})
    return hashlib.sha256("".join([*map(_text, files), *constants]).encode()).hexdigest()


def _collect(compiled: Any, reached: dict[int, Any], constants: list[str]) -> None:
    """Put all compiled functions that one reaches by its globals and closure into `reached`."""
    function = getattr(compiled, "py_func", None)
    if function is None or id(compiled) in reached:
        return
    reached[id(compiled)] = compiled
    names, cells = function.__code__.co_names, function.__closure__ or ()
    values = [function.__globals__[name] for name in names if name in function.__globals__]
    for module in [value for value in values if isinstance(value, ModuleType)]:
        values += [getattr(module, name, None) for name in names]
    for value in (*values, *(cell.cell_contents for cell in cells)):
        parts = value if isinstance(value, tuple) else (value,)
        if all(isinstance(part, bool | int | float | str) for part in parts):
            constants.append(repr(value))
        _collect(value, reached, constants)


@cache
def _text(path: str) -> str:
    return Path(path).read_text(encoding="utf-8")
