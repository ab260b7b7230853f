"""The terminal: pictures, keys, journals, progress, and nothing from outside that steers it."""

import contextlib
import io
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from made_session import baseline_for
from made_vehicle import record
from memory_port import memory_pair
from rich.cells import cell_len
from rich.console import Console

import detector.__main__ as command
from mavdiag import commandline
from mavdiag.archive.tables import Row
from mavdiag.commands.progress import shown
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import BaselineError, InputError, UsageError
from mavdiag.judging import judge, playable
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Component, MessageId, Severity
from mavdiag.logs import read_log
from mavdiag.printable import printable
from mavdiag.telemetry import Axis
from mavdiag.terminal import watching
from mavdiag.terminal.ground_station import FIGURES, GroundStation, Line, LiveJudge
from mavdiag.terminal.tables import verdict_table
from mavdiag.terminal.view import Curve, Level, StripView, View, figure_levels, picture, strip
from mavdiag.terminal.watching import KEYS, Journal, Key, Position, Screen, follow, keys_in, play

LEVEL = Level("unbalance", 0.5, 1.0, "g mm")
ERASED = "\x1b[1A\x1b[2K"  # up to the line of the bar, and away with it
EVIL = "\x1b[31mred\x1b]0;title\x07\r\nforged line\x9b2J\u202eleft\u2028end\x00"


def test_a_log_is_replayed_as_a_link_is_watched(tmp_path: Path) -> None:
    path, baseline, out = tmp_path / "flight.tlog", baseline_for(), io.StringIO()
    record(path, ((20.0, 0.0), (10.0, 0.5)))
    begin = partial(LiveJudge, baseline, 20.0)
    with contextlib.redirect_stdout(out):
        play(read_log(path), begin, math.inf, 0.0, Axis.ROLL, lambda: False)
    lines = out.getvalue().splitlines()
    assert [line[:21].split() for line in lines][-1][2] == "CRITICAL"
    assert "propeller fault: a monitor is above its threshold (fsd" in lines[-1]
    assert len(lines) == len(judge(read_log(path), baseline).changes)
    other = baseline.model_copy(update={"link": baseline.link.model_copy(update={"profile": "px4"})})
    with pytest.raises(BaselineError, match=r"flight.tlog: another link: link.profile: the baseline is for 'px4'"):
        playable(other, read_log(path))
    with pytest.raises(UsageError, match=r"--from 31: flight.tlog has 30.0 s"):
        playable(baseline, read_log(path), 31.0)
    with contextlib.redirect_stdout(later := io.StringIO()):
        play(read_log(path), begin, math.inf, 20.0, Axis.ROLL, lambda: False)
    assert later.getvalue().splitlines() == [line for line in lines if "quiet" not in line]
    with contextlib.redirect_stdout(out):
        play(read_log(path), begin, 0.01, 0.0, Axis.ROLL, lambda: True)  # Ctrl-C: no waiting


@given(st.lists(st.sampled_from([*KEYS, "x", "\x1b[A", "é"])), st.data())
def test_keys_are_the_same_however_they_are_cut(codes: list[str], data: st.DataObject) -> None:
    typed, found, begun = "".join(codes), list[Key](), ""
    cuts = sorted(data.draw(st.lists(st.integers(0, len(typed)), max_size=4)))
    for first, stop in zip([0, *cuts], [*cuts, len(typed)], strict=True):
        keys, begun = keys_in(begun + typed[first:stop])
        found += keys
    assert (found, begun) == ([KEYS[code] for code in codes if code in KEYS], "")


def test_a_replay_moves_by_its_keys() -> None:
    place = Position(5.0, 60.0, 2.0)
    place.move(4.0)
    assert place.at_s == 13.0
    for key, at_s in ((Key.BACK, 3.0), (Key.BACK, 0.0), (Key.ON, 10.0), (Key.STOP, 10.0)):
        place.press(key)
        assert place.at_s == at_s
    place.move(9.0)
    assert (place.at_s, place.stopped) == (10.0, True)
    for _ in range(6):
        place.press(Key.ON)
    assert (place.at_s, place.ended) == (60.0, False)
    place.press(Key.END)
    assert place.ended


def test_a_spike_of_one_sample_is_seen() -> None:
    t_s, values = np.arange(10_000) / 1000, np.zeros(10_000)
    values[5000] = 1.0
    view = StripView("", (Curve(t_s, values, ""),), -1.0, 1.0)
    lines = [line.plain for line in strip(view, 0.0, 10.0, 40, 4)]
    assert lines[0].strip() != ""
    assert lines[0][19:21].strip() != ""
    assert (lines[0][:19] + lines[0][21:]).strip() == ""


