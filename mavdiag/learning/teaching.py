"""Healthy flights made ready to be learnt: what the guards find is refused with its remedy, or left out.

A log with its crash inside, the same flight twice, a gyro turned round, a stretch far from all the rest, two vehicles
taken for one: each would be learnt without a word. A guard returns `Finding`s: what should not be learnt, where it is,
and what to do about it. All limits are our choices; `benchmarks/broken_teaching.py` has what they find.
"""

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import LEVEL_RATIO, shown_trim
from mavdiag.errors import InputError
from mavdiag.learning.flights import (
    IN_MEMORY,
    LEAVE_OUT,
    PIECE_ROWS,
    HeldLog,
    LearntFlight,
    airborne,
    front_for,
    hold,
    odd_rate,
    outputs_in_use,
)
from mavdiag.printable import counted
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import steps_of
from mavdiag.rows.quality import LinkQuality, adds_nothing, learnt_quality
from mavdiag.rows.upsets import MARGIN_S, motion_of, upset_in
from mavdiag.rows.windows import means_from, window_rows
from mavdiag.storage import Shelf, give_back
from mavdiag.telemetry import FloatArray, IntArray, Log, Signal
from mavdiag.units import NS_PER_S

RUN = 16  # consecutive gyro samples that two flights do not have in common by chance (our choice)
RUN_CHANGES = 12  # of them that differ from the one before, for a gyro at rest repeats itself (our choice)
LOOKED_AT = 200_000  # runs that are compared, of more only the same share of each (our choice)
SHARED_S = 1.0  # of common runs that make an overlap (our choice)
ALL_SHARED = 0.95  # of a flight's runs: the flight counts twice (our choice)
ODD = 0x9E3779B97F4A7C15  # the golden ratio times 2^64: a multiplier that spreads bits (Knuth, TAOCP 3, 6.4)

BLOCK_S = 5.0  # of flight (our choice)
WINDOW_S = 0.5  # a block's figure is the median over these, so that the spike of a landing does not count (our choice)
MIN_BLOCKS = 6  # fewer have no rest to be far from (our choice)
FAR_SPREADS = 5.0  # robust standard deviations above the median (our choice)
FAR_RATIO = 4.0  # least ratio of noise to what is expected (our choice)
FAR_ERROR = 12.0  # least ratio of the rate error: a fast square among hovers has 4 (our choice)
LEAST_ERROR_RAD_S = 0.5  # rate error below which nothing is far: gusts are many times a calm hover's (our choice)
FAR_LEVEL = 1.5  # least ratio of thrust to the median (our choice)

TURN_S = 2.0  # over which the rates are integrated to angles: the lag of a rate loop hardly counts then (our choice)
TURNED = 0.2  # of r, of either sign: clear; recorded flights have 0.29 to 1, emulated hovers -0.1 to 0.6 (our choice)

