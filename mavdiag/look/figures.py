"""What the rows of one flight, a block a segment, show without a baseline, as values. Nothing here is a verdict."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import MIN_OUTPUT, shown_trim
from mavdiag.monitors.rotor_speed import MADE_UP_RAD_S
from mavdiag.rows.block import Block
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Batch, BoolArray, FloatArray, Signal, Telemetry

# ArduPilot's own advice on the message VIBRATION (wiki, "Measuring Vibration"): up to 30 m/s^2 is normally acceptable,
# above 30 there may be problems, above 60 there nearly always are.
VIBRATION_USUAL, VIBRATION_HIGH = 30.0, 60.0
FULL, IDLE = 0.98, 0.06  # an output at its upper or its lower end (our choice)
HELD_S = 0.3  # or at a limit of the mixer: it stands still for so long, as no motor in flight does (our choice)
AWAY = 0.5  # and by more than this share of the mean beside it (our choice)
LEAST_S = 2.0  # of unbroken flight that a line is looked for in (our choice)
SPECTRUM_S = 1.0  # of one window of a spectrum, so 1 Hz wide lines: as narrow as a rotor's speed is steady (our choice)
LEAST_ROWS = 8  # of a window: fewer show no line
LINE_FROM_HZ = 25.0  # slower rotors fly nothing that this tool is for (our choice)
LINE_TO = 0.45  # of the sample rate
AROUND = 0.2  # of the frequency: the neighbourhood that a line is compared with (our choice)
LINE_DB = 10.0  # above its neighbourhood (our choice)
HARMONICS = 3


@dataclass(frozen=True, slots=True)
class OutputLoad:
    """One motor's output in flight, 0..1; its mean over that of all, less 1; share of the flight at an end."""

    number: int  # of the rotor where the layout is known, else of the output, from 1
    mean: float
    over_mean: float
    full_share: float
    idle_share: float


@dataclass(frozen=True, slots=True)
class Vibration:
    """Median and 95th percentile of x, y, z [m/s^2]; share of the time with an axis above 30 or 60 m/s^2."""

    median: tuple[float, ...]
    high: tuple[float, ...]
    above_usual: float
    above_high: float


@dataclass(frozen=True, slots=True)
class RotorLine:
    """The strongest line in the spectrum of the accelerometer's x and y, or the reason why none can be seen."""

    hz: float  # where it is; NaN if there is none
    db: float  # above its neighbourhood
    harmonics: tuple[int, ...]  # which of 2 and 3 times its frequency stand out as well
    told_hz: float  # as `told_hz`
    from_hz: float  # where it was looked for
    to_hz: float
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Density of x and y over frequency, (n, 2) [(m/s^2)^2/Hz], averaged over so many windows."""

    frequency_hz: FloatArray
    power: FloatArray
    averaged: int


def told_hz(telemetry: Telemetry) -> float:
    """Mean speed of the rotors that turn, as the vehicle tells it [Hz]; NaN if it does not, or if PX4 makes it up."""
    speeds, outputs = telemetry.get(Signal.ROTOR_SPEED), telemetry.get(Signal.ACTUATOR)
    if speeds is None or not (np.nan_to_num(speeds.values) > 0).any():
        return math.nan
    told = speeds.values[np.nan_to_num(speeds.values) > 0]
    if outputs is not None and len(outputs):
        latest = np.maximum(np.searchsorted(outputs.t_ns, speeds.t_ns, side="right") - 1, 0)
        both = min(speeds.values.shape[1], outputs.values.shape[1])
        made_up = MADE_UP_RAD_S * outputs.values[latest, :both]
        turning = made_up > MADE_UP_RAD_S * IDLE
        if turning.any() and np.nanmedian(np.abs(speeds.values[:, :both][turning] / made_up[turning] - 1)) < 0.01:
            return math.nan
    return float(told.mean() / math.tau)


def output_loads(flight: Sequence[Block], motors: Sequence[int]) -> tuple[OutputLoad, ...]:
    """The load of each motor's output in flight; none where there are no outputs. motors: their columns, from 0."""
    parts = [(outputs, block.dt_s) for block in flight if (outputs := _outputs(block, motors)).size]
    if not parts:
        return ()
    outputs = np.concatenate([part for part, _ in parts])
    still = np.concatenate([_standing(part, dt_s) for part, dt_s in parts])
    means, level = outputs.mean(axis=0), float(outputs.mean(axis=0).mean())
    full = (outputs >= FULL) | (still & (outputs > (1 + AWAY) * level))
    idle = (outputs <= IDLE) | (still & (outputs < (1 - AWAY) * level))
    columns = (means, means / level - 1, full.mean(axis=0), idle.mean(axis=0))
    return tuple(OutputLoad(n + 1, *map(float, of)) for n, *of in zip(motors, *columns, strict=True))


def trim(flight: Sequence[Block], layout: RotorLayout) -> Mapping[str, float] | None:
    """Mean roll, pitch and yaw trim of the rotors [fraction of hover]; None where nothing shows it."""
    values = [value[known] for value, known in (shown_trim(block, layout) for block in flight)]
    if not sum(map(len, values)):
        return None
    return dict(zip(("roll", "pitch", "yaw"), np.concatenate(values).mean(axis=0).tolist(), strict=True))


def vibration(flight: Sequence[Block]) -> Vibration | None:
    """The autopilot's own vibration level in flight; None if it does not send it."""
    levels = [block.vibration[block.valid & block.known(Signal.VIBRATION)] for block in flight]
    if not sum(map(len, levels)):
        return None
    level = np.concatenate(levels)
    median, high = np.percentile(level, (50, 95), axis=0)
    above_usual, above_high = (float((level.max(axis=1) > limit).mean()) for limit in (VIBRATION_USUAL, VIBRATION_HIGH))
    return Vibration(tuple(median.tolist()), tuple(high.tolist()), above_usual, above_high)


