"""What one flight shows of its vehicle: a figure for each trait, whatever was flown.

The trim of the rotors, the noise floors of the sensors, how far the vehicle follows its commanded rates, how strongly
it turns for a command, and what it takes to hover. Each is a plain number; a trait that the flight does not show is
NaN. `mavdiag.airframe.fingerprint` compares flights by them.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import MIN_OUTPUT, shown_trim
from mavdiag.rows.block import COLUMNS, Block
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateBlock
from mavdiag.rows.windows import spans, window_all, window_mean, window_rows
from mavdiag.telemetry import BoolArray, FloatArray

__all__ = ["TRAITS", "Trait", "beginning", "joined", "joined_rates", "traits", "traits_of_parts"]

CALM_RAD_S = 2.0  # rms of the body rates over a second (our choice)
TRIM_S = 1.0  # of one mean of the trim (our choice)
NOISE_WINDOW_S = 0.5  # of one rms of noise (our choice)
CALM_SHARE = 0.2  # the quantile of these rms that stands for calm flight (our choice)
SLOW_S = 0.3  # means of the rates that are compared for the gain (our choice)
MOST_LAG_S = 0.4  # between commanded and measured rate (our choice)
RESOLUTION_SHARE = 0.05  # of the steps of a signal that may be smaller than its resolution (our choice)
GAIN_CORRELATION = 0.9  # of commanded and measured slow rates; with less the gain is that of noise (our choice)
TURN_S = 0.1  # means of the gyro whose difference is the angular acceleration (our choice)
TURN_LAG_S = 0.2  # between outputs and acceleration (our choice)
TURN_CORRELATION = 0.7  # of outputs and acceleration (our choice)
LAG_STEP_S = 0.02
MOST_PARTS = 12  # of a flight: enough to see what it varies by (our choice)
PIECE_S = 2.0  # shortest unbroken flight that gives a slope (our choice)
ALIKE = 0.7  # of the logarithm of a motor's level over the motors' median: half to twice (our choice)
MOVES = 0.2  # of the busiest motor's rms (our choice)


def joined(flight: Sequence[Rows]) -> list[Block]:
    """The rows of a flight, one block a segment."""
    out = []
    for segment, rows in itertools.groupby(flight, key=lambda one: one.block.segment):
        blocks = [one.block for one in rows]
        out.append(blocks[0] if len(blocks) == 1 else _together(segment, blocks))
    return out


def _together(segment: int, blocks: Sequence[Block]) -> Block:
    outputs = max(one.actuator.shape[1] for one in blocks)  # rows before the first message have no column
    same = [replace(one, actuator=_widened(one.actuator, outputs)) for one in blocks]
    columns = (np.concatenate([getattr(one, name) for one in same]) for name in COLUMNS)
    return Block(segment, blocks[0].dt_s, *columns)


def _widened(x: FloatArray, columns: int) -> FloatArray:
    return np.pad(x, ((0, 0), (0, columns - x.shape[1])), constant_values=np.nan)


def joined_rates(flight: Sequence[Rows]) -> list[RateBlock]:
    """The rates of a flight, one block a segment."""
    out = []
    for segment, rows in itertools.groupby(flight, key=lambda one: one.block.segment):
        blocks = [one.rates for one in rows]
        columns = (np.concatenate([getattr(one, field.name) for one in blocks]) for field in fields(RateBlock)[2:])
        out.append(RateBlock(segment, blocks[0].dt_s, *columns))
    return out


@dataclass(frozen=True, slots=True)
class Trait:
    """name: how a text calls it. log: its figure is a natural logarithm, and a text gives the ratio."""

    name: str
    log: bool = False


TRAITS: tuple[Trait, ...] = (
    *(Trait(f"{axis} trim") for axis in ("roll", "pitch", "yaw")),
    *(Trait(f"gyro noise {axis}", log=True) for axis in "pqr"),
    *(Trait(f"accelerometer noise {axis}", log=True) for axis in "xyz"),
    *(Trait(f"{axis} gain", log=True) for axis in ("roll", "pitch")),
    *(Trait(f"{axis} authority", log=True) for axis in ("roll", "pitch")),
    Trait("hover throttle", log=True),
    Trait("motors"),
)
"""What `traits` gives, in this order.