GROUP_DISTANCE = 0.03  # of the hover command; one airframe's recorded sessions lie up to 0.023 apart (our choice)
NOTED_DISTANCE = 0.005  # of the hover command: as much as new propellers make (our choice)
GROUP_RATIO = 6.0  # of the distance to the spread within the groups (our choice)
MAX_ROUNDS = 5  # of cutting and looking again; what is far may hide what is less far (our choice)
GROUP_FLOOR = 0.001  # of the hover command: no mean over a flight is more certain (our choice)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something among the healthy flights that should not be learnt.

    number, log: of the flight among those given, from 0, for two may have one name; and its name.
    text: what was seen, with figures, without the name.
    from_s, to_s: the part to leave out [s of the vehicle's clock]; None for the start or the end of the log.
    refuses: it must not be learnt; else it is only noted.
    """

    number: int
    log: str
    text: str
    from_s: float | None = None
    to_s: float | None = None
    refuses: bool = True

    @property
    def place(self) -> str:
        """The part to leave out, in words."""
        if self.from_s is None:
            return "the whole log" if self.to_s is None else f"all before {self.to_s:.1f} s"
        return f"all from {self.from_s:.1f} s on" if self.to_s is None else f"{self.from_s:.1f} to {self.to_s:.1f} s"

    @property
    def remedy(self) -> str:
        """What to do about it."""
        if self.from_s is None and self.to_s is None:
            return "take this log out"
        return f"cut the log before {self.from_s:.1f} s" if self.to_s is None else f"cut {self.place} out of the log"

    def __str__(self) -> str:
        return f"{self.log}: {self.text}"


def repeated(flights: Iterable[Log | HeldLog]) -> tuple[Finding, ...]:
    """Flights that an earlier one holds already: the same file, the same gyro samples, or a part of them.

    A copy in another container, or a part of a log, has the same gyro values, while their stamps may differ.
    """
    shelf, found, files = Shelf(IN_MEMORY), list[Finding](), dict[str, str]()
    held = [hold(flight, shelf) for flight in flights]
    runs, earliest, owners = _shared(held, LOOKED_AT)
    if (earliest < owners).any():  # then all runs are looked at
        runs, earliest, owners = _shared(held, 0)
    for number, flight in enumerate(held):
        name, sha256, starts = flight.label.name, flight.label.sha256, runs[number][1]
        if sha256 and sha256 in files:
            found.append(Finding(number, name, f"the same file as {files[sha256]}"))
            continue
        files[sha256] = name
        whose = earliest[owners == number]
        common = starts[whose < number]
        if not len(common):
            continue
        t_ns, other = _gyro(flight)[0], int(np.bincount(whose[whose < number]).argmax())
        dt_s = float(np.median(steps_of(t_ns))) / NS_PER_S
        text = f"{len(common) * dt_s:.1f} s of it are in {held[other].label.name} as well"
        if len(common) == len(starts) == len(runs[other][1]):
            found.append(Finding(number, name, f"the same flight as {held[other].label.name}"))
        elif len(common) > ALL_SHARED * len(starts):
            found.append(Finding(number, name, text))
        elif len(common) * dt_s >= SHARED_S:
            low_s, high_s = float(t_ns[common].min()) / NS_PER_S, float(t_ns[common + RUN - 1].max()) / NS_PER_S
            found.append(Finding(number, name, text, low_s, high_s + dt_s))
    return tuple(found)


def _shared(flights: Sequence[HeldLog], most: int) -> tuple[list[tuple[IntArray, IntArray]], IntArray, IntArray]:
    """Of each flight its runs; of all of them the first flight that holds it, and its own.

    most: about how many are looked at, the same ones of all flights by their hashes; 0 for all.
    """
    pieces = (one for flight in flights for piece in flight.pieces() for one in piece)
    values = sum(len(series) for series in pieces if series.signal is Signal.BODY_RATE)
    every = max(1, values // most) if most else 1
    runs = [_runs(_gyro(flight)[1], every) for flight in flights]
    hashes = np.concatenate([np.empty(0, dtype=np.int64), *(one for one, _ in runs)])
    owners = np.repeat(np.arange(len(runs)), [len(one) for one, _ in runs])
    _, first, which = np.unique(hashes, return_index=True, return_inverse=True)
    return runs, owners[first][which], owners


def _gyro(flight: HeldLog) -> tuple[IntArray, FloatArray]:
    """Times and values of a flight's gyro, without negative zeros."""
    gyro = flight.open(Signal.BODY_RATE).need(Signal.BODY_RATE)
    return gyro.t_ns, np.ascontiguousarray(gyro.values, dtype=np.float64) + 0.0


def _runs(values: FloatArray, every: int) -> tuple[IntArray, IntArray]:
    """A hash of each run of `RUN` samples that move, (m,), of hashes that `every` divides, and where it begins, (m,).

    h_i = sum_k c_k mix(sum_j c_j words_(i+k),j), modulo 2^64
    """
    found = [(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))]
    for begin in range(0, max(len(values) - RUN + 1, 0), PIECE_ROWS):
        part = values[begin : begin + PIECE_ROWS + RUN - 1]
        count = len(part) - RUN + 1
        rows, hashes = np.zeros(len(part), dtype=np.uint64), np.zeros(count, dtype=np.uint64)
        for word in part.view(np.uint64).T:
            rows = (rows ^ word) * np.uint64(ODD)
            rows ^= rows >> np.uint64(29)
        for k in range(RUN):
            hashes = hashes * np.uint64(ODD) + rows[k : k + count]
        changes = np.concatenate(([0], np.cumsum(np.any(np.diff(part, axis=0) != 0, axis=1))))
        moving = (changes[RUN - 1 :] - changes[:count] >= RUN_CHANGES) & (hashes % np.uint64(every) == 0)
        starts = np.flatnonzero(moving)
        found.append((hashes[starts].view(np.int64), begin + starts))
    hashes_found, starts_found = (np.concatenate(column) for column in zip(*found, strict=True))
    return hashes_found, starts_found


