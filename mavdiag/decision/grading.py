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
airframe: a hint for the mechanic, no measurement. The unbalance is measured. The features depend on what the link
carries, so on a link of another profile or rate no type is named: at 100 Hz four of five names were wrong.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from importlib import resources

import numpy as np

from mavdiag.airframe.propellers import FaultType
from mavdiag.errors import InputError
from mavdiag.kernel import EVIDENCE, JUDGED, LAST_LEVEL, LOOK_NS, SQUARES
from mavdiag.monitors.base import Feature
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

SCHEMA = "mavdiag.fault_types/1"
FAR = 16.27  # chi-squared of three features at 99.9 %: no known fault (our choice)
TYPE_AT = 0.6  # confidence below which no type is named (our choice)
SEVERITY_AT = 0.4  # and no severity, of three (our choice)
LEAST_UNBALANCE_G_MM = 0.05  # below it the estimate is noise (our choice)
LEAST_MOTION_RAD_S = 1e-4
UNBALANCE_AFTER_S, MOTION_AFTER_S, RISE_AFTER_S = 0.6, 2.95, 4.0  # windows that hold the fault only (their lengths)
FEATURES = 3
RATE_WITHIN = 0.05  # of the rate that the clouds were trained at (our choice: clocks differ by less)
CLASSIFIERS = {"qdrone2-emulated": "fault_types.json"}  # the names that an airframe may give


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


WAIT_S = {Feature.UNBALANCE: UNBALANCE_AFTER_S, Feature.MOTION: MOTION_AFTER_S, Feature.RISE: RISE_AFTER_S}


@dataclass(frozen=True, slots=True)
class Gathered:
    """Sums since the declaration of a fault, each with its number of values.

    since_ns: vehicle time of the declaration.
    unbalance, motion: of U^2 and A^2.
    rise: of a, for each rotor.
    """

    since_ns: int
    unbalance: tuple[float, int] = (0.0, 0)
    motion: tuple[float, int] = (0.0, 0)
    rise: tuple[tuple[float, int], ...] = ()

    def add(self, feature: str, record: FloatArray, until_ns: int) -> "Gathered":
        """Add what a look found of a feature, (EVIDENCE + 2 R,) as `kernel.HIGHEST` and its fellows say.

        until_ns: time of its latest value. Only windows that lie after the declaration count: of a look that begins
        before that, its last value.
        """
        count, rotors = int(record[JUDGED]), (len(record) - EVIDENCE) // 2
        spare_ns = until_ns - self.since_ns - round(WAIT_S[feature] * NS_PER_S)
        if not count or spare_ns < 0:
            return self
        squares, rises = float(record[SQUARES]), record[EVIDENCE + rotors :].tolist()
        if spare_ns < LOOK_NS:
            count, squares, rises = 1, float(record[LAST_LEVEL]) ** 2, record[EVIDENCE : EVIDENCE + rotors].tolist()
        if feature == Feature.RISE:
            before = self.rise or ((0.0, 0),) * rotors
            return replace(self, rise=tuple((a + b, n + count) for (a, n), b in zip(before, rises, strict=True)))
        if feature == Feature.UNBALANCE:
            return replace(self, unbalance=(self.unbalance[0] + squares, self.unbalance[1] + count))
        return replace(self, motion=(self.motion[0] + squares, self.motion[1] + count))

    def features(self, rotor: int | None) -> Features:
        """The features so far. rotor: that is named, from 1; without one nothing is said of a rise."""
        (u, n_u), (m, n_m) = self.unbalance, self.motion
        a, n_a = self.rise[rotor - 1] if rotor is not None and rotor <= len(self.rise) else (0.0, 0)
        return Features(
            math.sqrt(u / n_u) if n_u else None, math.sqrt(m / n_m) if n_m else None, a / n_a if n_a else None
        )


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
    """The clouds that hold from `after_s` seconds after the declaration on.

    trained_on: what they are worth. profiles, rate_hz: of the links that they were trained for; None for any.
    """

    after_s: float
    clouds: tuple[FaultCloud, ...]
    trained_on: str
    profiles: tuple[str, ...] | None = None
    rate_hz: float | None = None

    def fit(self, profile: str, rate_hz: float) -> bool:
        """Whether they were trained for links like that one."""
        known = self.profiles is None or profile in self.profiles
        return known and (self.rate_hz is None or abs(rate_hz / self.rate_hz - 1.0) <= RATE_WITHIN)


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


def assess(features: Features, known: FaultTypes) -> Assessment:
    """Name type and severity by the clouds for so much time."""
    x, clouds = features.vector, known.clouds
    told = np.isfinite(x)
    if told.sum() < 2 or not told[1]:
        return Assessment(Outcome.TOO_EARLY, features)
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
    """Log density of x in each cloud, up to a constant, and its squared distance, in the features that are known."""
    log_density, distance = np.empty(len(clouds)), np.empty(len(clouds))
    for i, cloud in enumerate(clouds):
        C = cloud.covariance[np.ix_(told, told)]
        apart = (x - cloud.mean)[told]
        distance[i] = apart @ np.linalg.solve(C, apart)
        log_density[i] = -0.5 * (distance[i] + math.log(float(np.linalg.det(C))))
    return log_density, distance


@cache
def known_fault_types(classifier: str | None, profile: str, rate_hz: float) -> tuple[FaultTypes, ...]:
    """The fault types that hold for an airframe with this classifier, on a link of that profile and rate.

    None if it has no classifier, if that is not known here, or if it was trained for other links.
    """
    if classifier not in CLASSIFIERS:
        return ()
    text = resources.files("mavdiag.decision").joinpath(CLASSIFIERS[classifier]).read_text(encoding="utf-8")
    return tuple(one for one in parse_fault_types(text) if one.fit(profile, rate_hz))


def parse_fault_types(text: str) -> tuple[FaultTypes, ...]:
    """Parameters from their JSON text. Raises InputError, naming what does not fit."""
    try:
        raw = json.loads(text)
        if raw["schema"] != SCHEMA:
            raise InputError(f"fault types: schema {raw['schema']!r} instead of {SCHEMA!r}")
        trained = str(raw["trained_on"]), tuple(map(str, raw["profiles"])), float(raw["rate_hz"])
        return tuple(_table(part, *trained) for part in raw["tables"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"fault types: the file does not hold what it should ({error})") from error


def _table(part: dict[str, object], trained_on: str, profiles: tuple[str, ...], rate_hz: float) -> FaultTypes:
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
    return FaultTypes(float(str(part["after_s"])), clouds, trained_on, profiles, rate_hz)