@example(width=20, texts=[], value=math.nan, reason="")
@given(
    width=st.integers(20, 200),
    texts=st.lists(st.text(max_size=200), max_size=12),
    value=st.floats(allow_nan=True, allow_infinity=True),
    reason=st.text(max_size=120),
)
def test_no_line_is_wider_than_the_terminal(width: int, texts: list[str], value: float, reason: str) -> None:
    t_s = np.linspace(0.0, 10.0, 50)
    view = View(
        title="a" * 90,
        headline="motor 1 " * 20,
        stage=Stage.FAULT,
        from_s=0.0,
        to_s=10.0,
        strips=(StripView("roll rate", (Curve(t_s, np.sin(t_s), "red"),), -1.0, 1.0),),
        levels=(Level("unbalance", value, 1.0, "g mm"), Level("trim", 0.1, 0.2, "", reason)),
        events=tuple(Line(1.0, Severity.CRITICAL, text) for text in texts),
        foot="vehicle 1 " * 30,
    )
    console = Console(width=max(width, 44), file=io.StringIO(), record=True)
    console.print(picture(view, width))
    assert all(cell_len(line) <= max(width, 44) for line in console.export_text().splitlines())


def test_a_flood_of_words_does_not_push_an_alert_out() -> None:
    """Every CRITICAL of the last hundred events stands whole at 80 x 24, and so do older ones."""
    alerts = [f"detector: PROP FAULT motor {n} lost {n}9% thrust, land now and look at its propeller" for n in range(6)]
    flood = [Line(float(n), Severity.INFO, f"words {n}") for n in range(300)]
    events = [*(Line(float(n), Severity.CRITICAL, text) for n, text in enumerate(alerts)), *flood]
    views: list[View] = []

    def view(shown: Sequence[Line]) -> View:
        events = tuple(shown)
        views.append(View("a link", "motor 3 is weak", Stage.FAULT, levels=(LEVEL,) * 13, events=events, foot="foot"))
        return views[-1]

    console = Console(width=80, height=24, file=io.StringIO(), record=True, force_terminal=True)
    with Screen(view, console=console) as screen:
        for at in range(0, len(events), 7):
            screen.show(events[at : at + 7])
    console.print(picture(views[-1], 80, 23))
    text = " ".join(" ".join(line.strip("│ ") for line in console.export_text().splitlines()[-23:]).split())
    assert all(alert in text for alert in alerts)


def test_every_rotor_that_was_named_stands_in_the_table() -> None:
    row: Row = {"log": "a.bin", "verdict": "fault", "rotor": 4, "rotors": "1 from 98.7 s to 2.0 s; 4 from 684.0 s"}
    row = {**row, "since_s": 98.7, "monitor": "rotor_trim", "ratio": 7.0, "judged_s": 9.0, "flown_s": 9.0, "reason": ""}
    console = Console(width=100, file=io.StringIO(), record=True)
    verdict_table([row, {**row, "log": "b.bin", "rotors": None}], console)
    lines = console.export_text().splitlines()
    assert "rotor" in lines[1]
    assert [" ".join(line.split()[:4]) for line in lines[2:4]] == ["a.bin fault 1,4 98.7", "b.bin fault 4 98.7"]
    console = Console(width=80, file=io.StringIO(), record=True)  # a narrow one leaves room for the names
    row |= {"verdict": "not_judgeable", "rotor": None, "since_s": 1098.9, "monitor": "rotor_signature"}
    verdict_table([{**row, "log": f"turning_nose_{number}_healthy.tlog"} for number in range(3)], console)
    lines = console.export_text().splitlines()
    assert len(lines) == 2 + 2 * 3 + 1
    assert all(len(line) <= 80 for line in lines)


def _line(kind: str, number: int, **content: object) -> str:
    return json.dumps({"kind": kind, "utc": "2026-01-01T00:00:00Z", "vehicle": number, "vehicle_s": 1.5, **content})


def test_a_link_keeps_only_the_figures_of_a_detector_and_shows_none_that_are_no_numbers() -> None:
    near, far = memory_pair(clock=lambda: 0)
    station, detector = GroundStation(near, speak=False), Encoder(1, Component.ONBOARD_COMPUTER)
    for name, value in (*((name, math.inf) for name in FIGURES), ("MADE_UP", 1.0), ("PF_MARG", math.nan)):
        far.send(detector.encode(MessageId.NAMED_VALUE_FLOAT, 0, name, value))
    station.listen(0.0)
    assert (set(station.figures), figure_levels(station)) == (set(FIGURES), ())


