"""What a campaign found, drawn: ROC, latencies, answers, and detection against severity."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.airframe.propellers import FaultType
from mavdiag.report.campaign import HEALTHY, Campaign, CampaignFlight, matrix_of, roc_of
from mavdiag.report.plane import MARKERS, NAMES
from mavdiag.report.style import LINES, Picture, drawn, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["campaign_pictures"]

NO_FAULTS = "no judged flight of this campaign has one of the thesis's propeller faults"
ORDER = ("F1", "F2", "F3", "propeller fault", "sensor fault", "loss of control", "gross loss of thrust", "a fault")
LAST = ("suspicion", "nothing", "not judged")
LIGHT = 0.55  # share of a row from which on its cell is dark and its number white
ROC = Picture(
    "roc",
    "Damaged flights found against healthy flights flagged (ROC)",
    "A curve that reaches the upper left corner parts damaged from healthy flights whatever the threshold; the "
    "filled marks are the threshold in use.",
)
LATENCY = Picture(
    "latency",
    "How soon an alarm came after the onset of the damage",
    "Each curve rises with the share of the damaged flights that had been noticed by that time: what it lacks of 100 "
    "% at the right was never noticed.",
)
CONFUSION = Picture(
    "confusion",
    "What was wrong, and what was answered",
    "Rows are what was true and columns what was answered, in numbers of flights, darker for a larger share of the "
    "row: for the thesis's faults the dark cells should lie on the diagonal, for healthy flights under “nothing”.",
)
ROTORS = Picture(
    "rotors",
    "Which rotor was damaged, and which was named",
    "The dark cells should lie on the diagonal: each damaged rotor is named as itself, or not at all.",
)
SEVERITY = Picture(
    "severity",
    "Damage found against its severity",
    "Share of the judged flights with an alarm after the onset, with 95 % intervals: it should rise with the "
    "severity, and small damage is what is missed first.",
)


def campaign_pictures(campaign: Campaign) -> tuple[Picture, ...]:
    """All of a campaign, in the order of the page."""
    return (_roc(campaign), _severity(campaign), _latency(campaign), _confusion(campaign), _rotors(campaign))


def _roc(campaign: Campaign) -> Picture:
    healthy = [one.score_before for one in campaign.flights if one.judged and one.cause == HEALTHY]
    low = [one for one in healthy if one is not None]
    curves = []
    for scale in campaign.scales:
        high = [one.score_after for one in campaign.faulty if one.phenomenology == scale]
        known = [one for one in high if one is not None]
        if low and known:
            curves.append((scale, roc_of(low, known)))
    if not curves:
        lacking = "no healthy flight has a score" if campaign.faulty else NO_FAULTS
        return replace(ROC, not_drawn=f"{lacking}; campaigns of this version write them")

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for line, (scale, roc) in zip(LINES, curves, strict=False):
            label = f"fitted terms x{scale:g}: area {roc.area:.3f}"
            line.draw(axes, 100 * roc.false_share, 100 * roc.true_share, label)
            axes.plot(*(100 * one for one in roc.at_threshold), "s", color=line.color, markersize=6, clip_on=False)
        axes.plot((0, 100), (0, 100), color="#767676", linewidth=0.7, linestyle=":", label="chance")
        axes.set(
            xlabel="healthy flights flagged [%]", ylabel="damaged flights found [%]", xlim=(-1, 101), ylim=(-1, 102)
        )
        legend_above(axes, 2)

    words = "; ".join(
        f"terms x{scale:g}: area {roc.area:.3f} of {roc.damaged} damaged and {roc.healthy} healthy flights"
        for scale, roc in curves
    )
    note = (
        f" {curves[0][1].healthy} healthy flights; the score is the highest statistic over its threshold of the "
        "monitors that decide about propellers, of the whole healthy flight, and of a damaged one after the onset."
    )
    return replace(ROC, caption=ROC.caption + note, svg=drawn(ROC.title, f"{words}.", plot, 3.6))


def _severity(campaign: Campaign) -> Picture:
    if not campaign.faulty:
        return replace(SEVERITY, not_drawn=NO_FAULTS)

    def plot(figure: "Figure") -> None:
        several = figure.subplots(1, len(campaign.scales), sharey=True, squeeze=False)[0]
        for axes, scale in zip(several, campaign.scales, strict=True):
            for place, (line, kind) in enumerate(zip(LINES, FaultType, strict=False)):
                rows = [_share(campaign.faulty, kind, severity, scale) for severity in (1, 2, 3)]
                x = [severity + 0.08 * (place - 1) for severity, row in enumerate(rows, start=1) if row]
                y = np.array([row for row in rows if row])
                if len(y):
                    spread = np.abs(y[:, 1:] - y[:, :1]).T
                    style = {"color": line.color, "linestyle": line.stroke, "marker": MARKERS[kind]}
                    axes.errorbar(x, y[:, 0], yerr=spread, elinewidth=0.8, capsize=2, label=NAMES[kind], **style)
            axes.set(xlabel=f"severity\n(fitted terms x{scale:g})", ylim=(-3, 103), xlim=(0.6, 3.4))
            axes.set_xticks((1, 2, 3))
        several[0].set_ylabel("flights with an alarm [%]")
        named = {label: line for axes in several for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        legend_above(several[-1], 3, named)

    found = sum(one.latency_s is not None for one in campaign.faulty)
    words = f"{found} of {len(campaign.faulty)} damaged flights had an alarm after the onset."
    return replace(SEVERITY, svg=drawn(SEVERITY.title, words, plot, 2.9))


def _share(
    flights: Sequence[CampaignFlight], kind: FaultType, severity: int, scale: float
) -> tuple[float, float, float] | None:
    """Found share of one fault with Wilson's interval [%]; None without a flight."""
    from scipy.stats import binomtest

    own = [one for one in flights if one.cause == f"{kind}/SV{severity}" and one.phenomenology == scale]
    if not own:
        return None
    hits = sum(one.latency_s is not None for one in own)
    interval = binomtest(hits, len(own)).proportion_ci(method="wilson")
    return 100 * hits / len(own), 100 * float(interval.low), 100 * float(interval.high)


