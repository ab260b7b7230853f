"""Synthetic telemetry for the tests: a known linear airframe, sampled as a vehicle would send it."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry

DT_NS = 1_000_000
START_NS = 1_000_000_000
A = np.array([1.0, -1.95, 0.9512])  # a well damped rate loop at 1 kHz, DC gain 1
B = np.array([0.0, 0.0007, 0.0005])
ROUNDING = 1e-12  # of values of order 1 [SI]: matrix and dot products of other lengths are summed in another order


def series(signal: Signal, t_ns: IntArray, values: FloatArray) -> Series:
    """A series whose host clock runs 5 ms behind the vehicle's."""
    return Series(signal, t_ns, t_ns + 5_000_000, values)


def setpoints(n: int, seed: int) -> FloatArray:
    """(n, 3) attitude set-points [rad]: smooth random steps, about 0.1 rad."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.normal(0, 0.1, (n // 400 + 1, 3)), 400, axis=0)[:n]
    return np.asarray(lfilter([0.02], [1, -0.98], steps, axis=0), dtype=np.float64)


def gyro(setpoint: FloatArray, seed: int, noise: float = 0.01) -> FloatArray:
    """(n, 3) body rates [rad/s] that the airframe answers with, plus white noise."""
    rate = np.gradient(setpoint, DT_NS / 1e9, axis=0)
    rng = np.random.default_rng(seed + 1)
    return np.asarray(lfilter(B, A, rate, axis=0), dtype=np.float64) + noise * rng.standard_normal(setpoint.shape)


def body_rates(angle: FloatArray, dt_s: float = 0.01) -> FloatArray:
    """Body rates p, q, r [rad/s] of roll, pitch and yaw angles (order yaw, pitch, roll), (n, 3)."""
    (phi, theta, _), (roll, pitch, yaw) = angle.T, np.gradient(angle, dt_s, axis=0).T
    q = np.cos(phi) * pitch + np.sin(phi) * np.cos(theta) * yaw
    r = np.cos(phi) * np.cos(theta) * yaw - np.sin(phi) * pitch
    return np.stack((roll - np.sin(theta) * yaw, q, r), axis=1)


def flight(n: int, seed: int, *, push: FloatArray | None = None, start_ns: int = START_NS) -> Telemetry:
    """A flight of n samples at 1 kHz; push: (n,) rates [rad/s] added to the roll gyro."""
    t_ns = start_ns + DT_NS * np.arange(n, dtype=np.int64)
    setpoint = setpoints(n, seed)
    rate = gyro(setpoint, seed)
    if push is not None:
        rate[:, 0] += push
    return Telemetry(
        (
            series(Signal.ATTITUDE_SETPOINT, t_ns, setpoint),
            series(Signal.BODY_RATE, t_ns, rate),
            series(Signal.SPECIFIC_FORCE, t_ns, np.tile([0.0, 0.0, -9.81], (n, 1))),
            series(Signal.ARMED, t_ns[::1000], np.ones((len(t_ns[::1000]), 1))),
        )
    )


def changed(
    telemetry: Telemetry,
    signal: Signal,
    change: Callable[[FloatArray], FloatArray | float],
    from_s: float = -np.inf,
    to_s: float = np.inf,
) -> Telemetry:
    """The same telemetry, the values of a signal changed between two times since its start."""
    parts = []
    for one in telemetry:
        if one.signal is signal:
            at_s, values = (one.t_ns - START_NS) / 1e9, one.values.copy()
            inside = (at_s >= from_s) & (at_s < to_s)
            values[inside] = change(values[inside])
            one = replace(one, values=values)
        parts.append(one)
    return Telemetry(tuple(parts))


def cut(telemetry: Telemetry, edges_ns: list[int]) -> list[Telemetry]:
    """The same telemetry in chunks, cut by the time of arrival."""
    bounds = [-(2**62), *edges_ns, 2**62]
    chunks = []
    for low, high in itertools.pairwise(bounds):
        parts = []
        for one in telemetry.series:
            keep = (one.host_ns >= low) & (one.host_ns < high)
            if keep.any():
                parts.append(one.where(keep))
        chunks.append(Telemetry(tuple(parts)))
    return chunks
