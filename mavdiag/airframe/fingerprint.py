"""Does a flight look like the vehicle that a baseline was learnt from? The answer comes before any judgement.

A fingerprint is of each of `TRAITS` the mean over healthy flights and the spread between them. A damaged rotor is no
other vehicle, so only that counts which damage to one rotor does not do. It shifts the trim along the rotor's own
pattern: the best rise of one rotor is taken out of the shift, unless it is less than 0.025 and vibration is no higher.
It raises vibration and costs thrust: only lower noise and a lower throttle count. Only calm seconds count. Which
outputs move with roll and pitch tells motors on other outputs, where another order of them fits both clearly.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.airframe.airframe import UNNAMED
from mavdiag.airframe.detect import wired, wiring
from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import LEVEL_RATIO, MIN_OUTPUT, rises, shown_trim
from mavdiag.errors import InputError
from mavdiag.rows.answer import Answer, delay_of
from mavdiag.rows.block import OUTPUTS, Block
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import means_from, window_all, window_mean, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, Signal

FIRST_S = 20.0  # of judged flight that is compared (our choice)
MOTORS_S = 4.5  # of judged flight, which shows the motors, by their number and outputs, before a trim (our choice)
BORDERS_S = (MOTORS_S, 12.0, FIRST_S)  # of its parts: only the rows of the latest one are kept (our choice)
PART_S = 10.0  # of a learnt flight, by which its spread is measured: half of that, so that 30 s have three (our choice)
MOST_PARTS = 12  # of a flight: enough to see what it varies by (our choice)
SIGNIFICANT = 5.0  # spreads (our choice)
FAR_SPREADS = 8.0  # spreads (our choice)
LARGEST = 300.0  # of any figure, most of which are logarithms; the ratio of two is finite (our choice)
LATE_S = 0.03  # by which set-points are late; a circle with a crack was answered 21 ms sooner (our choice)
FAR_TRIM = 0.04  # of the hover command, roll and pitch counting a third; recorded sessions and weights stay below 0.03
DAMAGE_RISE = 0.025  # of the hover command: about what the rotor-trim monitor takes for a rise (our choice)
RAISED = math.log(1.5)  # of a noise: vibration that damage may have made (our choice)
OTHER_MOTORS = 2  # a quadrotor is no hexarotor
LEAST_OUTPUTS = 8  # that are looked at, so that a vehicle with more motors is known as another one (our choice)

CALM_RAD_S = 2.0  # rms of the body rates over a second (our choice)
TRIM_S = 1.0  # of one mean of the trim (our choice)
NOISE_WINDOW_S = 0.5  # of one rms of noise (our choice)
CALM_SHARE = 0.2  # the quantile of these rms that stands for calm flight (our choice)
RESOLUTION_SHARE = 0.05  # of the steps of a signal that may be smaller than its resolution (our choice)
ALIKE = 0.7  # of the logarithm of a motor's level over the motors' median: half to twice (our choice)
MOVES, BUSY = 0.2, 3  # of the rms of the third busiest: a rotor that fails and its opposite may be busier (our choice)


@dataclass(frozen=True, slots=True)
class Trait:
    """One figure of a vehicle, and how much lower or higher than the learnt one is near and far."""

    name: str
    floor: float  # of its spread between flights, by payload and wind (estimate)
    near_low: float = math.inf
    near_high: float = math.inf
    far_low: float = math.inf
    far_high: float = math.inf
    words: str = "{name} {times:.2g} times the learnt"  # how it differs; most are natural logarithms


DELAY = "set-point delay"
_PLAIN = "{name} {seen:+.3f} (learnt {learnt:+.3f} +- {spread:.3f})"
_MOTORS = "{seen:.0f} motors (learnt {learnt:.0f})"
_WIRED = "{name} wired otherwise (likeness {seen:.2f}, learnt {learnt:.2f})"
_1_5, _2, _20 = map(math.log, (1.5, 2, 20))

#: What `traits` gives, in this order; the limits are ours, held against recorded sessions, cuts, tape and weights.
TRAITS = (
    # median over seconds of the trim of the rotors [fraction of hover]
    *(Trait(f"{axis} trim", floor, words=_PLAIN) for axis, floor in (("roll", 0.01), ("pitch", 0.01), ("yaw", 0.002))),
    # rms of second differences of gyro [rad/s] and accelerometer [m/s^2] in calm flight; better balanced propellers
    # are quieter by 7
    *(Trait(f"gyro noise {axis}", 0.1, near_low=_2, far_low=_20) for axis in "pqr"),
    *(Trait(f"accelerometer noise {axis}", 0.1, near_low=_2, far_low=_20) for axis in "xyz"),
    # median thrust set-point; or mean output, which has a scale of its own, where there is none
    *(Trait(f"hover {what}", 0.03, math.log(1.15), math.log(1.4), _1_5) for what in ("throttle", "output")),
    # outputs that move like motors, whatever the layout; one that hangs follows no command
    Trait("motors", 0.1, OTHER_MOTORS, OTHER_MOTORS, far_high=OTHER_MOTORS, words=_MOTORS),
    # how far roll and pitch move the outputs as the layout says, -1..1, where any order of them fits (`detect.wired`)
    *(Trait(f"{axis} outputs", 0.05, far_low=0.65, words=_WIRED) for axis in ("roll", "pitch")),
    # how soon the rates follow the set-points [s], of the whole flight (`rows.answer`); no damage makes it less
    Trait(DELAY, 0.003, words=_PLAIN),
)
TRIM, NOISE, LEVELS, MOTORS = slice(0, 3), slice(3, 9), slice(9, 11), slice(11, 14)
Bends: TypeAlias = tuple[FloatArray, FloatArray]  # of `_bends`


@dataclass(frozen=True, slots=True)
class Figure:
    """One trait of a vehicle: its mean over the flights and its spread between them. Raises InputError on others."""

    name: str
    mean: float
    spread: float

    def __post_init__(self) -> None:
        if not (abs(self.mean) < LARGEST and 0.0 < self.spread < math.inf):
            raise InputError(f"fingerprint: {self.name} needs a mean within {LARGEST:g} and a positive, finite spread")


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """What healthy flights showed of their vehicle: the traits that at least one of them showed; how many flights."""

    figures: tuple[Figure, ...]
    flights: int


class Outcome(StrEnum):
    """FAR: beyond all that sessions of one vehicle were seen to do; it is refused. NEAR: judged, with a note."""

    ALIKE = "alike"
    NEAR = "near"
    FAR = "far"


@dataclass(frozen=True, slots=True)
class Likeness:
    """How a flight compares with a fingerprint: what follows, a phrase for each differing trait. late: set-points."""

    outcome: Outcome
    differing: tuple[str, ...] = ()
    late: bool = False

    def sentence(self, whose: str) -> str:
        """Say it for a report; empty if the flight looks like that vehicle. whose: its name."""
        if self.outcome is Outcome.ALIKE:
            return ""
        figures = ", ".join(self.differing)
        whose = "the baseline's" if whose == UNNAMED else whose
        if self.outcome is Outcome.FAR:
            what = "another link" if self.late else f"another vehicle: does not look like {whose}"
            return f"{what}: {figures}; judge it by a baseline of its own flights"
        return f"may be another vehicle than {whose}, or have new propellers or another load: {figures}"


def fingerprint_of(flights: Sequence[Sequence[Rows]], layout: RotorLayout | None) -> Fingerprint | None:
    """The fingerprint of the vehicle of some healthy flights; None if they show no trait.

    spread^2 = (floor^2 + sum over n flights of (x - mean)^2)/n + within^2, the variance between parts of one flight.
    """
    found, varied = [], []
    for flight in flights:
        parts = [_shown(part, layout) for part in _parts(flight)]
        found.append(_figures(parts, layout) if parts else traits(joined(flight), layout))
        varied.append(np.array([_figures([part], layout) for part in parts]).reshape(-1, len(TRAITS)))
    figures = []
    for i, (trait, column) in enumerate(zip(TRAITS, np.array(found).T, strict=True)):
        known = column[np.isfinite(column)]
        if len(known):
            mean = float(known.mean())
            between = (trait.floor**2 + float(np.square(known - mean).sum())) / len(known)
            figures.append(Figure(trait.name, mean, math.sqrt(between + _within([one[:, i] for one in varied]))))
    return Fingerprint(tuple(figures), len(flights)) if figures else None


def _within(parts: Sequence[FloatArray]) -> float:
    """The variance of a trait within a flight, from its values in the parts of each; 0 where none has two."""
    known = [values[np.isfinite(values)] for values in parts if np.isfinite(values).any()]
    freedom = sum(len(values) - 1 for values in known)
    return sum(len(values) * float(values.var()) for values in known) / freedom if freedom else 0.0


def merged(one: Fingerprint, other: Fingerprint | None) -> Fingerprint:
    """The fingerprint of the flights of both; sums of squares add, and the distance of the means counts as spread."""
    if other is None:
        return one
    theirs = {figure.name: figure for figure in other.figures}
    n, m = one.flights, other.flights
    figures = []
    for figure in one.figures:
        fresh = theirs.pop(figure.name, figure)
        apart = (fresh.mean - figure.mean) / (n + m)
        square = (n * figure.spread**2 + m * fresh.spread**2) / (n + m) + n * m * apart**2
        figures.append(Figure(figure.name, figure.mean + apart * m, math.sqrt(square)))
    return Fingerprint((*figures, *theirs.values()), n + m)


class _Shown(NamedTuple):
    """What the figures of a flight are made of, in some rows of it."""

    trim: FloatArray  # (k, 3) means over a calm second
    gyro: Bends
    felt: Bends
    thrust: FloatArray  # of calm rows
    levels: FloatArray  # the motors' mean outputs in them, where no thrust and the layout are known
    outputs: FloatArray  # (outputs, n) that are known
    wires: FloatArray  # as of `wiring`
    answers: FloatArray  # `Answer.sums`


class Beginning:
    """The first `FIRST_S` of judged flight, compared with a fingerprint as they come; the motors after `MOTORS_S`.

    Traits are taken of each part between `BORDERS_S`. whole: all of it has come; then only late set-points are told.
    """

    def __init__(self, learnt: Fingerprint, layout: RotorLayout | None) -> None:
        self.whole, self._layout, self._answer = False, layout, Answer()
        self._learnt = {one.name: (one.mean, one.spread) for one in learnt.figures}
        self._delay_s, spread_s = self._learnt.get(DELAY, (-math.inf, 0.0))
        self._least_s = self._delay_s - max(LATE_S, SIGNIFICANT * spread_s)
        self._rows, self._shown, self._valid = list[Rows](), list[_Shown](), 0  # of the latest part, before it, of both

    def take(self, rows: Rows) -> Likeness | None:
        """Take the next rows; the likeness once it is whole, or motors are another vehicle's, or set-points late."""
        if self._delay_s > -math.inf and self._answer.take(rows.block, self._least_s):
            by_ms = 1e3 * (self._delay_s - self._answer.delay_s)
            return Likeness(Outcome.FAR, (f"set-points {by_ms:.0f} ms later than learnt",), late=True)
        if self.whole:
            self._rows, self._shown = [], []
            return None
        block, first = rows.block, 0
        at = np.flatnonzero(block.valid)
        if not len(at) and not (self._rows and self._rows[-1].block.valid.any()):
            return None  # nothing is measured in it; one such block parts the others
        for border_s in BORDERS_S:
            border = window_rows(border_s, block.dt_s) - self._valid
            if 0 < border <= len(at):
                stop = int(at[border - 1]) + 1
                self._shown = self._seen(rows.part(first, stop))
                self._rows, self._valid = [], self._valid + border
                at, first, self.whole = at[border:], stop, border_s == FIRST_S
                found = self.likeness(motors=not self.whole) if border_s in (MOTORS_S, FIRST_S) else None
                if found is not None and (self.whole or found.outcome is Outcome.FAR):
                    return found
        block = rows.part(first, len(block)).block
        x = block.x[: OUTPUTS + block.outputs].copy()  # without the room
        self._rows.append(Rows(Block(block.segment, block.dt_s, block.t_ns, x, block.outputs), rows.rates_ns))
        self._valid += len(at)
        return None

    def likeness(self, *, motors: bool = False) -> Likeness:
        """How what has come compares; where it shows none of the traits it is alike.

        motors: only these count: how many there are, and on which outputs.
        """
        return _compared(_figures(self._seen(), self._layout, motors=motors), self._learnt, self._layout)

    def _seen(self, *latest: Rows) -> list[_Shown]:
        return [*self._shown, *(_shown(block, self._layout) for block in joined([*self._rows, *latest]))]


