"""Guards of teaching: what among healthy flights should not be learnt, and where it is.

A log with its crash inside, the same flight twice, a stretch far from all the rest, two vehicles taken for one: each
would be learnt without a word, and the baseline would call the like of it healthy. All guards are pure; they return
`Finding`s. `mavdiag.learning.teaching` refuses or leaves out what they name before anything is fitted.

A damaged propeller among the flights is seen once the monitors are fitted (`suspicions`): the baseline is then `weak`.
The figures are `Course`s: the statistic of a monitor once a second, by the fit to all flights, so that a ratio of two
of its values does not depend on how large the fit takes health to be. Three things speak against a teaching set:

    a change      one flight's course, cut in two where it differs most: the second part's median lies above the
                  first's by a ratio of 2 (a rotor's command moves by 0.03 of hover) and by 5 spreads, s^2 = floor^2 +
                  (1.48 MAD)^2 of what is left: a maximum-type two-sample test with a robust scale
    an odd flight its median lies above the median of the other flights' by a ratio of 2 (0.04 of hover) and by 5 of
                  their spreads
    physics       more unbalance than ISO 1940-1 G40 permits, a rotor that is trimmed far from the others, or a calm
                  flight that does not follow its set-points

One flight that was broken from its start to its end can be told by physics alone. All limits are our choices;
`benchmarks/broken_teaching.py` has what they find, and how many healthy sets they mark.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.balance import Grade, permissible_unbalance_g_mm
from mavdiag.airframe.fingerprint import joined, joined_rates
from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import LEVEL_RATIO, rises, shown_trim
from mavdiag.learning.findings import Finding, Kind
from mavdiag.learning.flights import LearntFlight
from mavdiag.learning.repeats import repeated, repeated_of
from mavdiag.monitors import monitor_of
from mavdiag.monitors.rotor_signature import RotorSignatureSpec
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.monitors.unbalance import UnbalanceSpec
from mavdiag.monitors.vibration_level import VibrationLevelSpec
from mavdiag.rows.rates import RateBlock
from mavdiag.rows.upsets import MARGIN_S, motion_of, upset_in
from mavdiag.rows.windows import window_mean, window_rows
from mavdiag.telemetry import FloatArray
from mavdiag.units import G_MM_PER_KG_M, NS_PER_S, RPM

__all__ = [
    "Course",
    "Finding",
    "Kind",
    "courses",
    "far_blocks",
    "repeated",
    "repeated_of",
    "suspicions",
    "trim_groups",
    "upsets",
]

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

STEADY = ("rotor_signature", "unbalance", "vibration_level")  # alike in every healthy flight, whatever is flown
TRIMS = ("rotor_trim", "trim_step")
SHAKING = "accelerometer"
PART_S = 5  # of a course: shorter parts have no median to compare
SPLITS = 200  # of a course that are tried
SPREADS = 5.0
CHANGE_RATIO, CHANGE_RISE = 2.0, 0.03
ODD_RATIO, ODD_RISE = 2.0, 0.04
TINY = 1e-9
LOG_FLOOR, RISE_FLOOR = 0.05, 0.002  # spreads below which none is believed
MOST_GRADE = Grade.G40  # two grades above what rotors are balanced to, G6.3 (T 3.2.2)
LEAST_PASSED = 0.5  # of a line that second differences pass; less of it and noise would be taken for it
ROTOR_SHARE = 0.02  # of the vehicle's mass is one rotor, propeller and bell: 30 g of 1.5 kg (T Eq 3.6)
MOST_TRIM = 0.5  # of hover: a rotor with 45 % of its thrust; a recorded healthy vehicle has 0.35
MOST_UNREST_RAD_S = 0.06  # that a rate loop leaves in calm flight; recorded healthy vehicles have 0.001 to 0.045


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A figure of one flight, once a second: the statistic of a monitor, or what the accelerometer shakes.

    name: the monitor's, or "accelerometer". spec: the monitor's fit; the row period [s] of the accelerometer.
    number, log: of which flight.
    t_s: (k,) vehicle's clock. value: (k,) the statistic; the rms of the second differences of the specific force along
    x and y [m/s^2]. rises: (k, n) of the n rotors' commands, by a monitor of the
    trim [fraction of hover]; (k, 0) by another.
    """

    name: str
    spec: Any
    number: int
    log: str
    t_s: FloatArray
    value: FloatArray
    rises: FloatArray

    @property
    def figures(self) -> FloatArray:
        """(k, c) what is compared: rises of the rotors, or the statistic's logarithm."""
        return self.rises if self.rises.shape[1] else np.log(np.maximum(self.value, TINY))[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """A few seconds of flight.

    number, log: of which flight.
    from_s, to_s: vehicle's clock.
    logs: natural logarithms of the gyro's fast noise, of the error of the rates, and of the thrust; NaN if unknown.
    busy: rms of the commanded rates [rad/s]; 0 if unknown.
    """

    number: int
    log: str
    from_s: float
    to_s: float
    logs: tuple[float, float, float]
    busy: float


_FIGURES = ("gyro noise", "rate error", "thrust")


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
    blocks = [block for number, flight in enumerate(flights) for block in _blocks(number, flight)]
    if len(blocks) < MIN_BLOCKS:
        return ()
    values = _compared(blocks)
    found: dict[int, list[tuple[_Block, str]]] = {}
    for name, column, least in zip(_FIGURES, values.T, (FAR_RATIO, FAR_ERROR, FAR_LEVEL), strict=True):
        size = np.abs(column) if name == "thrust" else column
        above = size[size > 0]
        limit = max(math.log(least), FAR_SPREADS * 1.4826 * float(np.median(above)) if len(above) else 0.0)
        quiet = np.array([name == "rate error" and one.logs[1] < math.log(LEAST_ERROR_RAD_S) for one in blocks])
        for i in np.flatnonzero((size > limit) & ~quiet).tolist():
            text = f"{name} {math.exp(column[i]):.2g} times that of the other flights' blocks"
            found.setdefault(blocks[i].number, []).append((blocks[i], text))
    return tuple(one for far in found.values() for one in _stretches(far))


def _stretches(far: Sequence[tuple[_Block, str]]) -> Iterator[Finding]:
    """Blocks that follow each other make one finding."""
    ordered = sorted(far, key=lambda one: one[0].from_s)
    begin, text = ordered[0]
    end_s = begin.to_s
    for block, other in [*ordered[1:], (None, "")]:
        if block is not None and block.from_s <= end_s + BLOCK_S:
            end_s = max(end_s, block.to_s)
            continue
        place = f"{begin.from_s:.1f} to {end_s:.1f} s"
        yield Finding(begin.number, begin.log, Kind.FAR, f"{place}: {text}", begin.from_s, end_s)
        if block is not None:
            begin, text, end_s = block, other, block.to_s


def _compared(blocks: Sequence[_Block]) -> FloatArray:
    """(b, 3) logarithms against what is expected, their median taken out."""
    logs = np.array([one.logs for one in blocks])
    busy = np.array([one.busy for one in blocks])
    calm, lively = busy <= np.median(busy), (busy >= np.median(busy)) & (busy > 0)
    for column in (0, 1):
        at_rest = _median(np.exp(logs[calm, column]))
        share = _median(np.exp(logs[lively, column]) / busy[lively]) if lively.any() else 0.0
        logs[:, column] -= np.log(np.hypot(at_rest, share * busy) + np.finfo(float).tiny)
    middle = np.array([_median(column) for column in logs.T])
    return np.asarray(logs - middle, dtype=np.float64)


def _median(x: FloatArray) -> float:
    known = x[np.isfinite(x)]
    return float(np.median(known)) if len(known) else 0.0


def _blocks(number: int, flight: LearntFlight) -> Iterator[_Block]:
    for block, rates in zip(joined(flight.rows), joined_rates(flight.rows), strict=True):
        noise = np.square(np.diff(block.rate, n=2, axis=0)).sum(axis=1)
        for first, stop in _cuts(len(block), window_rows(BLOCK_S, block.dt_s)):
            if np.count_nonzero(block.valid[first:stop]) < 0.5 * window_rows(BLOCK_S, block.dt_s):
                continue
            low_ns, high_ns = int(block.t_ns[first]), int(block.t_ns[stop - 1])
            error, busy = _errors(rates, low_ns, high_ns)
            quick = _typical(np.where(block.valid[first + 2 : stop], noise[first : stop - 2], np.nan), block.dt_s)
            thrust = _median(block.thrust[first:stop][block.valid[first:stop]])
            logs = (_log(quick), _log(error), _log(thrust))
            yield _Block(number, flight.label.name, low_ns / NS_PER_S, high_ns / NS_PER_S, logs, busy)


def _errors(rates: RateBlock, low_ns: int, high_ns: int) -> tuple[float, float]:
    """Error of the rates and rms of the commanded ones between two times [rad/s]; NaN and 0 if they are not known."""
    inside = slice(*np.searchsorted(rates.t_ns, [low_ns, high_ns + 1]).tolist())
    known = rates.commanded[inside]
    if not known.any():
        return math.nan, 0.0
    error = np.square(rates.y[inside] - rates.u[inside]).sum(axis=1)
    busy = math.sqrt(float(np.square(rates.u[inside][known]).sum(axis=1).mean()))
    return _typical(np.where(known, error, np.nan), rates.dt_s), busy


def _typical(squares: FloatArray, dt_s: float) -> float:
    """Median over windows of their rms, (n,); NaN if no window is whole."""
    window = window_rows(WINDOW_S, dt_s)
    means = window_mean(squares[:, None], window)[:: max(1, window // 2), 0]
    known = means[np.isfinite(means)]
    return math.sqrt(float(np.median(known))) if len(known) else math.nan


def _log(x: float) -> float:
    return math.log(x) if x > 0 else math.nan


def _cuts(count: int, size: int) -> Iterator[tuple[int, int]]:
    """Half-open cuts of `size` rows; a last one that is shorter than half belongs to the one before."""
    edges = [*range(0, max(1, count - size // 2), size), count]
    return itertools.pairwise(edges)


def trim_groups(flights: Sequence[LearntFlight], layout: RotorLayout | None) -> tuple[Finding, ...]:
    """Flights whose mean trims fall into two groups: two airframes, or two sets of propellers.

    The flights are cut in two where the gap along one axis is widest. The groups are apart if the distance of their
    means is at least 6 times the spread within them and 0.03 of the hover command, roll and pitch counting a third.
    With 0.005 it is noted, and so it is if a group has one flight alone: nothing tells its spread.
    """
    if layout is None:
        return ()
    means = [(number, _mean_trim(flight, layout)) for number, flight in enumerate(flights)]
    known = [(number, mean) for number, mean in means if mean is not None]
    if len(known) < 3:
        return ()
    weight = np.array([1.0 / LEVEL_RATIO, 1.0 / LEVEL_RATIO, 1.0])
    trims = np.array([mean for _, mean in known]) * weight
    distance, spread, odd = max((_split(trims, axis) for axis in range(3)), key=lambda one: one[0] / one[1])
    if distance < max(NOTED_DISTANCE, GROUP_RATIO * spread):
        return ()
    refuses = distance >= GROUP_DISTANCE and 2 <= len(odd) <= len(known) - 2
    numbers = [number for number, _ in known]
    names = [flights[number].label.name for number in numbers]
    mean, rest = trims[odd].mean(axis=0) / weight, np.delete(trims, odd, axis=0).mean(axis=0) / weight
    text = (
        f"the mean trims of the flights fall into two groups: roll, pitch, yaw {_three(mean)} in "
        f"{', '.join(names[i] for i in odd)} and {_three(rest)} in the others: "
        "two airframes, sets of propellers or sessions"
    )
    if not refuses:
        return (Finding(numbers[odd[0]], names[odd[0]], Kind.GROUPS, text, refuses=False),)
    return tuple(Finding(numbers[i], names[i], Kind.GROUPS, text) for i in odd)


def _mean_trim(flight: LearntFlight, layout: RotorLayout) -> FloatArray | None:
    found = [shown_trim(block, layout) for block in joined(flight.rows)]
    known = np.concatenate([np.empty((0, 3)), *(trim[where] for trim, where in found)])
    return known.mean(axis=0) if len(known) else None


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


def _three(trim: FloatArray) -> str:
    return "/".join(f"{x:+.3f}" for x in trim)


def courses(specs: Sequence[Any], flights: Sequence[LearntFlight]) -> tuple[Course, ...]:
    """The courses of the steady monitors, of those of the trim, and of the accelerometer, in each flight.

    specs: fits to all the flights.
    """
    used = [spec for spec in specs if spec.kind in (*STEADY, *TRIMS)]
    of_monitors = (_course(spec, number, flight) for number, flight in enumerate(flights) for spec in used)
    return (*of_monitors, *(_shaking(number, flight) for number, flight in enumerate(flights)))


def _shaking(number: int, flight: LearntFlight) -> Course:
    """Of the accelerometer: all links that are not low-passed carry a rotor's line somewhere, folded or not."""
    t_s, value, dt_s = [np.empty(0)], [np.empty(0)], 0.0
    for block in joined(flight.rows):
        dt_s, second = block.dt_s, window_rows(1.0, block.dt_s)
        squares = np.square(np.diff(block.force[:, :2], n=2, axis=0)).sum(axis=1)
        known = np.isfinite(squares) & block.valid[2:]
        count = len(squares) // second
        parts = np.where(known, squares, 0.0)[: count * second].reshape(count, second)
        share = known[: count * second].reshape(count, second).mean(axis=1)
        whole = share > 0.5
        t_s.append(block.t_ns[: count * second : second][whole] / NS_PER_S)
        value.append(np.sqrt(parts.mean(axis=1)[whole] / share[whole]))
    times = np.concatenate(t_s)
    return Course(SHAKING, dt_s, number, flight.label.name, times, np.concatenate(value), np.empty((len(times), 0)))


def _course(spec: Any, number: int, flight: LearntFlight) -> Course:
    rotors = spec.layout.rotors if spec.kind in TRIMS else 0
    t_ns, value, risen = [np.empty(0, dtype=np.int64)], [np.empty(0)], [np.empty((0, rotors))]
    for found in monitor_of(spec).over(flight.rows):
        at = np.flatnonzero(found.valid)
        at = at[np.unique(found.t_ns[at] // NS_PER_S, return_index=True)[1]]
        t_ns.append(found.t_ns[at])
        value.append(found.value[at])
        risen.append(found.rotors[at] if rotors else np.empty((len(at), 0)))
    times = np.concatenate(t_ns)
    at = np.unique(times // NS_PER_S, return_index=True)[1]
    return Course(
        spec.kind,
        spec,
        number,
        flight.label.name,
        times[at] / NS_PER_S,
        np.concatenate(value)[at],
        np.concatenate(risen)[at],
    )


def suspicions(found: Sequence[Course], airframe: Airframe) -> tuple[Finding, ...]:
    """What speaks against flights that were learnt: odd flights, physics, and changes within a flight."""
    changed = [one for one in map(_change, found) if one is not None]
    odd = () if airframe.scope == "type" else _odd(found)  # vehicles of a type differ
    return (*odd, *_implausible(found, airframe), *changed)


def _change(course: Course) -> Finding | None:
    """The clearest change within a flight."""
    x, trim = course.figures, bool(course.rises.shape[1])
    least, floor = (CHANGE_RISE, RISE_FLOOR) if trim else (math.log(CHANGE_RATIO), LOG_FLOOR)
    best: tuple[float, float, int] = (0.0, 0.0, 0)
    for at in np.unique(np.linspace(PART_S, len(x) - PART_S, SPLITS).astype(np.int64)) if len(x) >= 2 * PART_S else ():
        before, after = np.median(x[:at], axis=0), np.median(x[at:], axis=0)
        left = np.abs(np.concatenate((x[:at] - before, x[at:] - after)))
        shift = after - before
        sure = np.abs(shift) / np.hypot(1.4826 * np.median(left, axis=0), floor)
        sure[(np.abs(shift) if trim else shift) < least] = 0.0
        j = int(sure.argmax())
        best = max(best, (float(sure[j]), float(shift[j]), int(at)))
    sure_of, moved, at = best
    if sure_of < SPREADS:
        return None
    place = f"from {course.t_s[at]:.0f} s on"
    name = course.name
    much = f"a motor is commanded {100 * moved:+.0f} %" if trim else f"{math.exp(moved):.2g} times what it was before"
    return Finding(course.number, course.log, Kind.CHANGE, f"{place}: {name}: {much}: something changed in flight")


def _odd(found: Sequence[Course]) -> Iterator[Finding]:
    """The oddest flight by each monitor, if it is odd."""
    for name in dict.fromkeys(one.name for one in found if one.name != "trim_step"):
        same = [one for one in found if one.name == name and len(one.t_s) >= PART_S]
        if len(same) < 2:
            continue
        trim = name in TRIMS
        least, floor = (ODD_RISE, RISE_FLOOR) if trim else (math.log(ODD_RATIO), LOG_FLOOR)
        middle = np.array([np.median(one.figures, axis=0) for one in same])
        apart = [_apart(middle, number, least, floor) for number in range(len(same))]
        number = int(np.argmax([abs(one) if trim else one for one in apart]))
        if abs(apart[number]) < least or (apart[number] < 0 and not trim):
            continue
        off = f"{100 * apart[number]:+.0f} % of hover" if trim else f"{math.exp(apart[number]):.2g} times"
        text = f"{name}: {off} against the other flights: is a propeller broken in one of them?"
        yield Finding(same[number].number, same[number].log, Kind.GROUPS, text)


def _apart(middle: FloatArray, number: int, least: float, floor: float) -> float:
    """How far a flight's median lies from that of the others, of the figure in which it is farthest; 0 if not far."""
    rest = np.delete(middle, number, axis=0)
    off = middle[number] - np.median(rest, axis=0)
    spread = np.hypot(1.4826 * np.median(np.abs(rest - np.median(rest, axis=0)), axis=0), floor)
    off = np.where(np.abs(off) >= np.maximum(least, SPREADS * spread), off, 0.0)
    return float(off[np.abs(off).argmax()])


def _implausible(found: Sequence[Course], airframe: Airframe) -> Iterator[Finding]:
    """What no healthy vehicle has."""
    for course in {one.name: one for one in found}.values():
        spec, text = course.spec, ""
        match spec:
            case float():
                same = np.concatenate([one.value for one in found if one.name == course.name])
                text = _too_shaky(same, spec, airframe)
            case UnbalanceSpec():
                text = _too_unbalanced(math.sqrt(spec.power), airframe)
            case VibrationLevelSpec():
                text = _too_unbalanced(spec.healthy, airframe)
            case RotorTrimSpec():
                rise = rises(np.array([spec.mean]), spec.layout, spec.spread)[0]
                rotor = int(np.abs(rise).argmax())
                if abs(rise[rotor]) > MOST_TRIM:
                    text = f"motor {rotor + 1} is commanded {100 * rise[rotor]:+.0f} % against the others"
            case RotorSignatureSpec():
                unrest = math.sqrt((spec.motion.k0[0] + spec.motion.k0[1]) / 2)
                if unrest > MOST_UNREST_RAD_S:
                    rates = f"{unrest:.2f} rad/s, healthy vehicles leave less than {MOST_UNREST_RAD_S:g}"
                    text = f"the vehicle does not follow its set-points in calm flight: {rates}"
        if text:
            yield Finding(0, "all flights", Kind.PHYSICS, text)


def _too_shaky(rms: FloatArray, dt_s: float, airframe: Airframe) -> str:
    """As `_too_unbalanced`, from second differences: a line at f has (2 sin(pi f dt))^2 times its amplitude in them."""
    if not len(rms) or airframe.hover_rad_s is None:
        return ""
    passed = (2 * math.sin(airframe.hover_rad_s * dt_s / 2)) ** 2
    return _too_unbalanced(float(np.median(rms)) / passed, airframe) if passed >= LEAST_PASSED else ""


def _too_unbalanced(m_s2: float, airframe: Airframe) -> str:
    """A sentence, if a vibration is more than balanced rotors make: their unbalances add as squares; else empty."""
    if airframe.mass_kg is None or airframe.hover_rad_s is None:
        return ""
    rotors = 4 if airframe.layout is None else airframe.layout.rotors
    one = permissible_unbalance_g_mm(MOST_GRADE, airframe.hover_rad_s / RPM, 1e3 * ROTOR_SHARE * airframe.mass_kg)
    found, most = G_MM_PER_KG_M * airframe.mass_kg / airframe.hover_rad_s**2 * m_s2, math.sqrt(rotors) * one
    if found <= most:
        return ""
    return (
        f"unbalance of {found:.2g} g mm, rotors of grade {MOST_GRADE} have {most:.2g} together: is a propeller broken?"
    )
