"""Which fault it is and how severe: from what the monitors read after a declaration.

    unbalance   U [g mm]     the vibration beyond the healthy one             mass that is gone
    motion      A [rad/s]    rms that the rotor's arm moves beyond the model  thrust that wanders
    rise        a [-]        how much more that rotor is commanded            lift that is lost

Each fault (T 3.2, 5.5.2-5.5.3) is a Gaussian in x = (ln U, ln A, 100 a) with its own mean and covariance, shrunk
towards their mean (quadratic discriminant analysis; Friedman, J. Am. Stat. Assoc. 84 (1989), Eq 16). They were trained
on the emulator (`benchmarks/train_fault_types.py`): a hint for the mechanic, no measurement. A feature that is missing
is left out of all of them, but without motion all are gathered anew; what lies too far from every fault gets no name,
and none is given on another kind of link.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from mavdiag.airframe.layout import Motor
from mavdiag.airframe.propellers import FaultType
from mavdiag.kernel import EVIDENCE, JUDGED, LAST_LEVEL, LOOK_NS, SQUARES
from mavdiag.monitors.base import Feature
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

FAR = 16.27  # chi-squared of three features at 99.9 %: no known fault (our choice)
TYPE_AT = 0.6  # confidence below which no type is named (our choice)
SEVERITY_AT = 0.4  # and no severity, of three (our choice)
RATE_WITHIN = 0.05  # of the rate that the clouds were trained at (our choice: clocks differ by less)
CLASSIFIERS = {"qdrone2-emulated": "fault_types.json"}  # the names that an airframe may give
WAIT_S = {Feature.UNBALANCE: 0.6, Feature.MOTION: 2.95, Feature.RISE: 4.0}  # windows that hold the fault only
LEAST = {Feature.UNBALANCE: 0.05, Feature.MOTION: 1e-4}  # g mm, rad/s: below it the estimate is noise (our choice)


@dataclass(frozen=True, slots=True)
class Gathered:
    """Since the declaration of a fault, of each feature: sums of U^2, A^2 or of a of each rotor, and their number."""

    since_ns: int
    sums: Mapping[str, FloatArray] = field(default_factory=dict)

    def add(self, feature: str, record: FloatArray, until_ns: int) -> "Gathered":
        """Add what a look found of a feature, (EVIDENCE + 2 R,) as `kernel.HIGHEST` and its fellows say.

        until_ns: time of its latest value. Only windows that lie after the declaration count: of a look that begins
        before that, its last value.
        """
        spare_ns = until_ns - self.since_ns - round(WAIT_S[feature] * NS_PER_S)
        if not record[JUDGED] or spare_ns < 0:
            return self
        if feature == Feature.RISE:
            last, sums = np.split(record[EVIDENCE:], 2)
        else:
            last, sums = record[LAST_LEVEL : LAST_LEVEL + 1] ** 2, record[SQUARES : SQUARES + 1]
        fresh = np.append(last, 1.0) if spare_ns < LOOK_NS else np.append(sums, record[JUDGED])
        return replace(self, sums={**self.sums, feature: self.sums.get(feature, 0.0) + fresh})

    def features(self, rotor: int | None) -> FloatArray:
        """x so far, (3,), nan for what is missing. rotor: that is named, from 1; without one a rise says nothing."""
        x = np.full(3, np.nan)
        for column, (feature, least) in enumerate(LEAST.items()):
            if feature in self.sums:
                squares, count = self.sums[feature].tolist()
                x[column] = math.log(max(math.sqrt(squares / count), least))
        rises = self.sums.get(Feature.RISE, np.empty(0))
        members = rotor.members if isinstance(rotor, Motor) else () if rotor is None else (rotor,)
        if members and max(members) < len(rises):
            x[2] = 100.0 * (max(rises[one - 1] for one in members) / rises[-1])
        return x


class FaultCloud(NamedTuple):
    """One fault in the space of the features: mean (3,) and covariance (3, 3). strength: of the fluctuation, 0..1."""

    fault_type: FaultType
    severity: int
    strength: float
    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FaultTypes:
    """The clouds that hold from `after_s` seconds after the declaration on."""

    after_s: float
    clouds: tuple[FaultCloud, ...]


class Assessment(NamedTuple):
    """Type and severity, None where they could not be said; confidence of the type, 0..1."""

    fault_type: FaultType | None = None
    severity: int | None = None
    confidence: float | None = None


def assess(x: FloatArray, known: FaultTypes) -> Assessment:
    """Name type and severity of the features x, (3,), nan for what is missing, by the clouds for so much time."""
    told = np.isfinite(x)
    if told.sum() < 2 or not told[1]:
        return Assessment()
    distance, log_density = np.empty((2, len(known.clouds)))
    for i, cloud in enumerate(known.clouds):
        C, apart = cloud.covariance[np.ix_(told, told)], (x - cloud.mean)[told]
        distance[i] = apart @ np.linalg.solve(C, apart)
        log_density[i] = -0.5 * (distance[i] + math.log(float(np.linalg.det(C))))
    if distance.min() > FAR:
        return Assessment()
    share = np.exp(log_density - log_density.max())
    types, table = list(FaultType), np.zeros((len(FaultType), 3))
    for cloud, one in zip(known.clouds, share / share.sum(), strict=True):
        table[types.index(cloud.fault_type), cloud.severity - 1] += one
    best = int(table.sum(axis=1).argmax())
    confidence = float(table[best].sum())
    if confidence < TYPE_AT:
        return Assessment()
    severity = int(table[best].argmax()) + 1 if table[best].max() >= SEVERITY_AT * confidence else None
    return Assessment(types[best], severity, confidence)


@cache
def known_fault_types(classifier: str | None, profile: str, rate_hz: float) -> tuple[FaultTypes, ...]:
    """The fault types for an airframe with this classifier, if they were trained for links of that profile and rate."""
    if classifier not in CLASSIFIERS:
        return ()
    raw = json.loads(resources.files("mavdiag.decision").joinpath(CLASSIFIERS[classifier]).read_text(encoding="utf-8"))
    if profile not in raw["profiles"] or abs(rate_hz / raw["rate_hz"] - 1.0) > RATE_WITHIN:
        return ()
    return tuple(FaultTypes(table["after_s"], tuple(map(_cloud, table["clouds"]))) for table in raw["tables"])


def _cloud(row: Mapping[str, Any]) -> FaultCloud:
    mean, covariance = np.array(row["mean"]), np.array(row["covariance"])
    return FaultCloud(FaultType(row["type"]), row["severity"], row["strength"], mean, covariance)
