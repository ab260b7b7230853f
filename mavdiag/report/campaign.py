"""The results of `sitl-plant campaign`: read and checked where they come in, and drawn.

Each line is one JSON object, as `sitl_plant.campaign.worker.FlightResult`; only the fields that are drawn are read.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from mavdiag.airframe.propellers import FaultType
from mavdiag.errors import InputError
from mavdiag.report.chart import Chart, Line, NotDrawn, Panel, Picture, picture
from mavdiag.report.pictures import LOOKS, NAMES, errors
from mavdiag.storage import open_regular
from mavdiag.telemetry import FloatArray

MOST_BYTES = 1 << 30  # of a file of results (our choice)
HEALTHY = "healthy"
UNJUDGED = ("not_judgeable", "error")
REMEDY = "name the file that `sitl-plant campaign -o FILE.jsonl` wrote"
NO_FAULTS = "no judged flight of this campaign has one of the thesis's propeller faults"
ORDER = ("F1", "F2", "F3", "propeller fault", "sensor fault", "loss of control", "gross loss of thrust", "a fault")
LAST = ("suspicion", "nothing", "not judged")
_FAULT = re.compile(r"F[123]/SV[123]")


class Answer(BaseModel, frozen=True):
    """What the diagnosis answered."""

    kind: Annotated[str, Field(max_length=60)]
    fault_type: Annotated[str, Field(max_length=20)] | None = None


class CampaignFlight(BaseModel, frozen=True, allow_inf_nan=False):
    """One flight of a campaign."""

    record: Literal["flight"]
    key: str
    cause: Annotated[str, Field(max_length=60)]
    phenomenology: float
    verdict: str
    healthy_s: float
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
    record: Literal["learn"]  # a line that holds a baseline; nothing of it is drawn


_LINE = TypeAdapter[CampaignFlight | _Learnt](Annotated[CampaignFlight | _Learnt, Field(discriminator="record")])


@dataclass(frozen=True, slots=True)
class Campaign:
    """flights: each once. unread: lines that are no result of a campaign."""

    flights: tuple[CampaignFlight, ...]
    unread: int = 0

    @property
    def faulty(self) -> tuple[CampaignFlight, ...]:
        """Judged flights with one of the thesis's faults."""
        return tuple(flight for flight in self.flights if flight.judged and flight.of_thesis)

    @property
    def scales(self) -> tuple[float, ...]:
        """Scales of the faults' fitted terms."""
        return tuple(sorted({flight.phenomenology for flight in self.faulty}))


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """Receiver operating characteristic of the score: a flight is flagged if its score is above a limit."""

    false_share: FloatArray  # (n,) of the healthy flights, for a limit that falls
    true_share: FloatArray  # (n,) of the damaged ones
    area: float  # under the curve, 0..1
    at_threshold: tuple[float, float]  # both shares at the limit 1, which is the threshold in use


def read_campaign(path: Path) -> Campaign:
    """Read a file of results. Raises InputError, naming it, if there is no flight among them."""
    with open_regular(path, MOST_BYTES) as file:
        text = file.read().decode(errors="replace")  # a line that is no UTF-8 is no result, as any other
    flights, unread = dict[str, CampaignFlight](), 0
    for line in filter(str.strip, text.splitlines()):
        try:
            found = _LINE.validate_json(line)
        except ValidationError:
            unread += 1
            continue
        if isinstance(found, CampaignFlight):
            flights[found.key] = found
    if not flights:
        what = "is a campaign's summary" if '"detection"' in text else "holds no flight of a campaign"
        raise InputError(f"{path}: {what}; {REMEDY}")
    return Campaign(tuple(flights.values()), unread)


def roc_of(healthy: Sequence[float], damaged: Sequence[float]) -> Roc:
    """The curve of these scores, neither of them empty.

    >>> roc_of([0.2, 0.9], [0.5, 3.0]).area
    0.75
    """
    limits, both = np.unique([*healthy, *damaged])[::-1], (np.asarray(healthy), np.asarray(damaged))
    false_share, true_share = (np.append(0.0, (scores >= limits[:, None]).mean(axis=1)) for scores in both)
    at_one = (float(np.mean(both[0] > 1.0)), float(np.mean(both[1] > 1.0)))
    return Roc(false_share, true_share, float(np.trapezoid(true_share, false_share)), at_one)


def campaign_pictures(campaign: Campaign) -> tuple[Picture, ...]:
    """All of a campaign, in the order of the page."""
    return (_roc(campaign), _severity(campaign), _latency(campaign))


