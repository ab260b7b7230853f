"""Guards of teaching: what among healthy flights should not be learnt, where it is, and what to do about it.

A log with its crash inside, the same flight twice, a stretch far from all the rest, two vehicles taken for one: each
would be learnt without a word, and the baseline would call the like of it healthy. All guards are pure; they return
`Finding`s. `mavdiag.learning.teaching` refuses or leaves out what they name before anything is fitted. A damaged
propeller among the flights is seen once the monitors are fitted (`mavdiag.learning.suspicions`). All limits are our
choices; `benchmarks/broken_teaching.py` has what they find, and how many healthy sets they mark.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import LEVEL_RATIO, shown_trim
from mavdiag.learning.flights import LearntFlight
from mavdiag.rows.front import Rows
from mavdiag.rows.upsets import MARGIN_S, motion_of, upset_in
from mavdiag.rows.windows import window_mean, window_rows
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

BLOCK_S = 5.0  # of flight (our choice)
WINDOW_S = 0.5  # a block's figure is the median over these, so that the spike of a landing does not count (our choice)
MIN_BLOCKS = 6  # fewer have no rest to be far from (our choice)
FAR_SPREADS = 5.0  # robust standard deviations above the median (our choice)
FAR_RATIO = 4.0  # least ratio of noise to what is expected (our choice)
FAR_ERROR = 12.0  # least ratio of the rate error: a fast square among hovers has 4 (our choice)
LEAST_ERROR_RAD_S = 0.5  # rate error below which nothing is far: gusts are many times a calm hover's (our choice)
FAR_LEVEL = 1.5  # least ratio of thrust to the median (our choice)

GROUP_DISTANCE = 0.03  # of the hover command; one airframe's recorded sessions lie up to 0.023 apart (our choice)
NOTED_DISTANCE = 0.005  # of the hover command: as much as new propellers make (our choice)
GROUP_RATIO = 6.0  # of the distance to the spread within the groups (our choice)
GROUP_FLOOR = 0.001  # of the hover command: no mean over a flight is more certain (our choice)


class Kind(StrEnum):
    """What a finding is about."""

    REPEATED = "repeated"
    UPSET = "upset"
    FAR = "far"
    GROUPS = "groups"
    CHANGE = "change"
    PHYSICS = "physics"


@dataclass(frozen=True, slots=True)
class Finding:
    """Something among the healthy flights that should not be learnt.

    number: of the flight among those given, from 0: two may have one name.
    log: its name.
    kind: what it is about.
    text: what was seen, with figures, without the name.
    from_s, to_s: the part to leave out [s of the vehicle's clock]; None for the start or the end of the log.
    refuses: it must not be learnt; else it is only noted.
    """

    number: int
    log: str
    kind: Kind
    text: str
    from_s: float | None = None
    to_s: float | None = None
    refuses: bool = True

    @property
    def place(self) -> str:
        """The part to leave out, in words."""
        if self.from_s is None and self.to_s is None:
            return "the whole log"
        if self.from_s is None:
            return f"all before {self.to_s:.1f} s"
        return f"all from {self.from_s:.1f} s on" if self.to_s is None else f"{self.from_s:.1f} to {self.to_s:.1f} s"

    @property
    def remedy(self) -> str:
        """What to do about it."""
        if self.from_s is None and self.to_s is None:
            return "take this log out, or leave it out with --robust"
        if self.to_s is None:
            return f"cut the log before {self.from_s:.1f} s, or leave this part out with --robust"
        return f"cut {self.place} out of the log, or leave this part out with --robust"

    def __str__(self) -> str:
        return f"{self.log}: {self.text}"


_FIGURES = (("gyro noise", FAR_RATIO), ("rate error", FAR_ERROR), ("thrust", FAR_LEVEL))


def upsets(flights: Sequence[LearntFlight]) -> tuple[Finding, ...]:
    """The upset of each flight that has one, from its first sign to its last, with two seconds around."""
    found = []
    for number, flight in enumerate(flights):
        upset = upset_in(motion_of(rows.block) for rows in flight.rows if len(rows.block))
        if upset is not None:
            place = upset.begin_s - MARGIN_S, None if upset.ends else upset.end_s + MARGIN_S
            found.append(Finding(number, flight.label.name, Kind.UPSET, upset.text, *place))
    return tuple(found)


def far_blocks(flights: Sequence[LearntFlight]) -> tuple[Finding, ...]:
    """Stretches whose gyro noise, rate error or thrust lies far from that of all other stretches.

    Noise and rate error grow with what is commanded; they are compared with sqrt(a^2 + (b u)^2), u the rms of the
    commanded rates, a their median over the calmer half of the blocks and b u that over the busier half. Far is above
    4 times the median, for the error 12 times, and above 5 robust standard deviations (1.48 times the median of what
    lies above the median). Lower noise is not far: a hover among squares is quiet; nor is a rate error below 0.5 rad/s,
    which gusts give. Thrust is far at 1.5 times or a 1.5th.
    """
    blocks = [(number, *block) for number, flight in enumerate(flights) for block in _blocks(flight.rows)]
    if len(blocks) < MIN_BLOCKS:
        return ()
    table = np.array(blocks)
    values, far = _compared(table[:, 3:6], table[:, 6]), list[tuple[int, float, float, str]]()
    for (name, least), column, logs in zip(_FIGURES, values.T, table[:, 3:6].T, strict=True):
        size = np.abs(column) if name == "thrust" else column
        above = size[size > 0]
        limit = max(math.log(least), FAR_SPREADS * 1.4826 * float(np.median(above)) if len(above) else 0.0)
        loud = (size > limit) & ~((logs < math.log(LEAST_ERROR_RAD_S)) & (name == "rate error"))
        text = "{} {:.2g} times that of the other flights' blocks"
        for i in np.flatnonzero(loud).tolist():
            number, from_s, to_s = table[i, :3].tolist()
            far.append((int(number), from_s, to_s, text.format(name, math.exp(column[i]))))
    stretches: list[tuple[int, float, float, str]] = []  # blocks that follow each other make one finding
    for number, from_s, to_s, text in sorted(far, key=lambda block: block[:2]):
        if stretches and stretches[-1][0] == number and from_s <= stretches[-1][2] + BLOCK_S:
            _, begin_s, end_s, what = stretches[-1]
            stretches[-1] = number, begin_s, max(end_s, to_s), what
        else:
            stretches.append((number, from_s, to_s, text))
    return tuple(
        Finding(number, flights[number].label.name, Kind.FAR, f"{begin:.1f} to {end:.1f} s: {text}", begin, end)
        for number, begin, end, text in stretches
    )


def _blocks(flight: Sequence[Rows]) -> Iterator[tuple[float, ...]]:
    """Of each few seconds: start and end [s], logarithms of gyro noise, rate error and thrust, rms commanded rate."""
    for block, rates in ((rows.block, rows.rates) for rows in flight):
        noise, size = np.square(np.diff(block.rate, n=2, axis=0)).sum(axis=1), window_rows(BLOCK_S, block.dt_s)
        # a last block that is shorter than half belongs to the one before
        for first, stop in itertools.pairwise([*range(0, max(1, len(block) - size // 2), size), len(block)]):
            if np.count_nonzero(block.valid[first:stop]) < 0.5 * size:
                continue
            low_ns, high_ns = block.t_ns[[first, stop - 1]].tolist()
            inside = slice(*np.searchsorted(rates.t_ns, [low_ns, high_ns + 1]).tolist())
            known, u = rates.commanded[inside], rates.u[inside]
            error = np.where(known, np.square(rates.y[inside] - u).sum(axis=1), np.nan)
            busy = math.sqrt(float(np.square(u[known]).sum(axis=1).mean())) if known.any() else 0.0
            quick = np.where(block.valid[first + 2 : stop], noise[first : stop - 2], np.nan)
            thrust = _median(block.thrust[first:stop][block.valid[first:stop]])
            figures = _typical(quick, block.dt_s), _typical(error, block.dt_s), thrust
            logs = (math.log(x) if x > 0 else math.nan for x in figures)
            yield low_ns / NS_PER_S, high_ns / NS_PER_S, *logs, busy


def _compared(logs: FloatArray, busy: FloatArray) -> FloatArray:
    """(b, 3) logarithms against what is expected, their median taken out."""
    logs = logs.copy()
    calm, lively = busy <= np.median(busy), (busy >= np.median(busy)) & (busy > 0)
    for column in (0, 1):
        at_rest = _median(np.exp(logs[calm, column]))
        share = _median(np.exp(logs[lively, column]) / busy[lively]) if lively.any() else 0.0
        logs[:, column] -= np.log(np.hypot(at_rest, share * busy) + np.finfo(float).tiny)
    return np.asarray(logs - [_median(column) for column in logs.T], dtype=np.float64)


def _median(x: FloatArray) -> float:
    known = x[np.isfinite(x)]
    return float(np.median(known)) if len(known) else 0.0


def _typical(squares: FloatArray, dt_s: float) -> float:
    """Median over windows of their rms, (n,); NaN if no window is whole."""
    window = window_rows(WINDOW_S, dt_s)
    means = window_mean(squares[:, None], window)[:: max(1, window // 2), 0]
    known = means[np.isfinite(means)]
    return math.sqrt(float(np.median(known))) if len(known) else math.nan


def trim_groups(flights: Sequence[LearntFlight], layout: RotorLayout | None) -> tuple[Finding, ...]:
    """Flights whose mean trims fall into two groups: two airframes, or two sets of propellers.

    The flights are cut in two where the gap along one axis is widest. The groups are apart if the distance of their
    means is at least 6 times the spread within them and 0.03 of the hover command, roll and pitch counting a third.
    With 0.005 it is noted, and so it is if a group has one flight alone: nothing tells its spread.
    """
    if layout is None:
        return ()
    known = []
    for number, flight in enumerate(flights):
        shown = (shown_trim(rows.block, layout) for rows in flight.rows)
        rows = np.concatenate([np.empty((0, 3)), *(trim[where] for trim, where in shown)])
        known += [(number, rows.mean(axis=0))] if len(rows) else []
    if len(known) < 3:
        return ()
    weight = np.array([1.0 / LEVEL_RATIO, 1.0 / LEVEL_RATIO, 1.0])
    trims = np.array([mean for _, mean in known]) * weight
    distance, spread, odd = max((_split(trims, axis) for axis in range(3)), key=lambda split: split[0] / split[1])
    if distance < max(NOTED_DISTANCE, GROUP_RATIO * spread):
        return ()
    refuses = distance >= GROUP_DISTANCE and 2 <= len(odd) <= len(known) - 2
    numbers = [known[i][0] for i in odd]
    names = [flights[number].label.name for number in numbers]
    groups = trims[odd].mean(axis=0) / weight, np.delete(trims, odd, axis=0).mean(axis=0) / weight
    one, rest = ("/".join(f"{x:+.3f}" for x in trim) for trim in groups)
    text = (
        f"the mean trims of the flights fall into two groups: roll, pitch, yaw {one} in {', '.join(names)} and {rest} "
        "in the others: two airframes, sets of propellers or sessions"
    )
    found = [
        Finding(number, name, Kind.GROUPS, text, refuses=refuses) for number, name in zip(numbers, names, strict=True)
    ]
    return tuple(found if refuses else found[:1])


def _split(trims: FloatArray, axis: int) -> tuple[float, float, list[int]]:
    """Distance of the two groups that the widest gap along an axis makes, the spread within, and the smaller group."""
    order = np.argsort(trims[:, axis], kind="stable")
    at = int(np.diff(trims[order, axis]).argmax()) + 1
    low, high = order[:at], order[at:]
    apart = trims[high].mean(axis=0) - trims[low].mean(axis=0)
    within = np.concatenate([trims[group] - trims[group].mean(axis=0) for group in (low, high)])
    freedom = max(1, len(trims) - 2)
    spread = math.hypot(math.sqrt(float(np.square(within).sum()) / freedom), GROUP_FLOOR)
    return float(np.linalg.norm(apart)), spread, sorted((low if len(low) < len(high) else high).tolist())
