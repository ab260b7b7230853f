"""`mavdiag report` as it is run: logs of each kind, folders, what cannot be read, a campaign's results."""

from pathlib import Path

import pytest
from made_archive import content
from made_baselines import whole
from page_reading import Page, check
from shared_data import shared
from typer.testing import CliRunner

from mavdiag import cli
from mavdiag.errors import MavdiagError
from mavdiag.face import learn

SECTIONS = 11


def run(*arguments: object) -> str:
    """The output of the command. Raises what it raised."""
    result = CliRunner().invoke(cli.app, ["report", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    path = tmp_path / "baseline.json"
    whole().save(path)
    return path


def page_at(path: Path) -> Page:
    return check(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("log", "own"),
    [
        ("data/crazypad/cut_propeller_M3_4mm_4mm_39mm/E8_log00", "data/crazypad/normal_flight/*"),
        ("data/arducopter_sitl/fault_quad3kg_m1_080_sq1.tlog", "data/arducopter_sitl/healthy_quad3kg_sq*.tlog"),
        ("data/ardupilot_real/log171.bin", None),
        ("data/px4_real/pyulog_sample.ulg", None),
    ],
)
def test_logs_of_each_kind_have_a_page(log: str, own: str | None, tmp_path: Path, baseline: Path) -> None:
    path, out = shared(log), tmp_path / "report.html"
    if own is not None:
        learn([str(one) for one in sorted(shared("data").parent.glob(own))]).save(baseline)
    run(path, "--baseline", baseline, "-o", out)
    page = page_at(out)
    figures = [one for tag, name, one in page.attributes if (tag, name) == ("figure", "id")]
    monitors = [one for one in figures if one.startswith("log-1-monitor-")]
    assert len(figures) - len(monitors) == SECTIONS, figures
    assert bool(monitors) == (own is not None)
    drawn = len(page.drawings) - 1  # of the airframe
    assert drawn + page.said.count("Not drawn: ") == len(figures)
    assert drawn >= (6 if own else 1)  # the flight can always be drawn
    assert ("A propeller fault of rotor" in page.said) == (own is not None)
    assert out.stat().st_size < 1_000_000


def test_a_folder_makes_one_page_and_a_bad_file_does_not_lose_the_others(tmp_path: Path, baseline: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "notes.txt").write_text("no log")
    torn = tmp_path / "<b>empty.bin"
    torn.write_bytes(b"")
    (folder / ".hidden").write_text("not looked at")
    out = tmp_path / "report.html"
    sound = tmp_path / "sound.tlog"
    sound.write_bytes(content(1, 400))
    said = run(folder, torn, sound, "--baseline", baseline, "-o", out)
    page = page_at(out)
    assert "2 not readable" in page.said
    assert "<b>empty.bin" in page.said
    assert "no flight logs" in said
    assert said.splitlines()[-1].startswith("written to ")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((), "name logs and --baseline FILE"),
        (("x.tlog", "--baseline", "gone.json"), "gone.json: no such file"),
        (("--campaign", "gone.jsonl"), "gone.jsonl: no such file"),
        (("x.tlog", "--campaign", "c.jsonl"), "neither logs nor --baseline"),
        (("x.tlog", "-o", "no-folder/x.html"), "no folder"),
        (("empty", "--baseline", "baseline.json"), "no log there; name files, a folder, or a pattern"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    arguments: tuple[str, ...], reason: str, tmp_path: Path, baseline: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(baseline.parent)
    (tmp_path / "empty").mkdir()
    with pytest.raises(MavdiagError, match=reason) as caught:
        run(*arguments)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "report.html").exists()
