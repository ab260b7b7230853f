"""What the fitted monitors say of the flights that they were fitted to: damage among them, and what would be noticed.

The figures are `Course`s: the statistic of a monitor once a second. Three things make a baseline `weak`:

    a change       one flight's course, cut in two where it differs most: the second part's median lies above the
                   first's by a ratio of 2 (a rotor's command moves by 0.03 of hover) and by 5 spreads, s^2 = floor^2 +
                   (1.48 MAD)^2 of what is left: a maximum-type two-sample test with a robust scale
    an odd flight  its median lies above that of the others by a ratio of 2 (0.04 of hover) and by 5 of their spreads
    physics        more unbalance than ISO 1940-1 G40 permits, a rotor trimmed far from the others, or a calm flight
                   that does not follow its set-points

Seconds are compared in conditions that both sides had, but for what counts as none (`thresholds.envelope`): a flight
that turns its nose says nothing of one that does not. The least damage that is noticed in 95 % of the seconds lifts
the 5 % quantile of the courses to the threshold of another session: the rise of a rotor that lost the share e of its
thrust (`airframe.trim`), or an unbalance U:

    v^2 = v_healthy^2 + x^2,   x = U Omega^2/m      [m/s^2]
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.balance import Grade as Balance
from mavdiag.airframe.balance import permissible_unbalance_g_mm
from mavdiag.airframe.trim import loss_of, rises
from mavdiag.baseline import UNREACHED, Baseline, Grade, LeastDamage
from mavdiag.errors import IdentificationError
from mavdiag.learning.flights import LearntFlight
from mavdiag.learning.teaching import Finding
from mavdiag.monitors import monitor_of
from mavdiag.monitors.base import walk
from mavdiag.monitors.conditions import COUNT, bins_of
from mavdiag.rows.windows import window_rows
from mavdiag.telemetry import BoolArray, FloatArray, IntArray
from mavdiag.thresholds.envelope import ORDER, RULES
from mavdiag.units import G_MM_PER_KG_M, NS_PER_S, RPM

STEADY = ("rotor_signature", "unbalance", "vibration_level")  # alike in every healthy flight in like conditions
TRIMS = ("rotor_trim", "trim_step")
PART_S = 5  # of a course: shorter parts have no median to compare
SPLITS = 200  # of a course that are tried
SPREADS = 5.0
CHANGE_RATIO, CHANGE_RISE = 2.0, 0.03
ODD_RATIO, ODD_RISE = 2.0, 0.04
TINY = 1e-9
LOG_FLOOR, RISE_FLOOR = 0.05, 0.002  # spreads below which none is believed
MOST_GRADE = Balance.G40  # two grades above what rotors are balanced to, G6.3 (T 3.2.2)
LEAST_PASSED = 0.5  # of a line that second differences pass; less of it and noise would be taken for it
ROTOR_SHARE = 0.02  # of the vehicle's mass is one rotor, propeller and bell: 30 g of 1.5 kg (T Eq 3.6)
MOST_TRIM = 0.5  # of hover: a rotor with 45 % of its thrust; a recorded healthy vehicle has 0.35
MOST_UNREST_RAD_S = 0.06  # that a rate loop leaves in calm flight; recorded healthy vehicles have 0.001 to 0.045
MISSED = 0.05  # share of the seconds in which it may go unnoticed
LOSS_LIMITS = (0.10, 0.20, 1 / 3)  # of a rotor's thrust: grades A, B (both our choice), C
VIBRATION_LIMITS_M_S2 = (3.0, 10.0, 30.0)  # A, B, C (our choice); above 30 ArduPilot calls it too much to fly with
GRADES: tuple[Grade, ...] = ("A", "B", "C", "D")
NOTHING = np.array([RULES[one].least for one in ORDER])  # differences of conditions that are none
_Flown: TypeAlias = tuple[FloatArray, FloatArray]  # figures of seconds, and the conditions of these


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A figure of one flight, once a second: the statistic of a monitor, or what the accelerometer shakes.

    spec: the monitor's fit; the row period [s] of the accelerometer. number, log: of which flight. t_s: (k,).
    value: (k,) the statistic; the rms of the second differences of the specific force along x and y [m/s^2].
    rises: (k, n) of the n rotors' commands, by a monitor of the trim [fraction of hover]; (k, 0) by another.
    conditions: (k, COUNT) of the bins that these seconds lie in (`monitors.conditions`); nan where unknown.
    """

    name: str
    spec: Any
    number: int
    log: str
    t_s: FloatArray
    value: FloatArray
    rises: FloatArray
    conditions: FloatArray

    @property
    def trim(self) -> bool:
        """A monitor of the trim tells it: it may differ by a fall, too."""
        return self.name in TRIMS

    @property
    def figures(self) -> FloatArray:
        """(k, c) what is compared: rises of the rotors, or the statistic's logarithm."""
        return self.rises if self.trim else np.log(np.maximum(self.value, TINY))[:, None]

    def limits(self, rise: float, ratio: float) -> tuple[float, float]:
        """The least difference of figures that counts, and the least spread that is believed."""
        return (rise, RISE_FLOOR) if self.trim else (math.log(ratio), LOG_FLOOR)


