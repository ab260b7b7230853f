"""Latency and grading of the faults in a campaign's result file: `python benchmarks/campaign_grades.py FILE.jsonl`.

Beside what `sitl-plant campaign` prints: median and 95th percentile of the latency by phenomenology, and how often
type, type with severity (nine classes), and severity within one grade are right where they are named.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np


def spread(latencies: Sequence[float | None]) -> str:
    """How many were found, and how soon."""
    found = [one for one in latencies if one is not None]
    if not found:
        return f"0 of {len(latencies)} found"
    median, late = np.percentile(found, [50, 95])
    return f"{len(found)} of {len(latencies)} found, latency s median {median:.2f}, 95 % {late:.2f}"


def main() -> None:
    """Print the figures."""
    lines = [json.loads(line) for line in Path(sys.argv[1]).read_text().splitlines()]
    flights = [one for one in lines if one.get("record") == "flight" and one["onset_s"] is not None]
    for scale in sorted({one["phenomenology"] for one in flights}, reverse=True):
        own = [one for one in flights if one["phenomenology"] == scale]
        weak = [one["latency_s"] for one in own if one["cause"] == "F2/SV1"]
        print(f"phenomenology {scale:g}: {spread([one['latency_s'] for one in own])}; F2/SV1: {spread(weak)}")
    told = [(one["cause"], one["answer"]) for one in flights if one["answer"]["fault_type"]]
    right = [(int(cause[-1]), answer) for cause, answer in told if cause.startswith(answer["fault_type"])]
    graded = [(true, answer["severity"]) for true, answer in right if answer["severity"]]
    of = sum(answer["severity"] is not None for _, answer in told)
    exact, near = sum(a == b for a, b in graded), sum(abs(a - b) <= 1 for a, b in graded)
    print(f"type right {len(right)} of {len(told)}; nine classes {exact} of {of}; within one severity {near} of {of}")
    named = [(one["rotor"], one["answer"]["rotor"]) for one in flights if one["answer"]["rotor"]]
    print(f"rotor right {sum(a == b for a, b in named)} of {len(named)} named")


if __name__ == "__main__":
    main()
