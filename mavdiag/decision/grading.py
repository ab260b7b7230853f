"""Which fault it is, how severe, and how much unbalance it has: from what the monitors read after a declaration.

Three features say it, each by first principles of what the fault does (T 3.2, 5.5.2-5.5.3; T reads them by eye):

    unbalance   U [g mm]     the vibration beyond the healthy one             mass that is gone
    motion      A [rad/s]    rms that the rotor's arm moves beyond the model  thrust that wanders
    rise        a [-]        how much more that rotor is commanded            lift that is lost

Each fault is a Gaussian in x = (ln U, ln A, 100 a) with its own mean and covariance (quadratic discriminant analysis;
covariances shrunk towards their mean, Friedman, J. Am. Stat. Assoc. 84 (1989), Eq 16). A feature that the link cannot
give is left out of all of them. What lies too far from every known fault gets no name.

**The parameters were trained on the emulator** (`benchmarks/train_fault_types.py`) with the nine faults of T Tables
3.1-3.3 and their fitted fluctuation at full, half and no strength. They are as true as the emulator is, for its
airframe: a hint for the mechanic, no measurement. The unbalance is measured.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib import resources

import numpy as np

from mavdiag.airframe.balance import BalanceReport, Grade, assess_unbalance
from mavdiag.airframe.propellers import FaultType
from mavdiag.decision.events import Reading
from mavdiag.errors import InputError
from mavdiag.telemetry import NS_PER_S, FloatArray

__all__ = [
    "Assessment",
    "FaultCloud",
    "FaultTypes",
    "Features",
    "Gathered",
    "Outcome",
    "assess",
    "balance_report",
    "features_of",
    "gather",
    "known_fault_types",
    "parse_fault_types",
    "start",
]

SCHEMA = "mavdiag.fault_types/1"
FAR = 16.27  # chi-squared of three features at 99.9 %: no known fault (our choice)
TYPE_AT = 0.6  # confidence below which no type is named (our choice)
SEVERITY_AT = 0.4  # and no severity, of three (our choice)
LEAST_UNBALANCE_G_MM = 0.05  # below it the estimate is noise (our choice)
LEAST_MOTION_RAD_S = 1e-4
VIBRATION_AFTER_S, MOTION_AFTER_S, RISE_AFTER_S = 0.6, 2.95, 4.0  # windows that hold the fault only (their lengths)
FEATURES = 3


@dataclass(frozen=True, slots=True)
class Features:
    """What was read after a declaration; None where nothing was.

    unbalance_g_mm: U. motion_rad_s: A. rise: a of the named rotor, share of the hover command.
    """

    unbalance_g_mm: float | None = None
    motion_rad_s: float | None = None
    rise: float | None = None

    @property
    def vector(self) -> FloatArray:
        """x, (3,), nan for what is missing."""
        out = np.full(FEATURES, np.nan)
        if self.unbalance_g_mm is not None:
            out[0] = math.log(max(self.unbalance_g_mm, LEAST_UNBALANCE_G_MM))
        if self.motion_rad_s is not None:
            out[1] = math.log(max(self.motion_rad_s, LEAST_MOTION_RAD_S))
        if self.rise is not None:
            out[2] = 100.0 * self.rise
        return out


@dataclass(frozen=True, slots=True)
class Gathered:
    """Sums since the declaration: of U^2, A^2 and a, with the number of readings in each."""

    since_ns: int
    unbalance: tuple[float, int] = (0.0, 0)
    motion: tuple[float, int] = (0.0, 0)
    rise: tuple[float, int] = (0.0, 0)
    latest_ns: int = 0


def start(declared_ns: int) -> Gathered:
    """Nothing read yet since the declaration at that vehicle time."""
    return Gathered(declared_ns, latest_ns=declared_ns)


def gather(
    state: Gathered,
    *,
    vibration: Reading | None = None,
    energy: Reading | None = None,
    effort: Reading | None = None,
    rotor: int | None = None,
) -> Gathered:
    """Add the next readings. Only windows that lie after the declaration count.

    vibration: must be in g mm. effort counts only where a rotor is named: `rotor` from 1.
    """
    latest = max([state.latest_ns, *(int(r.t_ns[-1]) for r in (vibration, energy, effort) if r and len(r.t_ns))])
    unbalance = _square_sum(state, state.unbalance, vibration, VIBRATION_AFTER_S)
    motion = _square_sum(state, state.motion, energy, MOTION_AFTER_S)
    rise = state.rise
    if effort is not None and rotor is not None and rotor <= effort.rotors.shape[1]:
        after = _after(state, effort, RISE_AFTER_S)
        rise = (rise[0] + float(effort.rotors[after, rotor - 1].sum()), rise[1] + int(after.sum()))
    return Gathered(state.since_ns, unbalance, motion, rise, latest)


def features_of(state: Gathered) -> Features:
    """The features so far."""
    return Features(
        math.sqrt(state.unbalance[0] / state.unbalance[1]) if state.unbalance[1] else None,
        math.sqrt(state.motion[0] / state.motion[1]) if state.motion[1] else None,
        state.rise[0] / state.rise[1] if state.rise[1] else None,
    )


def _after(state: Gathered, reading: Reading, wait_s: float) -> FloatArray:
    return np.asarray(reading.valid & (reading.t_ns >= state.since_ns + round(wait_s * NS_PER_S)))


def _square_sum(
    state: Gathered, before: tuple[float, int], reading: Reading | None, wait_s: float
) -> tuple[float, int]:
    if reading is None or len(reading.t_ns) == 0:
        return before
    after = _after(state, reading, wait_s)
    return before[0] + float(np.square(reading.level[after]).sum()), before[1] + int(after.sum())


@dataclass(frozen=True, slots=True, eq=False)
class FaultCloud:
    """One fault in the space of the features. strength: of the fitted fluctuation, 0..1.

    mean: (3,) of x. covariance: (3, 3).
    """

    fault_type: FaultType
    severity: int
    strength: float
    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FaultTypes:
    """The clouds that hold from `after_s` seconds after the declaration on. trained_on: what they are worth."""

    after_s: float
    clouds: tuple[FaultCloud, ...]
    trained_on: str


class Outcome(Enum):
    """What came of an assessment, as a sentence."""

    NAMED = "the features fit one type of fault"
    TOO_EARLY = "too little was read since the declaration"
    FAR = "no known fault has such features"
    BETWEEN = "the features fit more than one type of fault"


@dataclass(frozen=True, slots=True)
class Assessment:
    """The answer; what could not be said is None. confidence: of the type, and severity_confidence of the severity
    within it, 0..1. distance: squared Mahalanobis distance to the nearest fault."""

    outcome: Outcome
    features: Features
    fault_type: FaultType | None = None
    confidence: float | None = None
    severity: int | None = None
    severity_confidence: float | None = None
    distance: float | None = None


def assess(gathered: Gathered, known: Sequence[FaultTypes]) -> Assessment:
    """Name type and severity from what was gathered so far, by the clouds for so much time."""
    features = features_of(gathered)
    elapsed_s = (gathered.latest_ns - gathered.since_ns) / NS_PER_S
    ready = [one for one in known if one.after_s <= elapsed_s + 1e-6]
    x = features.vector
    told = np.isfinite(x)
    if not ready or told.sum() < 2 or not told[1]:
        return Assessment(Outcome.TOO_EARLY, features)
    clouds = max(ready, key=lambda one: one.after_s).clouds
    log_density, distance = _densities(clouds, x, told)
    nearest = float(distance.min())
    if nearest > FAR:
        return Assessment(Outcome.FAR, features, distance=nearest)
    share = np.exp(log_density - log_density.max())
    share /= share.sum()
    types = list(FaultType)
    table = np.zeros((len(types), 3))
    for cloud, one in zip(clouds, share, strict=True):
        table[types.index(cloud.fault_type), cloud.severity - 1] += one
    best = int(table.sum(axis=1).argmax())
    confidence = float(table[best].sum())
    if confidence < TYPE_AT:
        return Assessment(Outcome.BETWEEN, features, distance=nearest)
    within = table[best] / confidence
    severity, sure = int(within.argmax()) + 1, float(within.max())
    if sure < SEVERITY_AT:
        return Assessment(Outcome.NAMED, features, types[best], confidence, distance=nearest)
    return Assessment(Outcome.NAMED, features, types[best], confidence, severity, sure, nearest)


def _densities(clouds: Sequence[FaultCloud], x: FloatArray, told: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log density of x in each cloud, up to a constant, and its squared distance, in the features that are told."""
    log_density, distance = np.empty(len(clouds)), np.empty(len(clouds))
    for i, cloud in enumerate(clouds):
        C = cloud.covariance[np.ix_(told, told)]
        apart = (x - cloud.mean)[told]
        distance[i] = apart @ np.linalg.solve(C, apart)
        log_density[i] = -0.5 * (distance[i] + math.log(float(np.linalg.det(C))))
    return log_density, distance


