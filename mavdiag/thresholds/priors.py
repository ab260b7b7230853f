"""How the healthy maxima of each monitor differ before any flight tells: `priors.json`, a file with its provenance.

`benchmarks/make_priors.py` pools healthy baselines of several airframes. A prior is the wider of what these show and of
an estimate by hand, for what no emulator shows; both stand beside it, with the reason of the estimate.
"""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from mavdiag.thresholds.rule import USUAL, Prior

FIGURES = ("session", "flight", "block", "shares")


@cache
def priors_file() -> Mapping[str, Any]:
    """The file: where its figures are from, and by monitor the figures of `Prior` with the reason of each."""
    text = resources.files("mavdiag.thresholds").joinpath("priors.json").read_text(encoding="utf-8")
    content: Mapping[str, Any] = json.loads(text)
    return content


def prior_of(monitor: str) -> Prior:
    """The prior of a monitor of that name, the usual one if the file has none."""
    known = priors_file()["priors"].get(monitor)
    return USUAL if known is None else Prior(**{name: known[name] for name in FIGURES})