def upsets(flights: Sequence[LearntFlight]) -> tuple[Finding, ...]:
    """The upset of each flight that has one, from its first sign to its last, with two seconds around."""
    found = list[Finding]()
    for number, flight in enumerate(flights):
        if (upset := upset_in(_seen(flight, "motion"))) is not None:
            end_s = None if upset.ends else upset.end_s + MARGIN_S
            found.append(Finding(number, flight.label.name, upset.text, upset.begin_s - MARGIN_S, end_s))
    return tuple(found)


def turned(flights: Sequence[LearntFlight], known: Collection[int] = ()) -> tuple[Finding, ...]:
    """Flights whose gyro follows its set-point with another sign than in most flights, in roll or pitch.

    r = sum a b/max(sum a^2, sum b^2) of both, integrated over 2 s each, less a straight line: in what is slower a calm
    vehicle's commands oppose what moves it, as on a circle. known: axes of which the sign is right.
    """
    found = dict[int, Finding]()
    sums = np.array([sum(_seen(flight, "turns"), np.zeros((3, 2))) for flight in flights]).reshape(-1, 3, 2)
    r = sums[:, 0] / np.maximum(sums[:, 1:].max(axis=1), np.finfo(float).tiny)
    sign = np.where(np.abs(r) > TURNED, np.sign(r), 0.0)
    for axis, name in enumerate(("roll", "pitch")):
        wrong = -1.0 if axis in known or sign[:, axis].sum() >= 0 else 1.0
        for i in np.flatnonzero(sign[:, axis] == wrong).tolist():
            text = f"its {name} gyro turns against its set-point, unlike the others' (r {r[i, axis]:+.2f})"
            found[i] = Finding(i, flights[i].label.name, text)
    return tuple(found.values())


def _turns(rows: Rows) -> Iterator[FloatArray]:
    """Sums of a b, a a and b b, (3, 2): a, b the commanded and measured angle in each 2 s, less a straight line."""
    rates, size = rows.rates, window_rows(TURN_S, rows.block.dt_s)
    count = len(rates.commanded) // size
    whole = rates.commanded[: count * size].reshape(count, size).all(axis=1)
    u, y = (one[: count * size, :2].reshape(count, size, 2)[whole].cumsum(axis=1) for one in (rates.u, rates.y))
    line = np.linalg.qr(np.vander(np.arange(size), 2))[0]
    a, b = (one - np.einsum("ik,jk,cjx->cix", line, line, one, optimize=True) for one in (u, y))
    yield np.array([(one * other).sum(axis=(0, 1)) for one, other in ((a, b), (a, a), (b, b))])