def test_a_journal_is_followed_over_torn_lines_and_a_rotation(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    text = _line("text", 1, severity=2, text="PROP FAULT motor 1")
    broken = "\nno json\n" + "[" * 100_000 + '\n{"kind": "note", "vehicle": 1e999}\n'
    path.write_text(text[:20])
    journal = Journal(path)
    assert journal.read() == []
    with path.open("a") as file:
        file.write(text[20:] + broken + _line("state", 2, **{"from": "a", "to": "b", "reason": "c"}) + "\n")
    assert journal.read() == [
        (1, Line(1.5, Severity.CRITICAL, "PROP FAULT motor 1")),
        (2, Line(1.5, Severity.INFO, "a -> b: c")),
    ]
    assert (journal.damaged, journal.vehicles[2].state) == (3, "b")
    with path.open("a") as file:
        file.write(_line("note", 1, text="before") + "\n")
    path.rename(tmp_path / "events.1.jsonl")
    assert [line.text for _, line in journal.read()] == ["before"]
    path.write_text(_line("note", 1, text="after") + "\n")
    assert [line.text for _, line in journal.read()] == ["after"]
    with path.open("a") as file:
        file.write(_line("stage", 3, stage="fault", reason="too high", rotor=2, fault_kind=None) + "\n")
    ((_, line),) = journal.read()
    told = (line.text, line.severity, journal.vehicles[3].stage)
    assert told == ("fault: too high, rotor 2", Severity.CRITICAL, "fault")
    for stage in Stage:
        with path.open("a") as file:
            file.write(_line("stage", 3, stage=stage, reason="", rotor=2, fault_kind=None) + "\n")
        journal.read()
        assert watching._journal_view(journal, 3, ()).stage is stage
    journal.close()
    with pytest.raises(InputError, match="no such file"):
        Journal(tmp_path / "none.jsonl")
    path.write_bytes(b"\xfd\x1c\n\x00\xff\n")
    with contextlib.closing(Journal(path)) as other, pytest.raises(InputError, match="no journal of a detector"):
        follow(other, None, lambda: False)


class Terminal(io.StringIO):
    """A terminal that remembers what was written."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr("mavdiag.commands.progress.time.monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize("quiet", [False, True])
def test_a_line_now_and_then_in_a_pipe(clock: list[float], capsys: pytest.CaptureFixture[str], quiet: bool) -> None:
    with shown("judged", [1.0] * 100, quiet=quiet) as progress:
        for second in range(1, 101):
            clock[0] = float(second)
            progress.add(1.0)
    left = {10: "0:01:30", 40: "0:01:00", 70: "0:00:30"}
    lines = [] if quiet else [f"judged: {n} of 100, {words} left" for n, words in left.items()]
    assert capsys.readouterr() == ("", "".join(f"{line}\n" for line in lines))


@pytest.mark.parametrize(("seconds", "words"), [(5.0, "0:00:25"), (500.0, "0:41:40")])
def test_a_bar_is_one_line_makes_room_and_goes_away(
    clock: list[float], monkeypatch: pytest.MonkeyPatch, seconds: float, words: str
) -> None:
    terminal = Terminal()
    for stream in ("stderr", "stdout"):  # here: pytest takes stderr for itself before the test
        monkeypatch.setattr(sys, stream, terminal)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    with shown("judged", [1.0, 1.0, 4.0]) as progress:
        clock[0] = seconds
        progress.add(1.0)
        progress.say("an answer")
    before, after = terminal.getvalue().split("an answer\n")
    assert before.endswith(ERASED)
    assert "━" in before
    assert f"1 of 3, {words} left" in after
    assert after.count("\n") == 1  # before it is erased
    assert after.endswith(ERASED)


def steering(text: str, keep: str = "\n") -> list[str]:
    return [one for one in text if not one.isprintable() and one not in keep]


def test_every_control_character_is_shown_as_its_escape() -> None:
    assert printable(EVIL) == r"\x1b[31mred\x1b]0;title\x07\r\nforged line\x9b2J\u202eleft\u2028end\x00"
    for number in (*range(32), *range(127, 160), 0x200E, 0x202A, 0x2066, 0xFEFF, 0xD800, 0xE0001):
        assert not steering(printable(chr(number)), keep=""), hex(number)
    assert printable("Größe 5 µs, 3 × „Ω“") == "Größe 5 µs, 3 × „Ω“"


def test_what_daemon_commands_and_baselines_say(capsys: pytest.CaptureFixture[str]) -> None:
    command._say(f"vehicle 1: {EVIL}")
    app = commandline.application("Nothing.")

    @app.command()
    def fail() -> None:
        """Fail."""
        raise InputError(f"{EVIL}.tlog: cannot be read")

    @app.command()
    def stopped() -> None:
        """Ctrl-C within compiled code, which loads other."""
        within = SystemError()
        within.__cause__ = KeyboardInterrupt()
        raise SystemError from within

    with pytest.raises(SystemExit, match="130"), patch("sys.argv", [EVIL, "stopped"]):
        commandline.run(app, EVIL)
    with pytest.raises(SystemExit) as caught, patch("sys.argv", [EVIL, "fail"]):
        commandline.run(app, EVIL)
    assert caught.value.code == 2
    sound = baseline_for()
    evil = sound.model_copy(update={"airframe": replace(sound.airframe, name=EVIL)})
    assert len(str(evil).splitlines()) == len(str(sound).splitlines())
    commandline.say(*str(evil).split("\n"), f"written to {EVIL}")
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == f"written to {printable(EVIL)}"  # a name makes no second line
    assert "forged line" in err
    assert not steering(out + err)
