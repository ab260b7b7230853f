"""Draw docs/demo.svg: the demo's own picture at the end of a real run.

python docs/draw_demo.py
"""

import io
from pathlib import Path

from rich.console import Console

from mavdiag.demo.closed_loop import POLL_S, Flight, closed_loop
from mavdiag.demo.command import own_baseline
from mavdiag.demo.display import picture

FLIGHT = Flight(duration_s=30.0, fault="F2/SV2", rotor=1, onset_s=12.0, seed=1)
UNTIL_S = 22.5  # of flight, when the picture is taken


def main() -> None:
    """Fly, and keep the picture."""
    console = Console(record=True, width=100, file=io.StringIO())
    with closed_loop(FLIGHT, own_baseline(quiet=True)) as loop:
        while loop.plant.running and loop.station.t_s < UNTIL_S:
            loop.station.listen(POLL_S)
        console.print(picture(loop.station, FLIGHT.onset_s, FLIGHT.duration_s))
    Path(__file__).with_name("demo.svg").write_text(console.export_svg(title="mavdiag demo"), encoding="utf-8")


if __name__ == "__main__":
    main()
