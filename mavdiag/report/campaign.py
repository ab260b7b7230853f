"""The results of `sitl-plant campaign`: read and checked where they come in, and drawn.

Each line is one JSON object, as `sitl_plant.campaign.worker.FlightResult`; only the fields that are drawn are read.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from mavdiag.airframe.propellers import FaultType
from mavdiag.errors import InputError
from mavdiag.report.pictures import MARKERS, NAMES
from mavdiag.report.style import LINES, Drawn, NotDrawn, Picture, legend_above, picture, sheet
from mavdiag.storage import open_regular
from mavdiag.telemetry import FloatArray

MOST_BYTES = 1 << 30  # of a file of results (our choice)
HEALTHY = "healthy"
UNJUDGED = ("not_judgeable", "error")
REMEDY = "name the file that `sitl-plant campaign -o FILE.jsonl` wrote"
NO_FAULTS = "no judged flight of this campaign has one of the thesis's propeller faults"
ORDER = ("F1", "F2", "F3", "propeller fault", "sensor fault", "loss of control", "gross loss of thrust", "a fault")
LAST = ("suspicion", "nothing", "not judged")
LIGHT = 0.55  # share of a row from which on its cell is dark and its number white
_FAULT = re.compile(r"F[123]/SV[123]")


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class Answer(_Line):
    """What the diagnosis answered."""

    kind: Annotated[str, Field(max_length=60)]
    fault_type: Annotated[str, Field(max_length=20)] | None = None


class CampaignFlight(_Line):
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


class _Learnt(_Line):
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
    """Read a file of results. Raises InputError, naming it, if it is none."""
    with open_regular(path, MOST_BYTES) as file:
        data = file.read()
    try:
        return parse_campaign(data.decode())
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text; {REMEDY}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_campaign(text: str) -> Campaign:
    """Read the results in a text of lines. Raises InputError if there is no flight among them."""
    flights: dict[str, CampaignFlight] = {}
    unread = 0
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
        raise InputError(f"{what}; {REMEDY}")
    return Campaign(tuple(flights.values()), unread)


def roc_of(healthy: Sequence[float], damaged: Sequence[float]) -> Roc:
    """The curve of these scores. Raises InputError if one of both is empty.

    >>> roc_of([0.2, 0.9], [0.5, 3.0]).area
    0.75
    """
    if not healthy or not damaged:
        raise InputError("a curve needs the scores of healthy and of damaged flights")
    limits = np.unique([*healthy, *damaged])[::-1]
    false_share, true_share = (
        np.append(0.0, (np.asarray(scores) >= limits[:, None]).mean(axis=1)) for scores in (healthy, damaged)
    )
    at_one = (float(np.mean(np.asarray(healthy) > 1.0)), float(np.mean(np.asarray(damaged) > 1.0)))
    return Roc(false_share, true_share, float(np.trapezoid(true_share, false_share)), at_one)


def campaign_pictures(campaign: Campaign) -> tuple[Picture, ...]:
    """All of a campaign, in the order of the page."""
    return (_roc(campaign), _severity(campaign), _latency(campaign), _confusion(campaign))


@picture("campaign-roc")
def _roc(campaign: Campaign) -> Drawn:
    before = (flight.score_before for flight in campaign.flights if flight.judged and flight.cause == HEALTHY)
    healthy, curves = [score for score in before if score is not None], list[tuple[float, int, Roc]]()
    for scale in campaign.scales:
        after = (flight.score_after for flight in campaign.faulty if flight.phenomenology == scale)
        damaged = [score for score in after if score is not None]
        if healthy and damaged:
            curves.append((scale, len(damaged), roc_of(healthy, damaged)))
    if not curves:
        lacking = "no healthy flight has a score" if campaign.faulty else NO_FAULTS
        raise NotDrawn(f"{lacking}; campaigns of this version write them")
    figure = sheet(3.6)
    axes = figure.subplots()
    for line, (scale, _, roc) in zip(LINES, curves, strict=False):
        label = f"fitted terms x{scale:g}: area {roc.area:.3f}"
        line.draw(axes, 100 * roc.false_share, 100 * roc.true_share, label)
        axes.plot(*(100 * at for at in roc.at_threshold), "s", color=line.color, markersize=6, clip_on=False)
    axes.plot((0, 100), (0, 100), color="#767676", linewidth=0.7, linestyle=":", label="chance")
    axes.set(xlabel="healthy flights flagged [%]", ylabel="damaged flights found [%]", xlim=(-1, 101), ylim=(-1, 102))
    legend_above(axes, 2)
    words = "; ".join(
        f"terms x{scale:g}: area {roc.area:.3f} of {count} damaged and {len(healthy)} healthy flights"
        for scale, count, roc in curves
    )
    note = (
        f"{len(healthy)} healthy flights; the score is the highest statistic over its threshold of the monitors that "
        "decide about propellers, of the whole healthy flight, and of a damaged one after the onset."
    )
    return figure, f"{words}.", note


@picture("campaign-severity")
def _severity(campaign: Campaign) -> Drawn:
    if not (flights := campaign.faulty):
        raise NotDrawn(NO_FAULTS)
    figure = sheet(2.9)
    several = figure.subplots(1, len(campaign.scales), sharey=True, squeeze=False)[0]
    for axes, scale in zip(several, campaign.scales, strict=True):
        for place, (line, kind) in enumerate(zip(LINES, FaultType, strict=False)):
            shares = [_share(flights, f"{kind}/SV{severity}", scale) for severity in (1, 2, 3)]
            x = [severity + 0.08 * (place - 1) for severity, share in enumerate(shares, start=1) if share]
            y = np.array([share for share in shares if share])
            if len(y):
                style = {"color": line.color, "linestyle": line.stroke, "marker": MARKERS[kind]}
                spread = {"yerr": np.abs(y[:, 1:] - y[:, :1]).T, "elinewidth": 0.8, "capsize": 2}
                axes.errorbar(x, y[:, 0], label=NAMES[kind], **spread, **style)
        axes.set(xlabel=f"severity\n(fitted terms x{scale:g})", ylim=(-3, 103), xlim=(0.6, 3.4))
        axes.set_xticks((1, 2, 3))
    several[0].set_ylabel("flights with an alarm [%]")
    named = {label: line for axes in several for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    legend_above(several[-1], 3, named)
    found = sum(flight.latency_s is not None for flight in flights)
    return figure, f"{found} of {len(flights)} damaged flights had an alarm after the onset.", ""


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
def _latency(campaign: Campaign) -> Drawn:
    curves = []
    for kind in FaultType:
        own = [flight.latency_s for flight in campaign.faulty if flight.cause.startswith(kind)]
        if own:
            curves.append((kind, np.sort([latency_s for latency_s in own if latency_s is not None]), len(own)))
    if not curves:
        raise NotDrawn(NO_FAULTS)
    longest = 1.05 * max((float(times[-1]) for _, times, _ in curves if len(times)), default=1.0)
    figure = sheet(2.7)
    axes = figure.subplots()
    for line, (kind, times, count) in zip(LINES, curves, strict=False):
        share = np.append(np.arange(len(times) + 1), len(times)) * (100 / count)
        x, label = [0.0, *times, longest], f"{NAMES[kind]} ({count} flights)"
        axes.step(x, share, where="post", color=line.color, linestyle=line.stroke, label=label)
    axes.set(xlabel="time from the onset to the first alarm [s]", ylabel="flights noticed [%]")
    axes.set(ylim=(0, 102), xlim=(0, longest))
    legend_above(axes, 3)
    medians = [f"{kind}: median {np.median(times):.2f} s" for kind, times, _ in curves if len(times)]
    return figure, f"{'; '.join(medians) or 'none noticed'}.", ""


@picture("campaign-confusion")
def _confusion(campaign: Campaign) -> Drawn:
    """The counts of each pair of what was true and what was answered."""
    pairs = [(flight.cause[:2] if flight.of_thesis else flight.cause, flight.answered) for flight in campaign.flights]
    pairs.sort(key=lambda pair: (not pair[0].startswith("F"), pair[0] == HEALTHY, pair[0]))
    answers = {answer for _, answer in pairs}
    columns = [answer for answer in (*ORDER, *sorted(answers - {*ORDER, *LAST}), *LAST) if answer in answers]
    true = tuple(dict.fromkeys(cause for cause, _ in pairs))
    counts = np.array([[pairs.count((cause, answer)) for answer in columns] for cause in true])
    share = counts / counts.sum(axis=1, keepdims=True)
    figure = sheet(1.1 + 0.3 * len(true))
    axes = figure.subplots()
    axes.pcolormesh(share, cmap="Greys", vmin=0.0, vmax=1.2, edgecolors="white", linewidth=1.5)
    for (row, column), count in np.ndenumerate(counts):
        ink = "white" if share[row, column] > LIGHT else "black"
        axes.text(column + 0.5, row + 0.5, str(count or ""), ha="center", va="center", color=ink)
    axes.set_yticks(np.arange(len(true)) + 0.5, true)
    axes.set_xticks(np.arange(len(columns)) + 0.5, [answer.replace(" ", "\n", 1) for answer in columns])
    axes.set(xlabel="answered", ylabel="true")
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(length=0)
    words = "; ".join(
        f"{cause}: " + ", ".join(f"{answer} {count}" for answer, count in zip(columns, row, strict=True) if count)
        for cause, row in zip(true, counts, strict=True)
    )
    return figure, f"{words}.", ""
