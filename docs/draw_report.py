"""Draw docs/report-evidence.svg and docs/report-residual.svg: two figures of a report, of an emulated flight.

python docs/draw_report.py [FOLDER]
"""

import re
import sys
from functools import cache
from pathlib import Path

import numpy as np

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.judging import JudgedFlight, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.report.chart import FOLDER as REPORT
from mavdiag.report.pictures import evidence_picture, residual_picture
from mavdiag.report.sketch import Sketch
from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.plan import injections_of
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import PlantConfig

LINK = LinkSpec("qdrone2", 400.0)
HEALTHY, JUDGED = (1, 2, 3), 9  # seeds of the flights
FLIGHT_S, ONSET_S, FAULT, ROTOR = 20.0, 10.0, "F2/SV2", 1
COLUMNS = 300
WIDTH = 760  # of a drawing [px]
CREATED = "2026-01-01T00:00:00+00:00"


def fly(seed: int, injections: tuple[Injection, ...] = ()) -> Log:
    """One flight, as a receiver reads it."""
    telemetry, _ = flight_telemetry(PlantConfig(seed=seed, injections=injections), FLIGHT_S, LINK)
    return Log(f"seed {seed}", telemetry.digest, LINK.profile, telemetry)


@cache
def baseline() -> Baseline:
    """Of the healthy flights."""
    return learn([fly(seed) for seed in HEALTHY], LearnOptions(airframe=airframe_named("qdrone2")), created=CREATED)


@cache
def cracked() -> tuple[Log, JudgedFlight]:
    """A flight in which a propeller cracks."""
    log = fly(JUDGED, injections_of(FAULT, ROTOR, ONSET_S, 1.0, np.random.default_rng(0)))
    return log, judge_in_full(log, baseline())


def standing_alone(svg: str) -> str:
    """The drawing as a file of its own."""
    height = int(re.findall(r'height="(\d+)"', svg)[0]) + 16
    style = (REPORT / "chart.css").read_text(encoding="utf-8")
    ground = '<rect width="100%" height="100%" class="ground"/>'
    inner = svg.strip().replace('width="100%"', f'x="64" y="8" width="{WIDTH - 84}" overflow="visible"', 1)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}">'
    return f"{head}<style>{style}</style>{ground}{inner}</svg>\n"


def main(folder: Path) -> None:
    """Draw. The same versions of the libraries give the same bytes."""
    log, judged = cracked()
    if judged.chain is None:
        raise SystemExit(f"draw_report: the flight could not be judged: {judged.verdict.reason}")
    sketch = Sketch(log, COLUMNS)
    sketch.take(judged.chain, judged.pieces)
    for picture in (evidence_picture(sketch), residual_picture(sketch)):
        (folder / f"report-{picture.key}.svg").write_text(standing_alone(picture.svg), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
