"""What lies between the airframe and the IMU: a soft mount, or an arm that resonates.

One mode of second order, driven by its base, the same for translation, roll and pitch (our choice). Yaw passes as it
is: with the yaw rate behind a mode at 50 or 25 Hz the yaw loop of the QDrone 2 oscillates.

    H(s) = (2 zeta w0 s + w0^2) / (s^2 + 2 zeta w0 s + w0^2)

Slow motion passes as it is. At w0 the mode adds up to 1 / (2 zeta), far above it isolates. So one transfer stands for a
frame whose resonance meets the rotors' line and for an isolator far below it. It is discretised by the bilinear
transform, prewarped at w0.
"""

import math
from typing import NamedTuple

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.jit import jit

__all__ = ["RIGID_MOUNT", "Mount", "advance_mount", "isolating_hz", "mode", "transmissibility"]


YAW_RATE = 2  # row of the yaw rate among the six


class Mount(NamedTuple):
    """Constants. soft: False for an IMU that is bolted on. filter: b0, b1, b2, a1, a2 (a0 = 1)."""

    soft: bool
    filter: tuple[float, float, float, float, float]


RIGID_MOUNT = Mount(False, (1.0, 0.0, 0.0, 0.0, 0.0))


def mode(resonance_hz: float, damping: float, dt_s: float) -> Mount:
    """The mount with a mode at `resonance_hz`. Raises UsageError outside 0 to 0.45 of the sample rate."""
    if not (0.0 < resonance_hz <= 0.45 / dt_s and damping > 0.0):
        raise UsageError(f"a mount needs a resonance of 0 to {0.45 / dt_s:g} Hz and damping, not {resonance_hz:g} Hz")
    k = math.tan(math.pi * resonance_hz * dt_s)
    lossy = 2.0 * damping * k
    a0 = 1.0 + lossy + k * k
    b0, b2 = (lossy + k * k) / a0, (k * k - lossy) / a0
    return Mount(True, (b0, 2.0 * k * k / a0, b2, 2.0 * (k * k - 1.0) / a0, (1.0 - lossy + k * k) / a0))


def transmissibility(mount: Mount, at_hz: float, dt_s: float) -> float:
    """What the mount passes of a vibration, 1 for all of it.

    >>> round(transmissibility(mode(100.0, 0.05, 0.001), 100.0, 0.001), 2)    # sqrt(1 + 1 / (2 zeta)^2)
    10.05
    """
    b0, b1, b2, a1, a2 = mount.filter
    z = np.exp(-2j * np.pi * at_hz * dt_s)
    return float(abs((b0 + b1 * z + b2 * z * z) / (1.0 + a1 * z + a2 * z * z)))


def isolating_hz(line_hz: float, share: float, damping: float, dt_s: float) -> float:
    """The resonance of a mount that passes `share` (below 1) of a line at `line_hz`."""
    from scipy.optimize import brentq

    def excess(resonance_hz: float) -> float:
        return transmissibility(mode(resonance_hz, damping, dt_s), line_hz, dt_s) - share

    return float(brentq(excess, 1e-3 * line_hz, line_hz / math.sqrt(2.0)))


@jit
def advance_mount(memory: FloatArray, mount: Mount, felt: FloatArray) -> None:
    """Turn what the airframe does, felt (6,), into what the IMU feels, in place. memory: (6, 2)."""
    if not mount.soft:
        return
    b0, b1, b2, a1, a2 = mount.filter
    for i in range(len(felt)):
        if i == YAW_RATE:
            continue
        value = felt[i]
        result = b0 * value + memory[i, 0]  # direct form II, transposed
        memory[i, 0] = b1 * value - a1 * result + memory[i, 1]
        memory[i, 1] = b2 * value - a2 * result
        felt[i] = result
