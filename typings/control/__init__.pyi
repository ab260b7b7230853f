# The part of python-control that mavdiag.identify and its tests use.
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

class TransferFunction:
    dt: float | bool | None
    num: list[list[NDArray[np.float64]]]
    den: list[list[NDArray[np.float64]]]
    def __init__(
        self,
        num: Sequence[float] | NDArray[np.float64],
        den: Sequence[float] | NDArray[np.float64],
        dt: float,
    ) -> None: ...
    def poles(self) -> NDArray[np.complex128]: ...
    def zeros(self) -> NDArray[np.complex128]: ...
    def dcgain(self) -> float: ...
    def __call__(self, x: complex) -> complex: ...

class TimeResponseData:
    outputs: NDArray[np.float64]

def forced_response(
    sysdata: TransferFunction, timepts: NDArray[np.float64], inputs: NDArray[np.float64]
) -> TimeResponseData: ...
def step_response(sysdata: TransferFunction, timepts: NDArray[np.float64]) -> TimeResponseData: ...
def damp(
    sys: TransferFunction, doprint: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.complex128]]: ...
def stability_margins(sysdata: TransferFunction) -> tuple[float, float, float, float, float, float]: ...
