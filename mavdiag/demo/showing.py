"""The demo's flight as it goes on, shown to whoever is there (edge)."""

from rich.panel import Panel

from mavdiag.decision.diagnosis import Change
from mavdiag.demo.closed_loop import POLL_S, Flight, Loop
from mavdiag.demo.story import DETECTOR, THESIS, flight_view
from mavdiag.terminal.screen import Screen
from mavdiag.terminal.view import Line, picture
from mavdiag.terminal.views import line_for

__all__ = ["watch"]


def watch(loop: Loop, flight: Flight, *, quiet: bool) -> list[Change]:
    """Listen until the flight is over, showing it if there is somebody to show it to.

    Returns how the decision of the thesis rule changed.
    """
    changes: list[Change] = []
    events: list[Line] = []

    def draw(width: int, height: int) -> Panel:
        return picture(flight_view(loop.station, flight, events), width, height)

    with Screen(quiet=quiet) as screen:
        running = True
        while running:
            running = loop.plant.running
            fresh = loop.station.listen(POLL_S)
            changes += [one for one in fresh if isinstance(one, Change)]
            lines = [line_for(one, DETECTOR, THESIS) for one in fresh]
            events.extend(lines)
            screen.show(draw, lines, last=not running)
    return changes
