"""What `import mavdiag as md` gives: cheap to import, and short ways that end at the same functions."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from identification_data import WELL, record
from made_telemetry import flight

import mavdiag as md
from mavdiag import face
from mavdiag.chain import ChainOutput
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import InputError, UsageError
from mavdiag.learning import LearnOptions
from mavdiag.telemetry import Axis

HEAVY = {"numpy", "scipy", "pydantic", "pymavlink", "control", "matplotlib", "pandas", "rich", "typer", "numba"}


def test_the_import_loads_nothing_heavy_and_every_name_is_there() -> None:
    program = "import sys, mavdiag; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert not HEAVY & set(loaded.split())
    assert set(md.__all__) <= set(dir(md))
    for name in md.__all__:
        assert getattr(md, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        md.absent  # noqa: B018


def test_the_package_of_identification_can_be_called() -> None:
    train = record(WELL, 600, 0.1, 0)
    called = md.identify(train.u, train.y, order=(2, 2, 1), dt=0.01)  # type: ignore[operator]  # typed code calls fit
    assert np.array_equal(called.a, md.identify.fit(train.u, train.y, (2, 2, 1), dt=0.01).a)
    from mavdiag.identify import fit

    assert fit is md.identify.fit


def test_rates_of_a_log_carry_the_model_that_made_them() -> None:
    log = md.Log("made", "", "qdrone2", flight(20_000, 3))
    u, y, dt = md.rates(log, "roll", window_s=0.05)
    assert dt == pytest.approx(0.001)
    assert sum(map(len, u)) == sum(map(len, y)) > 10_000
    model = md.identify.fit(u, y, dt=dt)
    assert model.r2t > 0.97
    assert model.dc_gain == pytest.approx(1.0, abs=0.05)
    with pytest.raises(UsageError, match="sideways"):
        md.rates(log, "sideways")


def test_rates_of_a_flight_that_is_too_short_are_refused() -> None:
    with pytest.raises(InputError, match="made: no unbroken flight of 2 s"):
        md.rates(md.Log("made", "", "qdrone2", flight(1500, 3)), Axis.ROLL)


def test_sources_may_be_logs_files_folders_and_patterns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def made(path: str | Path, *, vehicle: int | None = None) -> md.Log:
        return md.Log(Path(path).name, str(vehicle), "qdrone2", md.Log("", "", "", flight(10, 0)).telemetry)

    monkeypatch.setattr(face, "read_log", made)
    for name in ("b.tlog", "a.tlog", "c.bin"):
        (tmp_path / name).touch()
    (tmp_path / "folder.tlog").mkdir()

    def names(source: face.Source) -> list[str]:
        return [log.name for log in face._logs(source, 7)]

    assert names(tmp_path / "*.tlog") == [str(tmp_path / "a.tlog"), str(tmp_path / "b.tlog")]
    assert len(names(str(tmp_path))) == 3
    assert names(tmp_path / "c.bin") == [str(tmp_path / "c.bin")]
    assert names(md.Log("given", "", "", flight(10, 0))) == ["given"]
    monkeypatch.chdir(tmp_path)
    assert names("*.bin") == ["c.bin"]
    with pytest.raises(InputError, match="no log there"):
        names("*.ulg")


def test_an_airframe_may_be_a_value_a_name_or_a_file_and_gets_a_label() -> None:
    options = LearnOptions()
    assert face.with_airframe(options, None, None) is options
    named = face.with_airframe(options, "qdrone2", "drone 7").airframe
    assert (named.name, named.layout is not None) == ("drone 7", True)
    value = md.Airframe(name="mine", mass_kg=2.0)
    assert face.with_airframe(options, value, None).airframe is value
    with pytest.raises(UsageError, match="qdrone2"):
        face.with_airframe(options, "absent", None)


def test_what_a_step_of_a_watch_brings_is_in_order_of_time() -> None:
    late = Event("fsd", None, 5, None, 1.0, 0.5, 0.1)
    closed = Event("fsd", None, 1, 7, 1.0, 0.5, 0.1)
    change = Change(Stage.QUIET, 6, "judged")
    assert face._in_order(ChainOutput(events=(closed, late), changes=(change,))) == (late, change, closed)
