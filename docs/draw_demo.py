"""Draw docs/demo.svg: the demo's own picture at the end of a real run.

python docs/draw_demo.py
"""

import io
from pathlib import Path

from rich.console import Console

from mavdiag.baseline import Baseline
from mavdiag.demo.command import DETECTOR, SPAN_S, THESIS, flight_view, own_baselines
from mavdiag.demo.subprocesses import POLL_S, Flight, closed_loop
from mavdiag.terminal.ground_station import Line, LiveJudge
from mavdiag.terminal.view import line_for, picture

FLIGHT = Flight(duration_s=50.0, fault="F2/SV2", rotor=1, onset_s=15.0, seed=1)  # as `mavdiag demo`
UNTIL_S = 24.0  # of flight, when the picture is taken


def main() -> None:
    """Fly, and keep the picture."""
    console = Console(record=True, width=100, file=io.StringIO())
    fused, thesis = own_baselines(quiet=True)
    events: list[Line] = []
    with closed_loop(FLIGHT, fused, LiveJudge(Baseline.load(thesis), SPAN_S)) as (plant, _, station):
        while plant.running and station.t_s < UNTIL_S:
            events += [line_for(one, DETECTOR, THESIS) for one in station.listen(POLL_S)]
        console.print(picture(flight_view(station, FLIGHT, events), console.width))
    Path(__file__).with_name("demo.svg").write_text(console.export_svg(title="mavdiag demo"), encoding="utf-8")


if __name__ == "__main__":
    main()