def spectrum_of(flight: Sequence[Block], least_s: float = SPECTRUM_S) -> Spectrum | None:
    """Spectrum of the accelerometer's x and y, by Welch's averages over stretches of `least_s` [s] or more."""
    stretches = list[FloatArray]()
    for block in flight:
        least = max(round(SPECTRUM_S / block.dt_s), least_s / block.dt_s)
        found = spans(block.valid & np.isfinite(block.force[:, :2]).all(axis=1))
        stretches += [block.force[first:stop] for first, stop in found if stop - first >= least]
    return _welch(stretches, 1 / flight[0].dt_s) if flight else None


def _welch(stretches: Sequence[FloatArray], rate_hz: float) -> Spectrum | None:
    """Windows of `SPECTRUM_S`, or as long as the shortest stretch; None if they show no line."""
    from scipy.signal import welch  # here, for it takes a second to load

    hz, power, averaged = np.empty(0), np.empty(0), 0
    width = min([round(SPECTRUM_S * rate_hz), *map(len, stretches)])
    for force in stretches if width >= LEAST_ROWS else ():
        count = (len(force) - width // 2) // (width - width // 2)
        hz, density = welch(force[:, :2], rate_hz, nperseg=width, axis=0)
        power = count * density + (power if averaged else 0.0)
        averaged += count
    return Spectrum(hz, power / averaged, averaged) if averaged else None


def rotor_line(
    flight: Sequence[Block], corner_hz: float | None, told_hz: float, batches: Sequence[Batch] = ()
) -> RotorLine:
    """The line of the rotors. corner_hz: of the low-pass in the IMU stream, if one is known. told_hz: as `told_hz`.

    batches: raw samples of the log; those of the flight are looked at in place of the stream.
    """
    raw = [one for one in batches if flight and flight[0].t_ns[0] <= one.t_ns <= flight[-1].t_ns[-1]]
    raw = [one for one in raw if one.rate_hz == raw[0].rate_hz]
    rate_hz, corner_hz = (raw[0].rate_hz, None) if raw else (1 / flight[0].dt_s if flight else 0.0, corner_hz)
    to_hz = min(LINE_TO * rate_hz, math.inf if corner_hz is None else corner_hz) if flight else LINE_FROM_HZ

    def none(reason: str) -> RotorLine:
        return RotorLine(math.nan, math.nan, (), told_hz, LINE_FROM_HZ, to_hz, reason)

    if not flight:
        return none("there is no flight in it")
    if to_hz <= 1.5 * LINE_FROM_HZ:
        slow = corner_hz is None or corner_hz > to_hz
        why = f"accelerometer comes at {rate_hz:.0f} Hz" if slow else f"IMU stream is low-passed at {corner_hz:g} Hz"
        return none(f"the {why}, which shows no rotor's line")
    spectrum = _welch([one.force for one in raw], rate_hz) if raw else spectrum_of(flight, LEAST_S)
    if spectrum is None:
        return none(f"there are no {LEAST_S:g} s of unbroken flight with an accelerometer")
    hz, excess = spectrum.frequency_hz, _above_neighbours(spectrum)
    best = int(np.argmax(np.where((hz >= LINE_FROM_HZ) & (hz <= to_hz), excess, -np.inf)))
    if excess[best] < LINE_DB:
        return none(f"no line stands {LINE_DB:g} dB above its neighbourhood")
    near = [(np.abs(hz - n * hz[best]) <= 0.02 * n * hz[best]) & (hz <= to_hz) for n in range(2, HARMONICS + 1)]
    heard = tuple(n for n, at in enumerate(near, start=2) if at.any() and excess[at].max() >= LINE_DB)
    return RotorLine(float(hz[best]), float(excess[best]), heard, told_hz, LINE_FROM_HZ, to_hz)


def _standing(outputs: FloatArray, dt_s: float) -> BoolArray:
    """(n, k) whether an output keeps its value for `HELD_S` or longer around this row."""
    standing = np.zeros(outputs.shape, dtype=np.bool_)
    for column, found in zip(outputs.T, standing.T, strict=True):
        lengths = np.diff(np.flatnonzero(np.diff(column, prepend=np.nan, append=np.nan)))
        found[:] = np.repeat(lengths * dt_s >= HELD_S, lengths)
    return standing


def _outputs(block: Block, motors: Sequence[int]) -> FloatArray:
    if block.actuator.shape[1] <= max(motors, default=-1) or not motors:
        return np.empty((0, len(motors)))
    outputs = block.actuator[:, list(motors)]
    turning = block.valid & np.isfinite(outputs).all(axis=1) & (outputs.mean(axis=1) > MIN_OUTPUT)
    return np.asarray(outputs[turning], dtype=np.float64)


def _above_neighbours(spectrum: Spectrum) -> FloatArray:
    """How far x and y together stand above the median of the neighbourhood at each frequency [dB]."""
    hz, power = spectrum.frequency_hz, spectrum.power.sum(axis=1)
    reach = np.maximum(AROUND * hz, 5 * hz[1])
    around = zip(np.searchsorted(hz, hz - reach), np.searchsorted(hz, hz + reach), strict=True)
    floor = np.array([np.median(power[first:stop]) for first, stop in around])
    tiny = np.finfo(np.float64).tiny
    return np.asarray(10 * np.log10(np.maximum(power, tiny) / np.maximum(floor, tiny)), dtype=np.float64)