def far_blocks(flights: Sequence[LearntFlight]) -> tuple[Finding, ...]:
    """Stretches whose gyro noise, rate error or thrust lies far from that of all other stretches.

    Noise and rate error grow with what is commanded; they are compared with sqrt(a^2 + (b u)^2), u the rms of the
    commanded rates, a their median over the calmer half of the blocks and b u that over the busier half. Far is above
    4 times the median, for the error 12 times, and above 5 robust standard deviations (1.48 times the median of what
    lies above the median). Lower noise is not far, nor a rate error below 0.5 rad/s, which gusts give. Thrust is far at
    1.5 times or a 1.5th.
    """
    blocks = [(number, *block) for number, flight in enumerate(flights) for block in _seen(flight, "blocks")]
    if len(blocks) < MIN_BLOCKS:
        return ()
    table = np.array(blocks)
    values, far = _compared(table[:, 3:6], table[:, 6]), list[tuple[int, float, float, str]]()
    limits = {"gyro noise": FAR_RATIO, "rate error": FAR_ERROR, "thrust": FAR_LEVEL}
    for column, (name, least) in enumerate(limits.items()):
        size = np.abs(values[:, column]) if name == "thrust" else values[:, column]
        above = size[size > 0]
        limit = max(math.log(least), FAR_SPREADS * 1.4826 * float(np.median(above)) if len(above) else 0.0)
        loud = (size > limit) & ~((table[:, 3 + column] < math.log(LEAST_ERROR_RAD_S)) & (name == "rate error"))
        for i in np.flatnonzero(loud).tolist():
            number, from_s, to_s = table[i, :3].tolist()
            text = f"{name} {math.exp(values[i, column]):.2g} times that of all other stretches"
            far.append((int(number), from_s, to_s, text))
    joined = list[tuple[int, float, float, str]]()  # blocks that follow each other make one
    for number, from_s, to_s, text in sorted(far, key=lambda block: block[:2]):
        if joined and joined[-1][0] == number and from_s <= joined[-1][2] + BLOCK_S:
            _, from_s, _, text = joined.pop()
        joined.append((number, from_s, to_s, text))
    return tuple(Finding(n, flights[n].label.name, text, from_s, to_s) for n, from_s, to_s, text in joined)


