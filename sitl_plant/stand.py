"""An emulated flight stand: one rotor at a steady speed, an accelerometer, and the unbalance in g mm (T 3.2.3).

    F_y + j F_x = U w^2 e^(j theta)              force that turns with the rotor                T 3.1.1
    m_s a'' + c a' + k a = F''                   each axis of the stand: mass, damper, spring
    A   = peak of |a_y| at the rotation frequency, from the FFT                                 T Fig 3.14
    U   = s A,  s = sum(U_i A_i) / sum(A_i^2)    least squares over known unbalances            T Fig 3.15

T's peak lies at 83.3 Hz, which is 5000 rpm: it is the rotation frequency, though T calls it the primary resonance. y is
the radial direction in which the stand gives most, x the stiff one in the rotor plane, z the one along the shaft.

**Estimates**: T gives no mass, stiffness, damping, noise or sample rate of its stand. `Stand` has values chosen so that
the order of the axes is T's (y, x, z) and accelerations are of the order of 1 m/s^2. The scale s is therefore a number
of *this* stand at *this* speed; what does not depend on the estimates is that force grows with w^2, that acceleration
is proportional to unbalance, and that s takes one back to the other. T's Fig 3.15 has F3/SV2 above F3/SV3 and all
others, which no linear stand gives from the unbalances of T Table 3.2; it is not reproduced.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import typer
from typer import Option

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from mavdiag.units import G_MM_PER_KG_M, RPM
from sitl_plant.physics.faults import FAULTS
from sitl_plant.vehicle import qdrone2

SLOWEST_RPM, FASTEST_RPM = 1000.0, 12_000.0  # of the QDrone 2's motors (our choice)
PEAK_HALF_WIDTH_HZ = 1.0  # wider than the speed wanders (our choice)
WANDER_CORNER_HZ = 0.2  # of the speed, first order (estimate)
HEALTHY = ("H1", "H2", "H3")  # T Fig 3.14


@dataclass(frozen=True, slots=True)
class Stand:
    """The stand and its accelerometer; every value is an estimate. Vectors are x, y, z."""

    mass_kg: float = 1.2  # of all that vibrates
    natural_hz: tuple[float, float, float] = (300.0, 40.0, 500.0)  # of each axis on its spring
    damping: float = 0.05
    share: tuple[float, float, float] = (1.0, 1.0, 0.05)  # of the turning force; z gets what misalignment gives it
    noise_rms_m_s2: float = 0.05
    second_m_s2: float = 0.2  # line at two per revolution, by the blades
    wander_rms: float = 2e-4  # share of the speed
    rate_hz: float = 4000.0
    duration_s: float = 12.0
    drop_s: float = 2.0  # settling time that is not recorded


@dataclass(frozen=True, slots=True)
class Peak:
    """The line at the rotation frequency [Hz] and its amplitude along x, y, z [m/s^2]."""

    frequency_hz: float
    amplitude_m_s2: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Scale:
    """From the peak along y to unbalance. g_mm_per_m_s2: the factor s, with its standard error. r2: of the fit."""

    g_mm_per_m_s2: float
    standard_error: float
    r2: float


@dataclass(frozen=True, slots=True)
class Bar:
    """One bar of T Fig 3.15. known_g_mm: by weighing, T Table 3.2."""

    name: str
    known_g_mm: float
    peak: Peak
    estimated_g_mm: float


@dataclass(frozen=True, slots=True)
class StandReport:
    """The whole series of runs at one speed."""

    speed_rpm: float
    scale: Scale
    bars: tuple[Bar, ...]


def stand_run(stand: Stand, unbalance_g_mm: float, speed_rpm: float, rng: np.random.Generator) -> FloatArray:
    """One run: acceleration (n, 3) along x, y, z [m/s^2], without gravity, after settling.

    Raises UsageError for a speed outside 1000 to 12,000 rpm.
    """
    if not SLOWEST_RPM <= speed_rpm <= FASTEST_RPM:
        raise UsageError(f"rpm must be {SLOWEST_RPM:.0f} to {FASTEST_RPM:.0f}, not {speed_rpm:g}")
    dt = 1.0 / stand.rate_hz
    n = round((stand.drop_s + stand.duration_s) * stand.rate_hz)
    frequency = np.fft.rfftfreq(n, dt).astype(np.float64)
    slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) / (1.0 + 1j * frequency / WANDER_CORNER_HZ), n)
    speed = speed_rpm * RPM * (1.0 + stand.wander_rms * slow / slow.std())
    theta = rng.uniform(0.0, 2.0 * math.pi) + np.cumsum(speed) * dt
    force = unbalance_g_mm / G_MM_PER_KG_M * speed**2
    blades = stand.second_m_s2 * np.cos(2.0 * theta + rng.uniform(0.0, 2.0 * math.pi))
    w, accel = 2.0 * math.pi * frequency, np.empty((n, 3))
    for axis, turning in enumerate((np.sin(theta), np.cos(theta), np.cos(theta))):
        w_n = 2.0 * math.pi * stand.natural_hz[axis]
        accelerance = -(w**2) / (stand.mass_kg * (w_n**2 - w**2 + 2j * stand.damping * w_n * w))  # a / F
        answer = np.fft.irfft(accelerance * np.fft.rfft(force * turning), n)
        accel[:, axis] = stand.share[axis] * (answer + blades)
    accel += stand.noise_rms_m_s2 * rng.standard_normal((n, 3))
    return accel[round(stand.drop_s * stand.rate_hz) :]


def peak_of(accel: FloatArray, rate_hz: float, speed_rpm: float) -> Peak:
    """The line at the rotation frequency: A = sqrt(2 x power within 1 Hz of it), by one Hann periodogram of the run.

    The power under the line does not depend on where it falls between two bins. accel: (n, 3), n >= 2 s of samples.
    """
    from scipy.signal import welch  # takes a second to load

    frequency_hz, density = welch(accel, rate_hz, nperseg=len(accel), axis=0)
    inside = np.flatnonzero(np.abs(frequency_hz - speed_rpm / 60.0) < PEAK_HALF_WIDTH_HZ)
    x, y, z = np.sqrt(2.0 * frequency_hz[1] * density[inside].sum(axis=0)).tolist()
    return Peak(float(frequency_hz[inside[np.argmax(density[inside, 1])]]), (x, y, z))


def fit_scale(known_g_mm: Sequence[float], peaks_m_s2: Sequence[float]) -> Scale:
    """Least squares of U = s A through the origin.

    Raises UsageError unless there are two known unbalances or more and some acceleration.
    """
    U, A = np.asarray(known_g_mm, dtype=np.float64), np.asarray(peaks_m_s2, dtype=np.float64)
    if len(U) != len(A) or len(U) < 2 or not A.any():
        raise UsageError("a scale needs two known unbalances or more, each with its acceleration")
    s = float(U @ A / (A @ A))
    error = U - s * A
    squares = float(error @ error)
    r2 = 1.0 - squares / float(np.sum((U - U.mean()) ** 2)) if np.ptp(U) else 1.0
    return Scale(s, math.sqrt(squares / (len(U) - 1) / float(A @ A)), r2)


def stand_test(speed_rpm: float = 5000.0, seed: int = 0, stand: Stand = Stand()) -> StandReport:  # frozen
    """The nine damaged and three healthy propellers of T Fig 3.14-3.15, one run each; the scale is fitted to the nine.

    Every propeller has a residue of its own, up to what G 6.3 permits (T Eq 3.6), at an angle of its own.
    """
    mounted = [*((code, 0.0) for code in HEALTHY), *((fault.code, fault.propeller.printed_g_mm) for fault in FAULTS)]
    permitted = qdrone2().propulsion.unbalance_max_g_mm
    peaks = []
    for (_, unbalance), child in zip(mounted, np.random.SeedSequence(seed).spawn(len(mounted)), strict=True):
        rng = np.random.default_rng(child)
        size = permitted * rng.random()
        angle, towards = (rng.uniform(0.0, 2.0 * math.pi) for _ in range(2))
        x, y = (size * turn(angle) + unbalance * turn(towards) for turn in (math.cos, math.sin))
        peaks.append(peak_of(stand_run(stand, math.hypot(x, y), speed_rpm, rng), stand.rate_hz, speed_rpm))
    known = [unbalance for _, unbalance in mounted]
    damaged = slice(len(HEALTHY), None)
    scale = fit_scale(known[damaged], [peak.amplitude_m_s2[1] for peak in peaks[damaged]])
    bars = (
        Bar(name, unbalance, peak, scale.g_mm_per_m_s2 * peak.amplitude_m_s2[1])
        for (name, unbalance), peak in zip(mounted, peaks, strict=True)
    )
    return StandReport(speed_rpm, scale, tuple(bars))


def stand(
    rpm: Annotated[float, Option(help="Speed of the rotor; T's peak at 83.3 Hz is 5000 rpm.")] = 5000.0,
    seed: Annotated[int, Option(min=0, help="Equal seeds give equal numbers.")] = 0,
    as_json: Annotated[bool, Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Run twelve propellers on an emulated flight stand and estimate their unbalance from the vibration.

    Mass, stiffness and noise of the stand are estimates: the scale is a number of this stand, not of T's.
    """
    report = stand_test(rpm, seed)
    if as_json:
        typer.echo(json.dumps(asdict(report)))
        return
    from rich.console import Console
    from rich.table import Table

    table, console = Table(title=f"flight stand at {report.speed_rpm:g} rpm, {report.speed_rpm / 60:.1f} Hz"), Console()
    for heading in ("propeller", "peak Hz", "x m/s²", "y m/s²", "z m/s²", "weighed g mm", "estimated g mm"):
        table.add_column(heading, justify="right")
    for bar in report.bars:
        axes = (f"{amplitude:.3f}" for amplitude in bar.peak.amplitude_m_s2)
        masses = (f"{g_mm:.2f}" for g_mm in (bar.known_g_mm, bar.estimated_g_mm))
        table.add_row(bar.name, f"{bar.peak.frequency_hz:.1f}", *axes, *masses)
    console.print(table)
    scale = report.scale
    console.print(
        f"scale {scale.g_mm_per_m_s2:.3f} ± {scale.standard_error:.3f} g mm per m/s² along y, R² {scale.r2:.4f}; "
        "mass and stiffness of the stand are estimates"
    )
