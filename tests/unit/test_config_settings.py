"""Settings: unknown keys by name, the command line over the file, contradictions in one line."""

import re
from pathlib import Path

import pytest
from made_baselines import FRAME, NOW, healthy

from detector.config import Settings, example_text, load_settings
from detector.journal import kept_baselines
from mavdiag.errors import BaselineError, UsageError
from mavdiag.learning import LearnOptions, learn


def written(folder: Path, text: str) -> Path:
    path = folder / "detector.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lern = 30", "unknown key 'lern'; known are learn, negotiate, "),
        ("learn = -1", "learn: Input should be greater than 0"),
        ("learn = 10\nvehicle = 256", "vehicle: "),
        ("learn = 10\ntwins_hz = 5", "unknown key 'twins_hz'"),
        ("learn = 10\ntexts_per_minute = 1000", "texts_per_minute: "),
        ("learn = 10", "learn needs save: a FILE that keeps what is learned"),
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


def test_the_environment_can_say_all_of_it(tmp_path: Path) -> None:
    environ = {
        "MAVDIAG_DETECTOR_CONFIG": str(written(tmp_path, "learn = 30.0\nsave = 'b.json'\n")),
        "MAVDIAG_DETECTOR_FORWARD": "/dev/ttyUSB1,57600 udpout:127.0.0.1:14551",
        "MAVDIAG_DETECTOR_KEEP_RATES": "true",
        "MAVDIAG_DETECTOR_SUSPECT": "fsd",
        "PATH": "/bin",
    }
    settings = load_settings(None, {}, environ)
    assert settings.forward == ("/dev/ttyUSB1,57600", "udpout:127.0.0.1:14551")
    assert (settings.learn, settings.keep_rates, settings.suspect) == (30.0, True, ("fsd",))


def test_the_example_is_valid_and_shows_every_setting(tmp_path: Path) -> None:
    settings = load_settings(written(tmp_path, example_text()), {})
    assert settings == Settings(learn=120.0, save=Path("/var/lib/mavdiag/learned.json"))
    shown = set(re.findall(r"^(?:# )?(\w+) = ", example_text(), re.MULTILINE))
    assert shown == set(Settings.model_fields) - {"vehicles"}


def test_what_was_learned_is_found_again_by_its_vehicle(tmp_path: Path) -> None:
    made = learn(healthy(1), LearnOptions(airframe=FRAME, monitors=("rotor_trim",)), created=NOW)
    path = tmp_path / "learned.json"
    assert kept_baselines(path) == {}
    for sysid, name in ((3, "learned.json"), (7, "learned-7.json"), (9, "learned-old.json")):
        provenance = made.provenance.model_copy(update={"vehicle": sysid})
        made.model_copy(update={"provenance": provenance}).save(tmp_path / name)
    kept = kept_baselines(path)
    assert {sysid: one.name for sysid, (one, _) in kept.items()} == {3: "learned.json", 7: "learned-7.json"}
    path.write_text("{}")
    with pytest.raises(BaselineError, match=r"learned\.json"):
        kept_baselines(path)
