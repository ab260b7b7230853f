"""The results of `sitl-plant campaign`, as values: read and checked where they come in, and what figures need of them.

Each line of the file is one JSON object; its shape is `sitl_plant.campaign.worker.FlightResult`. Only the fields that
are drawn are read, so that a file of a newer version can be drawn too.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from mavdiag.errors import InputError
from mavdiag.storage import open_regular
from mavdiag.telemetry import FloatArray

__all__ = ["Answer", "Campaign", "CampaignFlight", "Roc", "matrix_of", "parse_campaign", "read_campaign", "roc_of"]

MOST_BYTES = 1 << 30  # of a file of results (our choice)
HEALTHY = "healthy"
UNJUDGED = ("not_judgeable", "error")
_FAULT = re.compile(r"F[123]/SV[123]")
REMEDY = "name the file that `sitl-plant campaign -o FILE.jsonl` wrote"


class Answer(BaseModel):
    """What the diagnosis answered; fields as in the campaign's `Answer`."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    kind: Annotated[str, Field(max_length=60)]
    rotor: int | None = None
    fault_type: Annotated[str, Field(max_length=20)] | None = None
    severity: int | None = None


class CampaignFlight(BaseModel):
    """One flight of a campaign; fields as in the campaign's `FlightResult`."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    record: Literal["flight"]
    key: str
    cause: Annotated[str, Field(max_length=60)]
    rotor: int
    phenomenology: float
    verdict: str
    flown_s: float
    healthy_s: float
    onset_s: float | None
    episodes: int
    latency_s: float | None
    answer: Answer
    faults: int = 0
    score_before: float | None = None
    score_after: float | None = None

    @property
    def judged(self) -> bool:
        """Whether there is a verdict."""
        return self.verdict not in UNJUDGED

    @property
    def of_thesis(self) -> bool:
        """Whether a propeller has one of the thesis's nine faults."""
        return _FAULT.fullmatch(self.cause) is not None

    @property
    def answered(self) -> str:
        """The answer in one phrase: the type where one is named, else the kind."""
        if not self.judged:
            return "not judged"
        if self.cause == HEALTHY:
            return "a fault" if self.faults else "suspicion" if self.episodes else "nothing"
        return self.answer.fault_type or self.answer.kind


class _Learnt(BaseModel):
    """A line that holds a baseline; nothing of it is drawn."""

    record: Literal["learn"]


_LINE: TypeAdapter[CampaignFlight | _Learnt] = TypeAdapter(
    Annotated[CampaignFlight | _Learnt, Field(discriminator="record")]
)


@dataclass(frozen=True, slots=True)
class Campaign:
    """flights: each once. unread: lines that are no result of a campaign."""

    flights: tuple[CampaignFlight, ...]
    unread: int = 0

    @property
    def faulty(self) -> tuple[CampaignFlight, ...]:
        """Judged flights with one of the thesis's faults."""
        return tuple(one for one in self.flights if one.judged and one.of_thesis)

    @property
    def scales(self) -> tuple[float, ...]:
        """Scales of the faults' fitted terms."""
        return tuple(sorted({one.phenomenology for one in self.faulty}))


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """Receiver operating characteristic of the score: a flight is flagged if its score is above a limit.

    false_share, true_share: (n,) share of the healthy and of the damaged flights, for a limit that falls.
    area: under the curve, 0..1: the chance that a damaged flight scores higher than a healthy one.
    at_threshold: both shares at the limit 1, which is the threshold in use.
    healthy, damaged: flights that have a score.
    """

    false_share: FloatArray
    true_share: FloatArray
    area: float
    at_threshold: tuple[float, float]
    healthy: int
    damaged: int


def read_campaign(path: Path) -> Campaign:
    """A file of results. Raises InputError, naming it, if it is none."""
    with open_regular(path, MOST_BYTES) as file:
        data = file.read()
    try:
        return parse_campaign(data.decode())
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text; {REMEDY}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_campaign(text: str) -> Campaign:
    """The results in a text of lines. Raises InputError if there is no flight among them."""
    flights: dict[str, CampaignFlight] = {}
    unread = 0
    for line in text.splitlines():
        if not line.strip():
            continue
        try:
            found = _LINE.validate_json(line)
        except ValidationError:
            unread += 1
            continue
        if isinstance(found, CampaignFlight):
            flights[found.key] = found
    if not flights:
        what = "is a campaign's summary" if _is_summary(text) else "holds no flight of a campaign"
        raise InputError(f"{what}; {REMEDY}")
    return Campaign(tuple(flights.values()), unread)


def roc_of(healthy: Sequence[float], damaged: Sequence[float]) -> Roc:
    """The curve of these scores. Raises InputError if one of both is empty.

    >>> roc_of([0.2, 0.9], [0.5, 3.0]).area
    0.75
    """
    if not healthy or not damaged:
        raise InputError("a curve needs the scores of healthy and of damaged flights")
    low, high = np.sort(healthy), np.sort(damaged)
    limits = np.unique(np.concatenate((low, high)))[::-1]
    above = [1.0 - np.searchsorted(one, limits, side="left") / len(one) for one in (low, high)]
    false_share, true_share = (np.concatenate(([0.0], one)) for one in above)
    at_one = (float(np.mean(low > 1.0)), float(np.mean(high > 1.0)))
    area = float(np.trapezoid(true_share, false_share))
    return Roc(false_share, true_share, area, at_one, len(low), len(high))


def matrix_of(pairs: Sequence[tuple[str, str]]) -> tuple[tuple[str, ...], tuple[str, ...], FloatArray]:
    """What was true and what was answered, in order of first occurrence, and the counts (true, answered)."""
    true = tuple(dict.fromkeys(one for one, _ in pairs))
    answered = tuple(dict.fromkeys(one for _, one in pairs))
    counts = np.zeros((len(true), len(answered)))
    for a, b in pairs:
        counts[true.index(a), answered.index(b)] += 1
    return true, answered, counts


def _is_summary(text: str) -> bool:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return False
    return isinstance(found, dict) and "detection" in found
