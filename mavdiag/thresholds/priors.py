"""How the healthy maxima of each monitor differ before any flight tells: `priors.json`, a file with its provenance.

`benchmarks/make_priors.py` pools healthy baselines of several airframes. Beside what these show stands an estimate by
hand, with its reason, of what no emulator shows. The wider of both holds. Where a statistic is compared with its own
mean and the airframes of the pool differ by less, these are a class of their own, and the flights tell of which class
theirs is. Where it is not, flights alike say nothing of what other propellers move.
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
    shown = tuple(known["emulated"]) or (0.0, 0.0, 0.0)
    wider = tuple(map(max, known["estimate"], shown))
    narrower = known["shares"] and any(shown) and shown != wider
    return Prior(*wider, shares=known["shares"], other=shown if narrower else None)