def _latency(campaign: Campaign) -> Picture:
    if not campaign.faulty:
        return replace(LATENCY, not_drawn=NO_FAULTS)
    curves = []
    for kind in FaultType:
        own = [one for one in campaign.faulty if one.cause.startswith(kind)]
        times = np.sort([one.latency_s for one in own if one.latency_s is not None])
        if own:
            curves.append((kind, times, 100 * np.arange(1, len(times) + 1) / len(own), len(own)))
    longest = 1.05 * max((float(times[-1]) for _, times, _, _ in curves if len(times)), default=1.0)

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for line, (kind, times, share, count) in zip(LINES, curves, strict=False):
            x, y = np.concatenate(([0.0], times, [longest])), np.concatenate(([0.0], share, share[-1:] or [0.0]))
            axes.step(
                x, y, where="post", color=line.color, linestyle=line.stroke, label=f"{NAMES[kind]} ({count} flights)"
            )
        axes.set(xlabel="time from the onset to the first alarm [s]", ylabel="flights noticed [%]", ylim=(0, 102))
        axes.set_xlim(0, longest)
        legend_above(axes, 3)

    medians = [f"{kind}: median {np.median(times):.2f} s" for kind, times, _, _ in curves if len(times)]
    return replace(LATENCY, svg=drawn(LATENCY.title, f"{'; '.join(medians) or 'none noticed'}.", plot, 2.7))


def _confusion(campaign: Campaign) -> Picture:
    pairs = [(one.cause[:2] if one.of_thesis else one.cause, one.answered) for one in campaign.flights]
    pairs.sort(key=lambda pair: (not pair[0].startswith("F"), pair[0] == HEALTHY, pair[0]))
    order = [*ORDER, *sorted({b for _, b in pairs} - {*ORDER, *LAST}), *LAST]
    return _matrix(CONFUSION, pairs, order, "answered", "true")


def _rotors(campaign: Campaign) -> Picture:
    named = [one for one in campaign.faulty if one.latency_s is not None]
    pairs = [(str(one.rotor), "none" if one.answer.rotor is None else str(one.answer.rotor)) for one in named]
    if not pairs:
        return replace(ROTORS, not_drawn="no damage of a propeller was found, so no rotor could be named")
    pairs.sort()
    order = [*sorted({b for _, b in pairs} - {"none"}), "none"]
    return _matrix(ROTORS, pairs, order, "named rotor", "damaged rotor")


def _matrix(
    picture: Picture, pairs: Sequence[tuple[str, str]], order: Sequence[str], across: str, down: str
) -> Picture:
    true, answered, counts = matrix_of(pairs)
    columns = [one for one in order if one in answered]
    counts = counts[:, [answered.index(one) for one in columns]]
    share = counts / counts.sum(axis=1, keepdims=True)

    def plot(figure: "Figure") -> None:
        axes: Axes = figure.subplots()
        axes.pcolormesh(share, cmap="Greys", vmin=0.0, vmax=1.2, edgecolors="white", linewidth=1.5)
        for (row, column), count in np.ndenumerate(counts):
            ink = "white" if share[row, column] > LIGHT else "black"
            text = f"{count:.0f}" if count else ""
            axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", color=ink)
        axes.set_yticks(np.arange(len(true)) + 0.5, true)
        axes.set_xticks(np.arange(len(columns)) + 0.5, [one.replace(" ", "\n", 1) for one in columns])
        axes.set(xlabel=across, ylabel=down)
        axes.invert_yaxis()
        axes.grid(visible=False)
        axes.tick_params(length=0)

    words = "; ".join(
        f"{name}: " + ", ".join(f"{column} {count:.0f}" for column, count in zip(columns, row, strict=True) if count)
        for name, row in zip(true, counts, strict=True)
    )
    return replace(picture, svg=drawn(picture.title, f"{words}.", plot, 1.1 + 0.3 * len(true)))
