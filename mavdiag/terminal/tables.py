"""Answers about many logs as a table for a terminal, the gravest first. On a pipe, or a narrow one, they are lines."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from rich.console import Console
from rich.table import Table
from rich.text import Text

from mavdiag.archive.paths import apart
from mavdiag.archive.tables import Row
from mavdiag.look.inspection import Inspection
from mavdiag.look.words import parts_of
from mavdiag.printable import counted, printable

STYLES = {"fault": "bold red", "suspected": "yellow", "error": "magenta", "not_judgeable": "cyan", "healthy": "green"}
ORDER = tuple(STYLES)
FOLDED = ("log", "what it shows")  # columns that give way
NUMBERS = ("rotor", "since\n(clock)", "ratio", "judged", "flight", "rate")  # columns that stand at the right


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
    counts = Counter(str(row["verdict"]) for row in rows)
    words = [Text(f"{counts[name]} {name.replace('_', ' ')}", STYLES[name]) for name in ORDER if counts[name]]
    judged_s, flown_s = (sum(float(row[name] or 0) for row in rows) for name in ("judged_s", "flown_s"))
    totals = Text(f"{counted(len(rows), 'log')}: ") + Text(", ").join(words)
    totals += Text(f"; judged {judged_s / 60:.1f} of {flown_s / 60:.1f} min")
    why = [Text(printable(f"{row['log']}: {row['reason']}")) for row in ranked if row["verdict"] == "error"]
    _print(("log", "verdict", "rotor", "since\n(clock)", "nearest\nmonitor", "ratio", "judged"), lines, console)
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
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in columns:
        side: Literal["right", "left"] = "right" if name in NUMBERS else "left"
        table.add_column(name, justify=side, no_wrap=name not in FOLDED, overflow="fold")
    for row in lines:
        table.add_row(*row)
    (console or Console()).print(table)