def compare(learnt: Fingerprint, flight: Sequence[Rows], layout: RotorLayout | None) -> Likeness:
    """Compare the beginning of judged flight with a fingerprint."""
    beginning = Beginning(learnt, layout)
    told = [found for rows in flight if (found := beginning.take(rows))]
    return told[-1] if told else beginning.likeness()


def _compared(seen: FloatArray, known: dict[str, tuple[float, float]], layout: RotorLayout | None) -> Likeness:
    """seen: as `traits` has them. known: mean and spread of those that are compared."""
    learnt, spread = np.array([known.get(trait.name, (math.nan, 1.0)) for trait in TRAITS]).T
    shift = seen - learnt
    far, near = _trim_differs(shift, spread, layout)
    worst = int(np.argmax(np.abs(shift[TRIM]) / spread[TRIM]))
    far_at, near_at = [worst] if far else [], [worst] if near and not far else []
    for i, trait in list(enumerate(TRAITS))[TRIM.stop :]:
        size, lower = abs(float(shift[i])), shift[i] < 0
        if size >= max(trait.far_low if lower else trait.far_high, SIGNIFICANT * spread[i]):
            far_at.append(i)
        elif size >= max(trait.near_low if lower else trait.near_high, SIGNIFICANT * spread[i]):
            near_at.append(i)
    outcome = Outcome.FAR if far_at else Outcome.NEAR if near_at else Outcome.ALIKE
    rows = [(TRAITS[i], seen[i], learnt[i], spread[i], math.exp(shift[i])) for i in (*far_at, *near_at)]
    told = (t.words.format(name=t.name, seen=x, learnt=mean, spread=sd, times=ratio) for t, x, mean, sd, ratio in rows)
    return Likeness(outcome, tuple(told))