def _blocks(rows: Rows) -> Iterator[tuple[float, ...]]:
    """Of each few seconds: start and end [s], logarithms of gyro noise, rate error and thrust, rms commanded rate."""
    block, rates = rows.block, rows.rates
    noise, size = np.square(np.diff(block.rate.T, n=2)).sum(axis=0), window_rows(BLOCK_S, block.dt_s)
    # a last block that is shorter than half belongs to the one before
    for first, stop in itertools.pairwise([*range(0, max(1, len(block) - size // 2), size), len(block)]):
        if np.count_nonzero(block.valid[first:stop]) < 0.5 * size:
            continue
        low_ns, high_ns = block.t_ns[[first, stop - 1]].tolist()
        inside = slice(*np.searchsorted(rates.t_ns, [low_ns, high_ns + 1]).tolist())
        known, u = rates.commanded[inside], rates.u[inside].T
        error = np.where(known, np.square(rates.y[inside].T - u).sum(axis=0), np.nan)
        busy = math.sqrt(float(np.square(u).sum(axis=0)[known].mean())) if known.any() else 0.0
        quick = np.where(block.valid[first + 2 : stop], noise[first : stop - 2], np.nan)
        thrust = _median(block.thrust[first:stop][block.valid[first:stop]])
        figures = _typical(quick, block.dt_s), _typical(error, block.dt_s), thrust
        logs = (math.log(x) if x > 0 else math.nan for x in figures)
        yield low_ns / NS_PER_S, high_ns / NS_PER_S, *logs, busy


def _spans(rows: Rows) -> Iterator[tuple[int, int, int]]:
    """Segment, first and last time that may be judged [ns]."""
    t_ns = rows.block.t_ns[rows.block.valid]
    if len(t_ns):
        yield rows.block.segment, int(t_ns[0]), int(t_ns[-1])


_GLANCES: Mapping[str, Callable[[Rows], Iterable[Any]]] = {
    "motion": lambda rows: [motion_of(rows.block)] if len(rows.block) else [],
    "turns": _turns,
    "blocks": _blocks,
    "spans": _spans,
}


def _seen(flight: LearntFlight, what: str) -> list[Any]:
    """What a glance finds in the rows of a flight, in order."""
    found: list[Any] = flight.rows.once(what, lambda flown: [one for rows in flown for one in _GLANCES[what](rows)])
    return found


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
    means = means_from(squares[None], np.arange(0, len(squares) - window + 1, max(1, window // 2)), window)[0]
    known = means[np.isfinite(means)]
    return math.sqrt(float(np.median(known))) if len(known) else math.nan


def trim_groups(flights: Sequence[LearntFlight], layout: RotorLayout | None) -> tuple[Finding, ...]:
    """Flights whose mean trims fall into two groups: two airframes, or two sets of propellers.

    The groups are apart if the distance of their means is at least 6 times the spread within them and 0.03 of the hover
    command, roll and pitch counting a third. With 0.005 it is noted, and so it is if a group has one flight alone.
    """
    if layout is None:
        return ()
    known, means = list[int](), list[FloatArray]()
    for number, flight in enumerate(flights):
        shown = [trim[where] for trim, where in (shown_trim(rows.block, layout) for rows in flight.rows)]
        if sum(map(len, shown)):
            known.append(number)
            means.append(np.concatenate(shown).mean(axis=0))
    if len(known) < 3:
        return ()
    weight = np.array([1.0 / LEVEL_RATIO, 1.0 / LEVEL_RATIO, 1.0])
    trims = np.array(means) * weight
    distance, spread, odd = max((_split(trims, axis) for axis in range(3)), key=lambda split: split[0] / split[1])
    if distance < max(NOTED_DISTANCE, GROUP_RATIO * spread):
        return ()
    refuses = distance >= GROUP_DISTANCE and 2 <= len(odd) <= len(known) - 2
    names = [flights[known[i]].label.name for i in odd]
    groups = trims[odd].mean(axis=0) / weight, np.delete(trims, odd, axis=0).mean(axis=0) / weight
    one, rest = ("/".join(f"{x:+.3f}" for x in trim) for trim in groups)
    text = (
        f"the mean trims of the flights fall into two groups: roll, pitch, yaw {one} in {', '.join(names)} and {rest} "
        "in the others: two airframes, sets of propellers or sessions"
    )
    found = [Finding(known[i], name, text, refuses=refuses) for i, name in zip(odd, names, strict=True)]
    return tuple(found if refuses else found[:1])


def _split(trims: FloatArray, axis: int) -> tuple[float, float, list[int]]:
    """Distance of the two groups that the widest gap along an axis makes, the spread within, and the smaller group."""
    order = np.argsort(trims[:, axis], kind="stable")
    at = int(np.diff(trims[order, axis]).argmax()) + 1
    low, high = order[:at], order[at:]
    apart = trims[high].mean(axis=0) - trims[low].mean(axis=0)
    within = np.concatenate([trims[group] - trims[group].mean(axis=0) for group in (low, high)])
    spread = math.hypot(math.sqrt(float(np.square(within).sum()) / max(1, len(trims) - 2)), GROUP_FLOOR)
    return float(np.linalg.norm(apart)), spread, sorted((low if len(low) < len(high) else high).tolist())


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """The front that makes the rows, and what is learnt. left_out, notes: as in `baseline.Provenance`."""

    front: Front
    flights: tuple[LearntFlight, ...]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def taught(
    logs: Iterable[Log | HeldLog], window_s: float, gate: GateSpec | None, *, robust: bool, shelf: Shelf | None = None
) -> Taught:
    """The flying parts of healthy flights, guarded, put aside as the logs are, with only those samples that they
    themselves, taken together, make believable, as in judging.

    Raises InputError with file, place and remedy for what a guard refuses; with `robust` it is left out instead, and
    InputError says so only if nothing remains.
    """
    shelf, left_out = shelf or Shelf(IN_MEMORY), list[str]()
    held = [hold(log, shelf) for log in logs]
    while robust and len(held) > 2 and (odd := odd_rate(held, window_s)) is not None:
        left_out.append(odd[1])
        del held[odd[0]]
    front, outputs = front_for(held, window_s, gate), outputs_in_use(held)

    def flown(logs: Iterable[HeldLog]) -> list[LearntFlight]:
        flights = []
        for log in logs:
            try:
                flights.append(airborne(front, log, shelf, outputs, _GLANCES))
            except InputError as error:
                if not robust:
                    raise
                left_out.append(str(error))
        give_back()
        return flights

    flights = flown(_without(held, repeated(held), shelf, robust, left_out))
    for guard in (upsets, turned, far_blocks):
        for _ in range(MAX_ROUNDS):  # the guard looks again at what remains
            findings = guard(flights)
            if not findings:
                break
            kept = _without([flight.held for flight in flights], findings, shelf, robust, left_out)
            same = {id(flight.held): [flight] for flight in flights}
            flights = [one for log in kept for one in same.get(id(log)) or flown([log])]
    if not flights:
        raise InputError(f"no healthy flight remains to learn from ({'; '.join(left_out)}); record others")
    front = replace(front, align=replace(front.align, quality=_quality_of(flights)))
    for i, flight in enumerate(flights):  # made anew only where that makes a difference
        if not adds_nothing(front.align.quality, flight.held.pieces()):
            flights[i] = airborne(front, flight.held, shelf, outputs)
    give_back()
    return Taught(front, tuple(flights), tuple(left_out))


def _quality_of(flights: Sequence[LearntFlight]) -> LinkQuality:
    """Which samples of the link the flights make believable."""
    flown = []
    for flight in flights:
        ends = [list(spans) for _, spans in itertools.groupby(_seen(flight, "spans"), key=lambda span: int(span[0]))]
        flown.append((flight.held, [(spans[0][1], spans[-1][2]) for spans in ends]))
    parts = [  # signal by signal, so that no more of the flights is in memory
        learnt_quality((held.open(signal), spans) for held, spans in flown)
        for signal in dict.fromkeys(signal for held, _ in flown for signal in held.signals)
    ]
    habits = tuple(habit for part in parts for habit in part.habits)
    step = max(part.resolution_rad_s for part in parts)
    return LinkQuality(habits=habits, jitter=max(part.jitter for part in parts), resolution_rad_s=step)


def one_vehicle(found: Taught, layout: RotorLayout | None, *, robust: bool) -> Taught:
    """The flights of one vehicle and set of propellers, by their trims; raises InputError as `taught` does."""
    findings = trim_groups(found.flights, layout)
    odd = {finding.number: finding for finding in findings if finding.refuses}
    if not robust:
        refuse(list(odd.values()), f"{LEAVE_OUT}; or learn a type with --fleet")
    flights = tuple(flight for number, flight in enumerate(found.flights) if number not in odd)
    notes = (*found.notes, *(str(finding) for finding in findings if not finding.refuses))
    return replace(found, flights=flights, left_out=(*found.left_out, *map(str, odd.values())), notes=notes)


def _without(
    logs: Sequence[HeldLog], findings: Sequence[Finding], shelf: Shelf, robust: bool, left_out: list[str]
) -> list[HeldLog]:
    """The logs without what the findings name, of which `left_out` takes a sentence each; refused unless `robust`."""
    if not robust:
        refuse(findings, LEAVE_OUT)
    left_out += [f"{finding.log}, {finding.place}: {finding.text}" for finding in findings]
    kept = []
    for number, log in enumerate(logs):
        places = [(finding.from_s, finding.to_s) for finding in findings if finding.number == number]
        if (None, None) not in places:
            for place in places:
                log = log.without(*place, shelf)
            kept.append(log)
    return kept


def refuse(findings: Sequence[Finding], more: str = "") -> None:
    """Raise InputError for what a guard found, with file, place, remedy and more; nothing if it found nothing."""
    if findings:
        others = f" (and {counted(len(findings) - 1, 'more such finding')})" if len(findings) > 1 else ""
        raise InputError(f"{findings[0]}{others}; {findings[0].remedy}{more}")
