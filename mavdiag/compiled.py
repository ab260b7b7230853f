"""Loops as machine code: numba compiles them at their first call and keeps the code on disk."""

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function when it is first called, also from another one of these. Imports numba."""
    from numba import njit

    try:
        return cast(Callable[P, R], njit(cache=True)(function))
    except RuntimeError:  # nowhere to keep the machine code
        return cast(Callable[P, R], njit(function))


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """As `jit`, for a function that calls no other one; numba is imported when it is first called."""

    @cache
    def machine_code() -> Callable[P, R]:
        return jit(function)

    @wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        return machine_code()(*arguments, **named)

    return call