def _trim_differs(shift: FloatArray, spread: FloatArray, layout: RotorLayout | None) -> tuple[bool, bool]:
    raised = bool(np.nanmax(np.append(shift[NOISE], -np.inf)) > RAISED)
    shift, spread = shift[TRIM], spread[TRIM]
    if layout is None or not np.isfinite(shift).all():
        return False, False
    level = np.array([LEVEL_RATIO, LEVEL_RATIO, 1.0])
    _, rest = _without_rotor(shift, level, layout)
    far = float(np.linalg.norm(rest / level)) > FAR_TRIM and float(np.linalg.norm(rest / spread)) > FAR_SPREADS
    rise, rest = _without_rotor(shift, spread, layout)
    if rise >= DAMAGE_RISE or raised:
        return far, float(np.linalg.norm(rest / spread)) > FAR_SPREADS
    return far, float(np.linalg.norm(shift / spread)) > SIGNIFICANT


def _without_rotor(shift: FloatArray, spread: FloatArray, layout: RotorLayout) -> tuple[float, FloatArray]:
    """The rise of one rotor, not below 0, that explains a shift of the trim best, and what it leaves of it, (3,).

    In yaw it is that or less, either way: a cut propeller loses drag as it loses thrust, a damaged one may gain drag.
    """
    C = layout.unmixing
    level = shift[:2] @ C[:2] / np.square(C[:2]).sum(axis=0)
    rise = np.maximum([rises(shift[None], layout, spread)[0], level], 0.0)  # (2, rotors)
    yaw = np.clip(shift[2], -rise * np.abs(C[2]), rise * np.abs(C[2]))
    rests = shift[:, None, None] - np.concatenate((rise * C[:2, None], yaw[None]))  # (3, 2, rotors)
    best = np.unravel_index(np.linalg.norm(rests / spread[:, None, None], axis=0).argmin(), rise.shape)
    return float(rise[best]), rests[:, *best]