@picture("campaign-roc")
def _roc(campaign: Campaign) -> Chart:
    before = (flight.score_before for flight in campaign.flights if flight.judged and flight.cause == HEALTHY)
    healthy, curves = [score for score in before if score is not None], list[tuple[str, Roc]]()
    for scale in campaign.scales:
        after = (flight.score_after for flight in campaign.faulty if flight.phenomenology == scale)
        damaged = [score for score in after if score is not None]
        if healthy and damaged:
            roc = roc_of(healthy, damaged)
            curves.append((f"fitted terms x{scale:g}, {len(damaged)} damaged: area {roc.area:.3f}", roc))
    if not curves:
        lacking = "no healthy flight has a score" if campaign.faulty else NO_FAULTS
        raise NotDrawn(f"{lacking}; campaigns of this version write them")
    lines = [Line(np.array([0.0, 100.0]), np.array([0.0, 100.0]), "chance", "faint")]
    for look, (label, roc) in zip(LOOKS, curves, strict=False):
        lines.append(Line(100 * roc.false_share, 100 * roc.true_share, label, look))
        false_share, true_share = (np.array([100 * at]) for at in roc.at_threshold)
        lines.append(Line(false_share, true_share, "", f"{look} big", "dots"))
    panel = Panel("damaged flights found [%]", lines, y=(-2, 102), height=260)
    score = "the highest statistic over its threshold of the monitors that decide about propellers"
    when = "of the whole healthy flight, and of a damaged one after the onset"
    note = f"{len(healthy)} healthy flights; the score is {score}, {when}."
    return Chart([panel], (-1, 101), note, "healthy flights flagged [%]", kind="still")


@picture("campaign-severity")
def _severity(campaign: Campaign) -> Chart:
    if not (flights := campaign.faulty):
        raise NotDrawn(NO_FAULTS)
    panels = []
    for scale in campaign.scales:
        lines = []
        for place, (look, kind) in enumerate(zip(LOOKS, FaultType, strict=False)):
            shares = [_share(flights, f"{kind}/SV{severity}", scale) for severity in (1, 2, 3)]
            found = [(severity + 0.06 * (place - 1), *share) for severity, share in enumerate(shares, 1) if share]
            if found:
                x, y, low, high = np.transpose(found)
                lines += [Line(x, y, NAMES[kind], look), Line(x, y, "", f"{look} big", "dots")]
                lines.append(errors(x, x, low, high, look))
        panels.append(Panel(f"found [%], fitted terms x{scale:g}", lines, y=(-3, 103), height=150))
    found_count = sum(flight.latency_s is not None for flight in flights)
    note = f"{found_count} of {len(flights)} damaged flights had an alarm after the onset."
    return Chart(panels, (0.7, 3.3), note, "severity", [(at, f"{at:g}") for at in (1.0, 2.0, 3.0)], kind="still")


def _share(flights: Sequence[CampaignFlight], cause: str, scale: float) -> tuple[float, float, float] | None:
    """Found share of one fault with Wilson's interval [%]; None without a flight."""
    from scipy.stats import binomtest

    own = (flight for flight in flights if (flight.cause, flight.phenomenology) == (cause, scale))
    hits = [flight.latency_s is not None for flight in own]
    if not hits:
        return None
    interval = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    return 100 * sum(hits) / len(hits), 100 * float(interval.low), 100 * float(interval.high)


@picture("campaign-latency")
def _latency(campaign: Campaign) -> Chart:
    curves = []
    for kind in FaultType:
        own = [flight.latency_s for flight in campaign.faulty if flight.cause.startswith(kind)]
        if own:
            curves.append((kind, np.sort([latency_s for latency_s in own if latency_s is not None]), len(own)))
    if not curves:
        raise NotDrawn(NO_FAULTS)
    longest = 1.05 * max((float(times[-1]) for _, times, _ in curves if len(times)), default=1.0)
    lines = []
    for look, (kind, times, count) in zip(LOOKS, curves, strict=False):
        share = np.append(np.arange(len(times) + 1), len(times)) * (100 / count)
        x, y = np.repeat([0.0, *times, longest], 2)[1:], np.repeat(share, 2)[:-1]
        lines.append(Line(x, y, f"{NAMES[kind]} ({count} flights)", look))
    medians = [f"{kind}: median {np.median(times):.2f} s" for kind, times, _ in curves if len(times)]
    panel = Panel("flights noticed [%]", lines, y=(0, 102), height=200)
    note, below = f"{'; '.join(medians) or 'None noticed'}.", "time from the onset to the first alarm [s]"
    return Chart([panel], (0.0, longest), note, below, kind="still")


def confusion(campaign: Campaign) -> tuple[tuple[str, ...], list[tuple[str, *tuple[int, ...]]]]:
    """What was answered, and of each cause how many flights got each answer."""
    pairs = [(flight.cause[:2] if flight.of_thesis else flight.cause, flight.answered) for flight in campaign.flights]
    pairs.sort(key=lambda pair: (not pair[0].startswith("F"), pair[0] == HEALTHY, pair[0]))
    answers, counts = {answer for _, answer in pairs}, Counter(pairs)
    columns = tuple(answer for answer in (*ORDER, *sorted(answers - {*ORDER, *LAST}), *LAST) if answer in answers)
    true = dict.fromkeys(cause for cause, _ in pairs)
    return columns, [(cause, *(counts[cause, answer] for answer in columns)) for cause in true]