trim: median over seconds of the trim of the rotors [fraction of hover].
noise: rms of the second differences of gyro [rad/s] and accelerometer [m/s^2] in calm flight.
gain: of slow measured rates on slow commanded rates.
authority: angular acceleration for a unit of trim [rad/s^2].
hover throttle: median mean output, or thrust set-point.
motors: outputs that move like motors, whatever the layout.
"""


def traits(flight: Sequence[Rows], layout: RotorLayout | None) -> FloatArray:
    """The figures of a flight, (len(TRAITS),), NaN where it does not show them. layout: None if it is not known."""
    return _traits(joined(flight), joined_rates(flight), layout)


def traits_of_parts(flight: Sequence[Rows], layout: RotorLayout | None, span_s: float) -> FloatArray:
    """The figures of parts of a flight that are so long [s] each, (parts, len(TRAITS)): what a vehicle varies by as it
    flies. At most `MOST_PARTS`, over the whole flight; none of a flight that is shorter."""
    blocks, rates = joined(flight), {one.segment: one for one in joined_rates(flight)}
    places = [
        (block, first, first + length)
        for block in blocks
        if (length := window_rows(span_s, block.dt_s))
        for first in range(0, len(block) - length + 1, length)
    ]
    chosen = [places[i * len(places) // MOST_PARTS] for i in range(MOST_PARTS)] if len(places) > MOST_PARTS else places
    found = [np.empty((0, len(TRAITS)))]
    for block, first, stop in chosen:
        own = rates.get(block.segment)
        edges = [] if own is None else np.searchsorted(own.t_ns, block.t_ns[[first, stop - 1]]).tolist()
        turning = [] if own is None else [_rate_rows(own, *edges)]
        found.append(_traits([block.rows(first, stop)], turning, layout)[None])
    return np.concatenate(found)


def _traits(blocks: Sequence[Block], rates: Sequence[RateBlock], layout: RotorLayout | None) -> FloatArray:
    calm = [_calm(block) for block in blocks]
    trims = [] if layout is None else [shown_trim(block, layout) for block in blocks]
    means = (
        _means(value, known & ok, block.dt_s) for block, ok, (value, known) in zip(blocks, calm, trims, strict=False)
    )
    trim = np.concatenate([np.empty((0, 3)), *means])
    turning = [(block, value, known) for block, (value, known) in zip(blocks, trims, strict=False)]
    return np.array(
        [
            *(np.median(trim, axis=0) if len(trim) else np.full(3, np.nan)),
            *_noise([(block.rate, block.valid) for block in blocks], blocks),
            *_noise([(block.force, block.valid & np.isfinite(block.force[:, 2])) for block in blocks], blocks),
            *(_gain(rates, axis) for axis in (0, 1)),
            *(_authority(turning, axis) for axis in (0, 1)),
            _throttle(blocks, calm, layout),
            _motors(blocks),
        ]
    )


def _calm(block: Block) -> BoolArray:
    """(n,) valid rows that begin a second of less than CALM_RAD_S rms: the vehicle does not tumble."""
    window = min(window_rows(TRIM_S, block.dt_s), len(block))
    squares = window_mean(np.square(block.rate).sum(axis=1)[:, None], window)[:, 0] if window else np.empty(0)
    squares = np.append(squares, np.repeat(squares[-1:], len(block) - len(squares)))
    return np.asarray(block.valid & (squares < CALM_RAD_S**2), dtype=np.bool_)


def _means(values: FloatArray, known: BoolArray, dt_s: float) -> FloatArray:
    """(w, 3) means over a second, of what is known throughout."""
    window = window_rows(TRIM_S, dt_s)
    whole = window_all(known, window)
    means: FloatArray = window_mean(values, window)[whole]
    return means[:: max(1, window // 4)]


def beginning(flight: Sequence[Rows], span_s: float) -> list[Rows]:
    """The first rows of a flight that hold so much valid flight [s]."""
    out: list[Rows] = []
    left_s = span_s
    for number, rows in enumerate(flight):
        block = rows.block
        seen_s = np.cumsum(block.valid) * block.dt_s
        stop = int(np.searchsorted(seen_s, left_s, side="right"))
        if stop < len(block):
            out.append(_until(rows, block.rows(0, stop), int(block.t_ns[stop])))
            later = (one for one in flight[number + 1 : number + 3] if one.block.segment == block.segment)
            out += [_until(one, one.block.rows(0, 0), int(block.t_ns[stop])) for one in later]
            break
        out.append(rows)
        left_s -= float(seen_s[-1]) if len(seen_s) else 0.0
    return out


def _until(rows: Rows, block: Block, stop_ns: int) -> Rows:
    """That block, with the rates of the rows before a time; they come half a window later, with the next rows."""
    return Rows(block, _rate_rows(rows.rates, 0, int(np.searchsorted(rows.rates.t_ns, stop_ns))))


def _rate_rows(rates: RateBlock, first: int, stop: int) -> RateBlock:
    columns = (getattr(rates, field.name)[first:stop] for field in fields(RateBlock)[2:])
    return RateBlock(rates.segment, rates.dt_s, *columns)


def _noise(signals: Sequence[tuple[FloatArray, BoolArray]], blocks: Sequence[Block]) -> FloatArray:
    """(3,) logarithm of the rms of second differences in the calmest fifth of half-second windows.

    What is quieter than its resolution q shows q alone: a rounding has the variance q^2/12, a second difference six
    times that.
    """
    found, steps = [np.empty((0, 3))], [np.empty((0, 3))]
    for (values, known), block in zip(signals, blocks, strict=True):
        steps.append(np.abs(np.diff(values, axis=0)[window_all(known, 2)]))
        window = window_rows(NOISE_WINDOW_S, block.dt_s)
        squares = np.where(window_all(known, 3)[:, None], np.square(np.diff(values, n=2, axis=0)), np.nan)
        found.append(window_mean(squares, window)[:: max(1, window // 2)])
    pairs = zip(np.concatenate(found).T, np.concatenate(steps).T, strict=True)
    return np.array([_log_root(column[np.isfinite(column)], _resolution(step)) for column, step in pairs])


def _resolution(steps: FloatArray) -> float:
    """The smallest step between samples, but for a few that interpolation made; 0 if there is none."""
    moved = steps[steps > 0]
    return float(np.quantile(moved, RESOLUTION_SHARE, method="lower")) if len(moved) else 0.0


def _log_root(squares: FloatArray, resolution: float) -> float:
    calm = max(float(np.quantile(squares, CALM_SHARE)), resolution**2 / 2) if len(squares) else 0.0
    return 0.5 * math.log(calm) if calm > 0 else math.nan


def _gain(rates: Sequence[RateBlock], axis: int) -> float:
    """Logarithm of the gain of slow measured rates on slow commanded ones."""
    pairs = []
    for one in rates:
        window = window_rows(SLOW_S, one.dt_s)
        for first, stop in spans(one.commanded):
            if stop - first > window_rows(PIECE_S, one.dt_s):
                slow = window_mean(np.stack((one.u[first:stop, axis], one.y[first:stop, axis]), axis=1), window)
                pairs.append((slow[:, 0] - slow[:, 0].mean(), slow[:, 1] - slow[:, 1].mean()))
    return _slope(pairs, rates[0].dt_s, MOST_LAG_S, GAIN_CORRELATION) if pairs else math.nan


def _authority(turning: Sequence[tuple[Block, FloatArray, BoolArray]], axis: int) -> float:
    """Logarithm of the angular acceleration for a unit of trim."""
    pairs = []
    for block, trim, known in turning:
        window = window_rows(TURN_S, block.dt_s)
        for first, stop in spans(known & block.valid):
            if stop - first > window_rows(PIECE_S, block.dt_s):
                rate = window_mean(block.rate[first:stop, axis : axis + 1], window)[:, 0]
                faster = (rate[window:] - rate[:-window]) / (window * block.dt_s)
                command = window_mean(trim[first:stop, axis : axis + 1], 2 * window)[: len(faster), 0]
                pairs.append((command - command.mean(), faster[: len(command)] - faster.mean()))
    return _slope(pairs, turning[0][0].dt_s, TURN_LAG_S, TURN_CORRELATION) if pairs else math.nan


def _slope(pairs: Sequence[tuple[FloatArray, FloatArray]], dt_s: float, most_lag_s: float, least: float) -> float:
    """Logarithm of the least-squares slope of y on x at the lag where they correlate best; NaN if below `least`."""
    best, slope = 0.0, math.nan
    sums = [tuple(np.append(0.0, np.cumsum(np.square(one))) for one in pair) for pair in pairs]
    for lag in range(0, window_rows(most_lag_s, dt_s) + 1, window_rows(LAG_STEP_S, dt_s)):
        kept = [i for i, (x, _) in enumerate(pairs) if len(x) > 2 * lag]
        # einsum and not @: BLAS threads for so many rows, which costs more than it saves
        xy = sum(float(np.einsum("n,n->", pairs[i][0][: len(pairs[i][0]) - lag], pairs[i][1][lag:])) for i in kept)
        xx = sum(float(sums[i][0][len(pairs[i][0]) - lag]) for i in kept)
        yy = sum(float(sums[i][1][-1] - sums[i][1][lag]) for i in kept)
        if xx > 0 and yy > 0 and xy / math.sqrt(xx * yy) > best:
            best, slope = xy / math.sqrt(xx * yy), xy / xx
    return math.log(slope) if best >= least else math.nan


def _throttle(blocks: Sequence[Block], calm: Sequence[BoolArray], layout: RotorLayout | None) -> float:
    """Logarithm of the median thrust set-point in flight, or of the motors' mean output where there is none."""
    thrust = np.concatenate([np.empty(0), *(b.thrust[ok] for b, ok in zip(blocks, calm, strict=True))])
    if not np.isfinite(thrust).any() and layout is not None:
        outputs = [b.actuator[ok, : layout.rotors] for b, ok in zip(blocks, calm, strict=True)]
        thrust = np.concatenate([np.empty(0), *(one.mean(axis=1) for one in outputs if one.shape[1])])
    known = thrust[np.isfinite(thrust) & (thrust > MIN_OUTPUT)]
    return math.log(float(np.median(known))) if len(known) else math.nan


def _motors(blocks: Sequence[Block]) -> float:
    """How many outputs move, at about the same level; NaN if none is sent."""
    width = min((block.actuator.shape[1] for block in blocks), default=0)
    if not width:
        return math.nan
    outputs = np.concatenate([block.actuator[block.valid, :width] for block in blocks])
    outputs = outputs[np.isfinite(outputs).all(axis=1)]
    if not len(outputs):
        return math.nan
    level, moves = outputs.mean(axis=0), outputs.std(axis=0)
    moving = (level > MIN_OUTPUT) & (moves > MOVES * np.where(level > MIN_OUTPUT, moves, 0.0).max())
    if not moving.any():
        return 0.0
    ratio = np.maximum(level, MIN_OUTPUT) / float(np.median(level[moving]))
    return float(np.count_nonzero(moving & (np.abs(np.log(ratio)) < ALIKE)))
