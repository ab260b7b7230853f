"""The demo's live picture: residual against margin, FSD against FML, and the texts as they come."""

from types import TracebackType
from typing import Self

from rich.bar import Bar
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from mavdiag.demo.ground_station import GroundStation, ReceivedText
from mavdiag.link.messages import Severity

__all__ = ["Display", "picture"]

BAR_WIDTH = 50
TEXTS = 8


class Display:
    """Live on a terminal; on anything else one line a text; silent if `quiet`."""

    def __init__(self, onset_s: float, duration_s: float, *, quiet: bool) -> None:
        self._onset_s, self._duration_s, self._quiet = onset_s, duration_s, quiet
        self._console = Console()
        self._live = Live(console=self._console, refresh_per_second=10) if self._console.is_terminal else None
        self._shown = 0

    def __enter__(self) -> Self:
        if self._live is not None and not self._quiet:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None and not self._quiet:
            self._live.stop()

    def show(self, station: GroundStation) -> None:
        """Bring the picture up to date."""
        if self._quiet:
            return
        if self._live is not None:
            self._live.update(picture(station, self._onset_s, self._duration_s))
            return
        for text in station.texts[self._shown :]:
            self._console.print(_line(text))
        self._shown = len(station.texts)


def picture(station: GroundStation, onset_s: float, duration_s: float) -> Panel:
    """What has been received so far, as a panel."""
    figures = station.figures
    table = Table.grid(padding=(0, 1))
    residual, margin = abs(figures.get("PF_RES", 0.0)), figures.get("PF_MARG", 0.0)
    table.add_row(*_gauge("|residual|", residual, margin, "margin", "rad/s"))
    table.add_row(*_gauge("FSD", figures.get("PF_FSD", 0.0), figures.get("PF_FML", 0.0), "FML", "s"))
    phase = "healthy" if station.t_s < onset_s else "damaged"
    title = f"flight {station.t_s:5.1f} of {duration_s:g} s, {phase} (fault at {onset_s:g} s)"
    return Panel(Group(table, *(_line(text) for text in station.texts[-TEXTS:])), title=title)


def _gauge(name: str, value: float, limit: float, limit_name: str, unit: str) -> tuple[Text, Bar, Text]:
    """A bar whose middle is the limit."""
    above = limit > 0 and value > limit
    bar = Bar(2 * limit or 1.0, 0, value, width=BAR_WIDTH, color="red" if above else "green")
    return Text(name), bar, Text(f"{value:.3f} {unit} of {limit_name} {limit:.3f}")


def _line(text: ReceivedText) -> Text:
    severity = Severity(text.severity)
    style = "bold red" if severity <= Severity.CRITICAL else "yellow" if severity <= Severity.WARNING else ""
    return Text(f"{text.t_s:7.2f} s  {severity.name:<8} {text.text}", style=style)
