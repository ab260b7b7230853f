"""Every so many rows: rates with acceleration and thrust, smoothed alike; the rates hold nothing above 8 Hz."""

from collections.abc import Callable, Sequence

import numpy as np

from mavdiag.jit import cached, jit, source_digest
from mavdiag.monitors.columns import COMMANDED, FORCE, THRUST, U, Y, columns_of
from mavdiag.rows.front import Rows
from mavdiag.rows.running import dot, past_size, shift
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import FloatArray

PERIOD_S = 0.01  # our choice: ten times what the 0.1 s window passes
SAMPLE = 7  # of a sample: roll and pitch rate commanded, the same measured, acceleration down, thrust, 1 if it is valid
# Places in the parameters: rows between samples, length of the window, where its taps stand. And in the memory: rates
# so far, the sample, the last accelerations and thrusts.
STRIDE, LENGTH, TAPS = range(3)
COUNT, NEWEST, PAST = 0, 1, 1 + SAMPLE


def stride_of(dt_s: float) -> int:
    """Rows between two samples at a row period [s]."""
    return max(1, round(PERIOD_S / dt_s))


def taps_of(window: int) -> FloatArray:
    """Of the smoothing of acceleration and thrust, which is that of the rates."""
    taps: FloatArray = coefficients(window, min(2, window - 1))[0]
    return taps


def decimator_memory(window: int) -> FloatArray:
    """No row yet: what came before is unknown."""
    mem = np.full(PAST + 2 * past_size(window), np.nan)
    mem[COUNT] = mem[PAST] = mem[PAST + past_size(window)] = 0.0
    return mem


@jit
def decimate(
    par: FloatArray, of: int, mem: FloatArray, own: int, x: FloatArray, flags: FloatArray, lag: int, i: int
) -> bool:
    """Take a row; True where it completes a sample, which stands at `NEWEST`. of, own: where the places above begin."""
    length, taps = int(par[of + LENGTH]), int(par[of + TAPS])
    past = own + PAST
    heave = shift(mem, past, length, x[FORCE + 2, i])
    thrust = shift(mem, past + 1 + 2 * length, length, x[THRUST, i])
    if i < lag:
        return False
    count = int(mem[own + COUNT])
    mem[own + COUNT] = count + 1.0
    if count % int(par[of + STRIDE]):
        return False
    sample = own + NEWEST
    mem[sample], mem[sample + 1], mem[sample + 2], mem[sample + 3] = x[U, i], x[U + 1, i], x[Y, i], x[Y + 1, i]
    mem[sample + 4] = dot(par, taps, mem, heave, length)
    mem[sample + 5] = dot(par, taps, mem, thrust, length)
    valid = flags[COMMANDED, i] > 0.5
    for column in range(5):
        valid = valid and np.isfinite(mem[sample + column])
    mem[sample + 6] = 1.0 if valid else 0.0
    return True


def _compiled(digest: int) -> Callable[[FloatArray, FloatArray, FloatArray, FloatArray, int, FloatArray], int]:
    @cached
    def samples(par: FloatArray, mem: FloatArray, x: FloatArray, flags: FloatArray, lag: int, out: FloatArray) -> int:
        """The samples of some rows, to (n, SAMPLE)."""
        k = 0
        for i in range(x.shape[1] if digest else 0):
            if decimate(par, 0, mem, 0, x, flags, lag, i):
                out[k] = mem[NEWEST : NEWEST + SAMPLE]
                k += 1
        return k

    return samples


_samples = _compiled(source_digest())


def samples_of(segment: Sequence[Rows], stride: int, window: int) -> FloatArray:
    """The samples of a segment, (k, 7). window: rows of the smoothing, odd."""
    par, mem, found = np.array([stride, window, 3, *taps_of(window)]), decimator_memory(window), [np.empty((0, SAMPLE))]
    for columns in map(columns_of, segment):
        out = np.empty((columns.flags.shape[1], SAMPLE))
        found.append(out[: _samples(par, mem, columns.x, columns.flags, columns.lag, out)])
    return np.concatenate(found)
