"""Where a statistic jumped from one flight to the next: change points beside a trend. Pure.

At each border k between sessions a step d is tested in a line over the sessions of at most 30 flights on either side,
least squares with the weights of `trend.Sessions`:

    [ y ] ~ [ 1  x - x_k  (x > x_k) ] (a, b, d)',    t_k = d / se(d)

se(d) uses the scatter of steps between neighbouring sessions over the whole stretch, which neither a trend nor a few
jumps raise. y is held within 3 of these scales of the running median of five sessions, so that one odd session is no
jump. The border with the largest |t_k| is a change point if it is above LIMIT and the step larger than 0.05 of the
threshold; its windows then end there, and the search goes on, until there is none left.

**Its price**: LIMIT is for at most one false change point in a hundred series of 200 healthy flights;
`benchmarks/history_wear.py` counts them. A jump shows only when three sessions after it are there, and if it is larger
than about four scales; a wear that bends sharply within 30 flights may look like one.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.history.trend import Sessions, scale_of_steps
from mavdiag.telemetry import FloatArray

LIMIT = 5.0  # of |t| (tuned on emulated and drawn healthy histories)
WINDOW = 30.0  # flights on either side (our choice)
LEAST_SESSIONS = 3  # on either side
LEAST_STEP = 0.05  # of the threshold (our choice)
ODD = 3.0  # scales from the running median beyond which a session is held


@dataclass(frozen=True, slots=True)
class Change:
    """A jump. number: of the first flight after it; step: in shares of the threshold; t: in its standard errors."""

    number: int
    step: float
    t: float


def changes_of(sessions: Sessions) -> tuple[Change, ...]:
    """The change points, in order.

    >>> rng = np.random.default_rng(3)
    >>> share = 0.4 + 0.03 * rng.standard_normal(60) + 0.3 * (np.arange(60) >= 40)
    >>> found = changes_of(Sessions(np.arange(1.0, 61.0), share, np.ones(60)))
    >>> [(one.number, round(one.step, 1)) for one in found]
    [(41, 0.3)]
    """
    m = len(sessions)
    if m < 2 * LEAST_SESSIONS:
        return ()
    scale = max(scale_of_steps(sessions), 1e-6)
    y, cuts, found = _held(sessions.share, scale / np.sqrt(sessions.weight)), [0, m], list[Change]()
    while True:
        tests = [_test(sessions, y, scale, k, cuts) for k in range(LEAST_SESSIONS, m - LEAST_SESSIONS + 1)]
        best = max((test for test in tests if test is not None), key=lambda test: abs(test[1].t), default=None)
        if best is None or abs(best[1].t) < LIMIT:
            return tuple(sorted(found, key=lambda change: change.number))
        found.append(best[1])
        cuts = sorted((*cuts, best[0]))


def _test(sessions: Sessions, y: FloatArray, scale: float, k: int, cuts: list[int]) -> tuple[int, Change] | None:
    """The step at the border before session k; None if it is too small or has too few sessions beside it."""
    x = sessions.number
    first = max(max(cut for cut in cuts if cut <= k), int(np.searchsorted(x, x[k] - WINDOW)))
    end = min(min(cut for cut in cuts if cut >= k), int(np.searchsorted(x, x[k - 1] + WINDOW, side="right")))
    if k - first < LEAST_SESSIONS or end - k < LEAST_SESSIONS:
        return None
    part = slice(first, end)
    root = np.sqrt(sessions.weight[part])
    X = np.column_stack((np.ones(end - first), x[part] - x[k], np.arange(first, end) >= k)) * root[:, None]
    inverse = np.linalg.pinv(X.T @ X)
    step = float((inverse @ (X.T @ (y[part] * root)))[2])
    if abs(step) < LEAST_STEP:
        return None
    before = int(sessions.number[k - 1] + (sessions.flights[k - 1] - 1) / 2)
    return k, Change(before + 1, step, step / (scale * float(np.sqrt(inverse[2, 2]))))


def _held(y: FloatArray, scale: FloatArray) -> FloatArray:
    padded = np.pad(y, 2, mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    held: FloatArray = np.clip(y, middle - ODD * scale, middle + ODD * scale)
    return held