def joined(flight: Sequence[Rows]) -> list[Block]:
    """The rows of a flight, one block a segment."""
    out = []
    for segment, rows in itertools.groupby(flight, key=lambda one: one.block.segment):
        blocks = [one.block for one in rows]
        if len(blocks) == 1:
            out.append(blocks[0])
            continue
        width, outputs = max(len(block.x) for block in blocks), max(block.outputs for block in blocks)
        x = np.full((width, sum(map(len, blocks))), np.nan)  # outputs may come later than the first rows
        t_ns, first = np.concatenate([block.t_ns for block in blocks]), 0
        for block in blocks:
            x[: len(block.x), first : first + len(block)] = block.x
            first += len(block)
        out.append(Block(segment, blocks[0].dt_s, t_ns, x, outputs))
    return out


def _parts(flight: Sequence[Rows]) -> Iterator[Block]:
    sizes = [(one.block.segment, len(one.block), one.block.dt_s) for one in flight]
    stops = np.cumsum([size for _, size, _ in sizes])
    places, begin = [], 0
    for (_, dt_s), some in itertools.groupby(sizes, key=lambda one: (one[0], one[2])):
        end, length = begin + sum(size for _, size, _ in some), window_rows(PART_S, dt_s)
        places += [(first, first + length) for first in range(begin, end - length + 1, length)]
        begin = end
    most = min(len(places), MOST_PARTS)
    for first, stop in (places[i * len(places) // most] for i in range(most)):
        low, high = np.searchsorted(stops, (first, stop - 1), side="right").tolist()
        begins = [(number, int(stops[number]) - sizes[number][1]) for number in range(low, high + 1)]
        own = [flight[number].part(max(first - at, 0), min(stop - at, sizes[number][1])) for number, at in begins]
        yield joined(own)[0]


def traits(blocks: Iterable[Block], layout: RotorLayout | None) -> FloatArray:
    """The figures of a flight, (len(TRAITS),), NaN where it does not show them. layout: None if it is not known."""
    return _figures([_shown(block, layout) for block in blocks], layout)


def _shown(block: Block, layout: RotorLayout | None) -> _Shown:
    calm, window, trim = _calm(block), window_rows(TRIM_S, block.dt_s), np.empty((0, 3))
    levels, wires, width = np.empty(0), np.zeros((2, LEAST_OUTPUTS)), block.actuator.shape[1]
    if layout is not None:
        wires = wiring(block, layout, max(layout.rotors, LEAST_OUTPUTS))
        values, known = shown_trim(block, layout)
        starts = np.flatnonzero(window_all(known & calm, window))[:: max(1, window // 4)]
        trim = means_from(values.T, starts, window).T
        if width and not np.isfinite(block.thrust[calm]).any():
            levels = block.actuator[calm, : layout.rotors].mean(axis=1)
    gyro, felt = (_bends(values.T, block.valid, block.dt_s) for values in (block.rate, block.force))
    (answer := Answer()).take(block)
    own = slice(None if layout is None else max(layout.rotors, LEAST_OUTPUTS))  # what judging takes (`chain.front_of`)
    outputs = np.compress(block.known(Signal.ACTUATOR, own) & block.valid, block.actuator.T[own], axis=1)
    return _Shown(trim, gyro, felt, block.thrust[calm], levels, outputs, wires, answer.sums)


def _figures(shown: Sequence[_Shown], layout: RotorLayout | None, *, motors: bool = False) -> FloatArray:
    """As `traits` has them. motors: only `MOTORS`, the others NaN."""
    figures = np.full(len(TRAITS), np.nan)
    wires = wired(np.sum([one.wires for one in shown], axis=0), layout) if layout and shown else (np.nan, np.nan)
    figures[MOTORS] = _motors([one.outputs for one in shown]), *wires
    if motors:
        return figures
    trim = np.concatenate([np.empty((0, 3)), *(one.trim for one in shown)])
    figures[TRIM] = np.median(trim, axis=0) if len(trim) else np.nan
    figures[NOISE] = *_noise([one.gyro for one in shown]), *_noise([one.felt for one in shown])
    figures[LEVELS] = _level([one.thrust for one in shown]), _level([one.levels for one in shown])
    figures[-1] = delay_of(sum((one.answers for one in shown), Answer().sums))
    return figures


def _calm(block: Block) -> BoolArray:
    """(n,) valid rows that begin a second of less than CALM_RAD_S rms: the vehicle does not tumble."""
    if not len(block):
        return block.valid
    window = min(window_rows(TRIM_S, block.dt_s), len(block))
    squares = window_mean(np.square(block.rate.T).sum(axis=0)[:, None], window)[:, 0]
    squares = np.pad(squares, (0, len(block) - len(squares)), mode="edge")
    return np.asarray(block.valid & (squares < CALM_RAD_S**2), dtype=np.bool_)


def _bends(values: FloatArray, valid: BoolArray, dt_s: float) -> Bends:
    """(3, w) mean squares of second differences over windows of (3, n) rows, and (3, k) sizes of steps."""
    known, window = valid & np.isfinite(values[2]), window_rows(NOISE_WINDOW_S, dt_s)
    steps = np.diff(values)
    bends = np.where(window_all(known, 3), np.square(np.diff(steps)), np.nan)
    starts = np.arange(0, bends.shape[1] - window + 1, max(1, window // 2))
    return means_from(bends, starts, window), np.abs(np.compress(window_all(known, 2), steps, axis=1))


def _noise(found: Sequence[Bends]) -> FloatArray:
    """(3,) log rms of second differences in the calmest fifth of windows, at least that of a rounding, q^2/2."""
    none = np.empty((3, 0))
    squares, steps = (np.concatenate((none, *parts), axis=1) for parts in zip((none, none), *found, strict=True))
    levels = []
    for square, step in zip(squares, steps, strict=True):
        square = square[np.isfinite(square)]
        calm, moved = float(np.quantile(square, CALM_SHARE)) if len(square) else 0.0, np.count_nonzero(step)
        finer = np.count_nonzero(step <= math.sqrt(2.0 * calm)) - (len(step) - moved)
        if len(square) and finer <= RESOLUTION_SHARE * (moved - 1):  # only then is the resolution needed
            calm = float(np.quantile(step[step > 0], RESOLUTION_SHARE, method="lower")) ** 2 / 2
        levels.append(0.5 * math.log(calm) if calm > 0 else math.nan)
    return np.array(levels)


def _level(found: Sequence[FloatArray]) -> float:
    """Logarithm of the median level in flight; NaN where none is known."""
    levels = np.concatenate([np.empty(0), *found])
    known = levels[np.isfinite(levels) & (levels > MIN_OUTPUT)]
    return math.log(float(np.median(known))) if len(known) else math.nan


def _motors(sent: Sequence[FloatArray]) -> float:
    """How many outputs move, at about the same level; NaN if none is sent."""
    width = min((len(outputs) for outputs in sent), default=0)
    outputs = np.concatenate([np.empty((width, 0)), *(one[:width] for one in sent)], axis=1)
    if not outputs.size:
        return math.nan
    level, moves = outputs.mean(axis=1), outputs.std(axis=1)
    moving = (level > MIN_OUTPUT) & (moves > MOVES * np.sort(np.where(level > MIN_OUTPUT, moves, 0.0))[-BUSY:][0])
    if not moving.any():
        return 0.0
    ratio = np.maximum(level, MIN_OUTPUT) / float(np.median(level[moving]))
    return float(np.count_nonzero(moving & (np.abs(np.log(ratio)) < ALIKE)))