def courses(specs: Sequence[Any], flights: Sequence[LearntFlight]) -> tuple[Course, ...]:
    """The courses of the steady monitors, the trim's and the accelerometer in each flight. specs: fits to them all."""
    used, found = [spec for spec in specs if spec.kind in (*STEADY, *TRIMS)], list[Course]()
    for number, (flight, bins) in enumerate(zip(flights, bins_of([one.rows for one in flights]), strict=True)):
        ends_s = np.concatenate([np.empty(0), *(one.end_ns / NS_PER_S for one in bins)])
        values = np.concatenate([np.empty((0, COUNT)), *(one.values for one in bins), np.full((1, COUNT), np.nan)])
        parts: list[list[FloatArray]] = [[] for _ in used]  # time, value, rises of the first valid value of each second
        for judged in walk([monitor_of(spec) for spec in used], flight.rows):
            for part, spec, (one, _) in zip(parts, used, judged, strict=True):
                at = np.flatnonzero(one.valid)
                at = at[np.unique(one.t_ns[at] // NS_PER_S, return_index=True)[1]]
                rises = one.rotors[at] if spec.kind in TRIMS else np.empty((len(at), 0))
                part.append(np.column_stack((one.t_ns[at] / NS_PER_S, one.value[at], rises)))
        tables = [(spec.kind, spec, np.concatenate(part)) for part, spec in zip(parts, used, strict=True)]
        for name, spec, rows in (*tables, ("accelerometer", *_shaking(flight))):
            rows = rows[np.unique(rows[:, 0] // 1, return_index=True)[1]] if name != "accelerometer" else rows
            flown = values[np.searchsorted(ends_s, rows[:, 0], side="right")]
            found.append(Course(name, spec, number, flight.label.name, rows[:, 0], rows[:, 1], rows[:, 2:], flown))
    return tuple(found)


def _shaking(flight: LearntFlight) -> tuple[float, FloatArray]:
    """Row period, times and rms: all links that are not low-passed carry a rotor's line somewhere, folded or not."""
    found, dt_s = [np.empty((0, 2))], 0.0
    for block in (rows.block for rows in flight.rows):
        dt_s, second = block.dt_s, window_rows(1.0, block.dt_s)
        squares = np.square(np.diff(block.force[:, :2].T, n=2)).sum(axis=0)
        known = np.isfinite(squares) & block.valid[2:]
        count = len(squares) // second
        parts = np.where(known, squares, 0.0)[: count * second].reshape(count, second)
        share = known[: count * second].reshape(count, second).mean(axis=1)
        whole = share > 0.5
        t_s = block.t_ns[: count * second : second][whole] / NS_PER_S
        found.append(np.column_stack((t_s, np.sqrt(parts.mean(axis=1)[whole] / share[whole]))))
    return dt_s, np.concatenate(found)


def suspicions(found: Sequence[Course], airframe: Airframe) -> tuple[Finding, ...]:
    """What speaks against flights that were learnt: odd flights, physics, and changes within a flight."""
    odd = () if airframe.scope == "type" else _odd(found)  # vehicles of a type differ
    physics = {course.name: text for course in found if (text := _implausible(course, found, airframe))}
    implausible = (Finding(0, "all flights", text) for text in physics.values())
    return (*odd, *implausible, *(one for one in map(_change, found) if one is not None))


def _change(course: Course) -> Finding | None:
    """The clearest change within a flight, of what was flown alike before and after."""
    x, trim, (least, floor) = course.figures, course.trim, course.limits(CHANGE_RISE, CHANGE_RATIO)
    clear = list[tuple[float, int, int]]()  # how clear, where, and which figure
    if len(x) < 2 * PART_S or np.ptp(x, axis=0).max(initial=0.0) < least:  # no two medians lie further apart
        return None
    splits = np.unique(np.linspace(PART_S, len(x) - PART_S, SPLITS).astype(np.int64))
    befores, afters = _medians(x, splits), _medians(x[::-1], len(x) - splits)
    smalls = (np.abs(afters - befores) if trim else afters - befores) < least
    for i in np.flatnonzero(~smalls.all(axis=1)):
        at, before, after, small = splits[i], befores[i], afters[i], smalls[i]
        shift, left = after - before, np.abs(np.concatenate((x[:at] - before, x[at:] - after)))
        sure = np.where(small, 0.0, np.abs(shift) / np.hypot(1.4826 * np.median(left, axis=0), floor))
        if sure.max() >= SPREADS:
            clear.append((float(sure.max()), int(at), int(sure.argmax())))
    for _, at, j in sorted(clear, reverse=True):
        later, earlier = _alike((x[at:], course.conditions[at:]), [(x[:at], course.conditions[:at])])
        moved = float(np.median(later[:, j]) - np.median(earlier[0][:, j])) if earlier and len(later) >= PART_S else 0.0
        if (abs(moved) if trim else moved) >= least:
            much = f"{math.exp(moved):.2g} times what it was before"
            much = f"a motor is commanded {100 * moved:+.0f} %" if trim else much
            text = f"from {course.t_s[at]:.0f} s on: {course.name}: {much}: something changed in flight"
            return Finding(course.number, course.log, text)
    return None


def _alike(own: _Flown, others: Sequence[_Flown]) -> tuple[FloatArray, list[FloatArray]]:
    """The figures of a part in conditions that others had, too, and of those others that had its own for `PART_S`."""

    def near(conditions: FloatArray, had: FloatArray) -> BoolArray:
        low, high = (end.reduce(had, axis=0) for end in (np.fmin, np.fmax))
        return np.asarray(~((conditions > high + NOTHING) | (conditions < low - NOTHING)).any(axis=1), dtype=np.bool_)

    shared = [(x[at], had) for x, had in others if np.count_nonzero(at := near(had, own[1])) >= PART_S]
    had = [conditions for _, conditions in shared]
    return own[0][near(own[1], np.concatenate(had)) if had else slice(0)], [x for x, _ in shared]


def _medians(x: FloatArray, counts: IntArray) -> FloatArray:
    """The medians of the first so many rows, (n, c) and (s,) -> (s, c)."""
    some = np.sort(np.where(np.arange(len(x))[:, None] < counts[:, None, None], x, np.inf), axis=1)
    each = np.arange(len(counts))
    return np.asarray(0.5 * (some[each, (counts - 1) // 2] + some[each, counts // 2]), dtype=np.float64)


def _odd(found: Sequence[Course]) -> Iterator[Finding]:
    """The oddest flight by each monitor, if it is odd: how far its median lies from that of the others."""
    for name in dict.fromkeys(one.name for one in found if one.name != "trim_step"):
        same = [one for one in found if one.name == name and len(one.t_s) >= PART_S]
        if len(same) < 2:
            continue
        flown = [(one.figures, one.conditions) for one in same]
        middle = [np.median(x, axis=0) for x, _ in flown]
        apart = [_apart(same[i], own, [*middle[:i], *middle[i + 1 :]]) for i, own in enumerate(middle)]
        for number in np.argsort(-np.abs(apart)).tolist():
            own, others = _alike(flown[number], [*flown[:number], *flown[number + 1 :]])
            if not apart[number]:
                break
            if not others or len(own) < PART_S:
                continue
            if off := _apart(same[number], np.median(own, axis=0), [np.median(x, axis=0) for x in others]):
                off_by = f"{100 * off:+.0f} % of hover" if same[number].trim else f"{math.exp(off):.2g} times"
                text = f"{name}: {off_by} against the other flights: is a propeller broken in one of them?"
                yield Finding(same[number].number, same[number].log, text)
                break


def _apart(course: Course, own: FloatArray, others: Sequence[FloatArray]) -> float:
    """By how much the figure that lies furthest from the others' median does so; 0 where none does by enough."""
    (least, floor), rest = course.limits(ODD_RISE, ODD_RATIO), np.array(others)
    off = own - np.median(rest, axis=0)
    spread = np.hypot(1.4826 * np.median(np.abs(rest - np.median(rest, axis=0)), axis=0), floor)
    off = np.where((np.abs(off) if course.trim else off) >= np.maximum(least, SPREADS * spread), off, 0.0)
    return float(off[np.abs(off).argmax()])


def _implausible(course: Course, found: Sequence[Course], airframe: Airframe) -> str:
    """What no healthy vehicle has, in a sentence; empty if there is nothing of it."""
    spec = course.spec
    match course.name:
        case "accelerometer" if airframe.hover_rad_s is not None:
            # a line at f has (2 sin(pi f dt))^2 times its amplitude in second differences
            passed = (2 * math.sin(airframe.hover_rad_s * spec / 2)) ** 2
            rms = np.concatenate([one.value for one in found if one.name == course.name])
            if len(rms) and passed >= LEAST_PASSED:
                return _too_unbalanced(float(np.median(rms)) / passed, airframe)
        case "unbalance" | "vibration_level":
            return _too_unbalanced(math.sqrt(spec.power) if course.name == "unbalance" else spec.healthy, airframe)
        case "rotor_trim":
            rise = rises(np.array([spec.mean]), spec.layout, spec.spread)[0]
            rotor = int(np.abs(rise).argmax())
            if abs(rise[rotor]) > MOST_TRIM:
                return f"motor {rotor + 1} is commanded {100 * rise[rotor]:+.0f} % against the others"
        case "rotor_signature":
            unrest = math.sqrt((spec.motion.k0[0] + spec.motion.k0[1]) / 2)
            if unrest > MOST_UNREST_RAD_S:
                rates = f"{unrest:.2f} rad/s, healthy vehicles leave less than {MOST_UNREST_RAD_S:g}"
                return f"the vehicle does not follow its set-points in calm flight: {rates}"
    return ""


def _too_unbalanced(m_s2: float, airframe: Airframe) -> str:
    """A sentence, if a vibration is more than balanced rotors make: their unbalances add as squares; else empty."""
    found = _in_g_mm(m_s2, airframe)
    if found is None or airframe.mass_kg is None or airframe.hover_rad_s is None:
        return ""
    one = permissible_unbalance_g_mm(MOST_GRADE, airframe.hover_rad_s / RPM, 1e3 * ROTOR_SHARE * airframe.mass_kg)
    most = math.sqrt(4 if airframe.layout is None else airframe.layout.rotors) * one
    said = f"unbalance of {found:.2g} g mm, rotors of grade {MOST_GRADE} have {most:.2g} together"
    return f"{said}: is a propeller broken?" if found > most else ""


def _in_g_mm(m_s2: float, airframe: Airframe) -> float | None:
    """The unbalance that makes a vibration; None where mass and rotor speed are not known."""
    if airframe.mass_kg is None or airframe.hover_rad_s is None or not math.isfinite(m_s2):
        return None
    return G_MM_PER_KG_M * airframe.mass_kg / airframe.hover_rad_s**2 * m_s2


def least_damage(found: Sequence[Course], limits: Mapping[str, float], airframe: Airframe) -> LeastDamage:
    """The least damage that is noticed in 95 % of the time. limits: thresholds of the monitors, by name."""
    least, vibration = [], [math.inf]
    for name, limit in limits.items():
        same = [one for one in found if one.name == name and len(one.t_s)]
        if not same or limit >= monitor_of(same[0].spec).reach:
            continue
        if name in TRIMS:
            least.append(limit - np.quantile(np.concatenate([one.rises for one in same]), MISSED, axis=0))
        elif name in ("unbalance", "vibration_level"):
            scale = same[0].spec.scale if name == "unbalance" else 1.0
            usual = float(np.quantile(np.concatenate([one.value for one in same]), MISSED))
            vibration.append(math.sqrt(max(limit**2 - usual**2, 0.0)) / scale)
    m_s2, thrust = min(vibration), np.maximum(np.min(least, axis=0), 0.0).tolist() if least else []
    g_mm = _in_g_mm(m_s2, airframe)
    return LeastDamage(
        thrust_loss=tuple(float(f"{loss_of(a, len(thrust)):.3g}") for a in thrust),
        vibration_m_s2=float(f"{m_s2:.3g}") if math.isfinite(m_s2) else None,
        unbalance_g_mm=None if g_mm is None else float(f"{g_mm:.3g}"),
    )


def grade_of(least: LeastDamage, *, weak: bool, blind: Sequence[str] = (), supported: bool = True) -> Grade:
    """A: a rotor's loss of 10 % or a vibration of 3 m/s^2 is noticed; B: 20 %, 10 m/s^2; C: a third, 30 m/s^2; else D.

    The better of the two counts, and is B at most where the other is not seen at all. C where the link shows neither:
    such a baseline judges by motion alone. weak: its flights speak against it, which is D. blind: monitors that were
    fitted and cannot reach their threshold; where no monitor of the trim can, the trim scattered too much for any, D.
    supported: whether enough flight taught it; else it is B at most.
    """
    sizes = [(max(least.thrust_loss), LOSS_LIMITS)] if least.thrust_loss else []
    sizes += [] if least.vibration_m_s2 is None else [(least.vibration_m_s2, VIBRATION_LIMITS_M_S2)]
    seen = [sum(size > limit for limit in limits) for size, limits in sizes]
    if weak or (set(blind) & set(TRIMS) and not least.thrust_loss):
        return "D"
    if not seen:
        return "C"
    lacking = len(seen) == 1 or not supported or max(seen) == len(GRADES) - 1
    return GRADES[max(min(seen), 1) if lacking else min(seen)]


def accepted(baseline: Baseline, how: str) -> Baseline:
    """The baseline, if it is worth to judge by; raises IdentificationError with the reason for one of grade D.

    how: what takes it all the same.
    """
    if baseline.grade != "D":
        return baseline
    blind = "; ".join(f"{one.monitor}: {one.reason}" for one in baseline.not_judgeable if UNREACHED in one.reason)
    reason = baseline.weak or blind or f"it notices only {baseline.least_damage}"
    raise IdentificationError(f"baseline of grade D: {reason}; teach with other flights, or take it with {how}")
