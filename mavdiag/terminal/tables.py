"""Answers about many logs as a table for a terminal, the gravest first. On a pipe they are lines."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from mavdiag.archive.paths import apart
from mavdiag.archive.tables import Row
from mavdiag.look.inspection import Inspection
from mavdiag.look.words import parts_of
from mavdiag.printable import printable

STYLES = {"fault": "bold red", "suspected": "yellow", "error": "magenta", "not_judgeable": "cyan", "healthy": "green"}
ORDER = tuple(STYLES)
UNBOUND = 10_000  # characters: wider than any table
WIDTHS = {"verdict": 9, "rotor": 7, "since (clock)": 7, "nearest monitor": 15}  # where names need the room
NUMBERS = ("rotor", "since (clock)", "ratio", "judged", "flight", "rate")  # columns that stand at the right


def verdict_table(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print a row a log, by verdict and by the nearest monitor's share of its threshold, and totals below."""
    ranked = sorted(rows, key=lambda row: (ORDER.index(str(row["verdict"])), -float(row["ratio"] or 0)))
    lines = []
    for row, name in zip(ranked, apart([str(row["log"]) for row in ranked]), strict=True):
        verdict, flown_s = str(row["verdict"]), float(row["flown_s"] or 0)
        share = f"{100 * float(row['judged_s'] or 0) / flown_s:.0f} %" if flown_s else ""
        since = "" if row["since_s"] is None else f"{row['since_s']:.1f} s"
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.2f}"
        named = str(row.get("rotors") or row["rotor"] or "").split("; ")  # "4 from 98.7 s", or the number alone
        rotors = ",".join(dict.fromkeys(part.partition(" ")[0] for part in named))
        told = (name, verdict.replace("_", " "), rotors, since, row["monitor"] or "", ratio, share)
        lines.append(_styled(told, STYLES[verdict]))
    counted = Counter(str(row["verdict"]) for row in rows)
    words = [Text(f"{counted[name]} {name}", STYLES[name]) for name in ORDER if counted[name]]
    judged_s, flown_s = (sum(float(row[name] or 0) for row in rows) for name in ("judged_s", "flown_s"))
    totals = Text(f"{len(rows)} logs: ") + Text(", ").join(words)
    totals += Text(f"; judged {judged_s / 60:.1f} of {flown_s / 60:.1f} min")
    why = [Text(printable(f"{row['log']}: {row['reason']}")) for row in ranked if row["verdict"] == "error"]
    _print(("log", "verdict", "rotor", "since (clock)", "nearest monitor", "ratio", "judged"), lines, console)
    for text in (totals, *why):
        (console or Console()).print(text)


def look_table(found: Iterable[Inspection | Mapping[str, str]]) -> None:
    """Print a row a log; those that fell or cannot be read come first. A mapping is a log and its error."""
    ranked = sorted(found, key=lambda one: (isinstance(one, Inspection), isinstance(one, Inspection) and not one.upset))
    lines = []
    names = apart([one.log if isinstance(one, Inspection) else one["log"] for one in ranked])
    for one, name in zip(ranked, names, strict=True):
        if not isinstance(one, Inspection):
            lines.append(_styled((name, "", "", "", one["error"]), STYLES["error"]))
            continue
        rate_hz = 0.0 if one.gyro is None else one.gyro.rate_hz or 0.0
        told = one.no_flight or ", ".join(parts_of(one))
        style = STYLES["fault"] if one.upset else STYLES["not_judgeable"] if one.no_flight else ""
        lines.append(_styled((name, one.profile, f"{one.flight_s:.0f} s", f"{rate_hz:.0f} Hz", told), style))
    _print(("log", "profile", "flight", "rate", "what it shows"), lines)


def _styled(cells: Iterable[str | float | None], style: str) -> list[Text]:
    return [Text(printable(str(cell)), style) for cell in cells]


def _print(columns: Sequence[str], lines: Iterable[list[Text]], console: Console | None = None) -> None:
    table, console = Table(box=None, pad_edge=False, header_style="bold"), console or Console()
    for name in columns:
        wide = name in ("log", "what it shows")
        table.add_column(name, justify="right" if name in NUMBERS else "left", no_wrap=not wide, overflow="fold")
    for line in lines:
        table.add_row(*line)
    if console.measure(table, options=console.options.update_width(UNBOUND)).maximum > console.width:
        for column in table.columns:
            column.width = WIDTHS.get(str(column.header))
            column.no_wrap = column.no_wrap and column.width is None
    console.print(table)
