"""Are the units what they are taken for? Gravity weighs the accelerometer, the attitude's slope the gyro.

A vehicle that stands or hovers feels 1 g: how many counts that is tells what the counts are. The gyro integrates to the
change of attitude: their ratio gives its scale and sign, and the shift at which both agree best its delay.
"""

import math
from dataclasses import dataclass

import numpy as np

from mavdiag.rows.rates import body_rates
from mavdiag.telemetry import FloatArray, Series
from mavdiag.units import NS_PER_S, G

CONTRARY = 1.4  # an acceleration so many times off 1 g is of another scale; 2048/1000 counts are 2.05 (our choice)
ALIKE = 0.1  # counts this near to a known scale are of it (our choice: hovering does not weigh better)
LAGS_S = np.arange(-0.2, 0.2001, 0.002)  # delays that are tried
LEAST_MOTION = 0.02  # rad/s, standard deviation of a rate below which it says nothing of the gyro (our choice)
LEAST_STEPS = 50  # of the attitude
SPAN_S = 0.1  # of a slope, or one step: over less, a rounded or noisy attitude has slopes of its own (our choice)
SLOWEST_S = 0.06  # between two of the gyro: more hides the motion in between (our choice: the monitors need 20 Hz)
STEEP_RAD = 1.0  # of roll or pitch: beyond it Euler angles turn faster than a slope shows (our choice)
SPIKE = 10.0  # times the step that 95 % stay below: a sample so far outside its neighbours is damage (our choice)
MOST_STEPS = 2000  # of the slopes about each axis that are compared: those farthest from their mean
SURE = 0.8  # correlation below which scale and delay are not believed (our choice)
SCALE_OK = 0.2  # a scale this near to 1 is right: filters and slow attitude streams take their part (our choice)
USUAL = 3.0  # slopes over more than this multiple of the median span a gap (our choice)

# Counts of 1 g, and what they are. Two's complement of 16 bits over the full scale of the sensor.
_SCALES = (
    (1000.0, "milli-g, as ArduPilot sends it"),
    (1365.0, "16 bits over 24 g (BMI088)"),
    (2048.0, "16 bits over 16 g (IIM-42652, ICM-20689, MPU-6000)"),
    (4096.0, "16 bits over 8 g"),
    (8192.0, "16 bits over 4 g"),
    (16384.0, "16 bits over 2 g"),
)
# How many times too large a gyro may come, and what it is then.
_RATES = (
    (180.0 / np.pi, "deg/s"),
    (np.pi / 180.0, "rad/s taken for deg/s"),
    (1000.0, "mrad/s"),
    (1e-3, "rad/s taken for mrad/s"),
)


def scale_of(counts: float) -> str:
    """What counts of 1 g are.

    >>> scale_of(2061.0), scale_of(3000.0)
    ('16 bits over 16 g (IIM-42652, ICM-20689, MPU-6000)', 'of no known scale')
    """
    return next((name for one, name in _SCALES if abs(counts / one - 1.0) <= ALIKE), "of no known scale")


def gravity_of(force: FloatArray) -> float:
    """What a vehicle feels [g]: the norm of the mean of (n, 3) specific forces [m/s^2], which no vibration raises."""
    return float(np.linalg.norm(force.mean(axis=0))) / G


@dataclass(frozen=True, slots=True)
class AxisCheck:
    """The gyro about one axis (roll, pitch or yaw) beside the slope of the attitude."""

    axis: str
    scale: float | None  # gyro over slope, with its sign; None where the axis hardly moved or both do not agree
    delay_s: float | None  # how much later the gyro is stamped; None likewise
    verdict: str  # one phrase


def gyro_checks(gyro: Series, attitude: Series) -> tuple[AxisCheck, ...]:
    """Scale, sign and delay of the gyro, by axis; empty where too little of either came, or too slow a gyro.

    The slope of the attitude over `SPAN_S`, as body rates, is compared with the mean gyro in between.
    """
    t_ns, first = np.unique(attitude.t_ns, return_index=True)
    gyro_ns, own = np.unique(gyro.t_ns, return_index=True)
    if len(t_ns) < LEAST_STEPS or len(gyro_ns) < LEAST_STEPS or np.median(np.diff(gyro_ns)) > SLOWEST_S * NS_PER_S:
        return ()
    angles, t = _sound(np.unwrap(attitude.values[first], axis=0)), (t_ns - t_ns[0]) / NS_PER_S
    gyro_s, rate = (gyro_ns - t_ns[0]) / NS_PER_S, _sound(gyro.values[own])
    turned = np.pad(np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(gyro_s)[:, None], axis=0), ((1, 0), (0, 0)))
    ahead = max(1, round(SPAN_S / (step_s := float(np.median(np.diff(t))))))
    middle, begins, ends = 0.5 * (angles[ahead:] + angles[:-ahead]), t[:-ahead], t[ahead:]
    level = np.abs(angles[:, :2]).max(axis=1) < STEEP_RAD
    used = level[ahead:] & level[:-ahead] & (ends - begins < USUAL * ahead * step_s)
    usable, checks = np.flatnonzero(used & (begins > gyro_s[0]) & (ends < gyro_s[-1])), []
    if len(usable) < LEAST_STEPS:
        return ()
    slopes = body_rates(*middle[:, :2].T, *((angles[ahead:] - angles[:-ahead]).T / (ends - begins)))
    for name, slope, way in zip(("roll", "pitch", "yaw"), slopes, turned.T, strict=True):
        own = usable[np.argsort(np.abs(slope[usable] - slope[usable].mean()))[-MOST_STEPS:]]
        begin, end = (np.interp(LAGS_S[:, None] + at[own], gyro_s, way) for at in (begins, ends))
        checks.append(_axis_check(name, slope[own], (end - begin) / (ends - begins)[own]))
    return tuple(checks)


def _sound(values: FloatArray) -> FloatArray:
    """Lone samples far outside their neighbours, which damage makes, become the nearer neighbour."""
    padded = np.pad(values, ((1, 1), (0, 0)), mode="edge")
    near = np.clip(values, np.minimum(padded[:-2], padded[2:]), np.maximum(padded[:-2], padded[2:]))
    limit = SPIKE * np.percentile(np.abs(np.diff(values, axis=0)), 95, axis=0)
    return np.where(np.abs(values - near) > limit, near, values)


def _axis_check(name: str, slope: FloatArray, shifted: FloatArray) -> AxisCheck:
    """slope: (n,) of the attitude; shifted: (lags, n) mean gyro."""
    slope = slope - slope.mean()
    gyro = shifted - shifted.mean(axis=1, keepdims=True)
    if slope.std() < LEAST_MOTION:
        return AxisCheck(name, None, None, "hardly moved: turn it by hand, or fly")
    norms = np.sqrt((gyro**2).sum(axis=1) * (slope**2).sum())
    correlation = np.divide(gyro @ slope, norms, out=np.zeros(len(gyro)), where=norms > 0)
    best = int(np.argmax(np.abs(correlation)))
    found = float(correlation[best])
    if abs(found) < SURE:
        return AxisCheck(name, None, None, "does not follow the attitude: another axis, or a poor clock")
    scale, delay_s = math.copysign(gyro[best].std() / slope.std(), found), float(LAGS_S[best])
    named = next((f": {unit}" for one, unit in _RATES if abs(abs(scale) / one - 1.0) <= SCALE_OK), "")
    size = "right" if abs(abs(scale) - 1.0) <= SCALE_OK else f"wrong scale{named}"
    text = size if scale > 0 else f"turns the wrong way; {size.replace('right', 'scale right')}"
    return AxisCheck(name, scale, delay_s, text)
