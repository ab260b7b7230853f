"""How the healthy maxima of each monitor differ before any flight tells: `priors.json`, a file with its provenance.

`benchmarks/make_priors.py` pools healthy baselines of several airframes. Beside what these show stands an estimate by
hand, with its reason, of what no emulator shows. Where a statistic is compared with its own mean, they are two classes
of airframes, and the flights tell which one theirs is of. Where it is not, flights alike say nothing of what other
propellers move, and the wider of both holds.
"""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from mavdiag.thresholds.rule import USUAL, Prior


@cache
def priors_file() -> Mapping[str, Any]:
    """The file: where its figures are from, and by monitor the figures of `Prior` with the reason of each."""
    text = resources.files("mavdiag.thresholds").joinpath("priors.json").read_text(encoding="utf-8")
    content: Mapping[str, Any] = json.loads(text)
    return content


def prior_of(monitor: str) -> Prior:
    """The prior of a monitor of that name, the usual one if the file has none."""
    known = priors_file()["priors"].get(monitor)
    if known is None:
        return USUAL
    estimate, shown = known["estimate"], known["emulated"]
    if known["shares"]:
        return Prior(*estimate, other=tuple(shown) or None)
    return Prior(*map(max, estimate, shown or estimate), shares=False)
