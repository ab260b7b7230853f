"""The page of a campaign: values in, HTML out."""

from collections import Counter

from mavdiag import __version__
from mavdiag.report.campaign import HEALTHY, Campaign
from mavdiag.report.campaign_figures import campaign_pictures
from mavdiag.report.html import escaped, figure, page, paragraph, table
from mavdiag.units import S_PER_H

__all__ = ["campaign_page"]


def campaign_page(campaign: Campaign, path: str, created: str) -> str:
    """One page. path: of the results, as it was given. created: ISO 8601, UTC."""
    body = [
        "<header>",
        f"<h1>{escaped(f'Campaign report: {path}')}</h1>",
        paragraph(f"Made {created} by mavdiag {__version__}."),
        "</header>",
        "<main>",
        '<div class="verdict">',
        paragraph(_headline(campaign), "said"),
        paragraph(_false(campaign)),
        paragraph(
            "All flights are emulated. The faults' fitted terms are the part of the fault model that was fitted to "
            "the thesis's figures; x0 is physics alone."
        ),
        "</div>",
        _counts(campaign),
        *(figure(one, "campaign", place) for place, one in enumerate(campaign_pictures(campaign), start=1)),
        "</main>",
    ]
    return page(f"Campaign report: {path}", body)


def _headline(campaign: Campaign) -> str:
    faulty = campaign.faulty
    if not faulty:
        return "No judged flight of this campaign has one of the thesis's propeller faults."
    found = sum(one.latency_s is not None for one in faulty)
    return f"Of {len(faulty)} judged flights with a damaged propeller {found} had an alarm after the damage began."


def _false(campaign: Campaign) -> str:
    judged = [one for one in campaign.flights if one.judged]
    hours = sum(one.healthy_s for one in judged) / S_PER_H
    episodes = sum(one.episodes for one in judged)
    flagged = sum(one.faults > 0 for one in judged if one.cause == HEALTHY)
    healthy = sum(one.cause == HEALTHY for one in judged)
    return (
        f"False alarms of single monitors in {hours:.2f} hours of healthy judged flight: {episodes}; "
        f"{flagged} of {healthy} healthy flights were declared faulty."
    )


def _counts(campaign: Campaign) -> str:
    flown = Counter(one.cause for one in campaign.flights)
    judged = Counter(one.cause for one in campaign.flights if one.judged)
    noticed = Counter(one.cause for one in campaign.flights if one.judged and one.latency_s is not None)
    rows = [
        (cause, str(count), str(judged[cause]), "-" if cause == HEALTHY else str(noticed[cause]))
        for cause, count in sorted(flown.items())
    ]
    unread = f" {campaign.unread} lines of the file are no results and were left out." if campaign.unread else ""
    heads = ("cause", "flights", "judged", "with an alarm after the onset")
    listing = table(f"Flights by cause.{unread}", heads, rows, numbers=(1, 2, 3))
    return f"<details><summary>Flights by cause ({len(campaign.flights)})</summary>{listing}</details>"