def balance_report(
    features: Features, *, rotor_mass_g: float, speed_rpm: float, grade: Grade = Grade.G6_3
) -> BalanceReport | None:
    """The estimated unbalance against what ISO 1940-1 permits, None if it was not read. Raises UsageError."""
    if features.unbalance_g_mm is None:
        return None
    return assess_unbalance(features.unbalance_g_mm, rotor_mass_g=rotor_mass_g, speed_rpm=speed_rpm, grade=grade)


@cache
def known_fault_types() -> tuple[FaultTypes, ...]:
    """The parameters that come with the package."""
    text = resources.files("mavdiag.decision").joinpath("fault_types.json").read_text(encoding="utf-8")
    return parse_fault_types(text)


def parse_fault_types(text: str) -> tuple[FaultTypes, ...]:
    """Parameters from their JSON text. Raises InputError, naming what does not fit."""
    try:
        raw = json.loads(text)
        if raw["schema"] != SCHEMA:
            raise InputError(f"fault types: schema {raw['schema']!r} instead of {SCHEMA!r}")
        return tuple(_table(part, str(raw["trained_on"])) for part in raw["tables"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"fault types: the file does not hold what it should ({error})") from error


def _table(part: dict[str, object], trained_on: str) -> FaultTypes:
    rows = part["clouds"]
    if not isinstance(rows, list):
        raise TypeError("clouds is no list")
    clouds = tuple(
        FaultCloud(
            FaultType(row["type"]),
            int(row["severity"]),
            float(row["strength"]),
            np.array(row["mean"], dtype=np.float64).reshape(FEATURES),
            np.array(row["covariance"], dtype=np.float64).reshape(FEATURES, FEATURES),
        )
        for row in rows
    )
    if not clouds or any(np.linalg.eigvalsh(cloud.covariance).min() <= 0 for cloud in clouds):
        raise ValueError("every covariance must be positive definite")
    return FaultTypes(float(str(part["after_s"])), clouds, trained_on)
