"""Settings: unknown keys by name, the command line over the file, contradictions in one line."""

from pathlib import Path

import pytest

from detector.config import Settings, load_settings
from mavdiag.errors import UsageError


def written(folder: Path, text: str) -> Path:
    path = folder / "detector.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_command_line_wins_over_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, 'learn = 30.0\nvehicle = 3\nforward = ["udpout:127.0.0.1:14551"]\n')
    settings = load_settings(path, {"vehicle": 7, "connect": None})
    assert (settings.learn, settings.vehicle) == (30.0, 7)
    assert settings.forward == ("udpout:127.0.0.1:14551",)
    assert settings.connect == "udpin:127.0.0.1:14550"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lern = 30", "unknown key 'lern'; known are learn, negotiate, "),
        ("learn = -1", "learn: Input should be greater than 0"),
        ("learn = 10\nvehicle = 256", "vehicle: "),
        ("learn = 10\nnamed_values_axis = 'sideways'", "named_values_axis: "),
        ("learn = 10\ntwins_hz = 5", "unknown key 'twins_hz'"),
        ("learn = 10\ntexts_per_minute = 1000", "texts_per_minute: "),
        ("learn = [", "not TOML"),
        ("learn = 10\nbaseline = 'b.json'", "either --baseline FILE or --learn SECONDS, not both"),
        ("", "name a --baseline FILE, or --learn SECONDS"),
        ("baseline = 'b.json'\nsave = 's.json'", "--save is about what --learn SECONDS learns"),
        ("baseline = 'b.json'\nairframe = 'qdrone2'", "--airframe is about what --learn SECONDS learns"),
        ("learn = 10\nconnect = 'udp:1'", "malformed address 'udp:1'"),
        ("learn = 10\nforward = ['nowhere']", "malformed address 'nowhere'"),
        ("learn = 10\nprofile = 'dji'", "no link profile dji"),
        ("learn = 10\nmetrics = 'here'", "malformed metrics address 'here'"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_settings(written(tmp_path, text), {})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"absent\.toml: no such file"):
        load_settings(tmp_path / "absent.toml", {})


def test_settings_do_not_change() -> None:
    settings = Settings(learn=10.0)
    with pytest.raises(ValueError, match="frozen"):
        settings.learn = 20.0
