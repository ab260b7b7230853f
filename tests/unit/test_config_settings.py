"""Settings of the detector, and the files of its deployment."""

import json
import re
from configparser import RawConfigParser
from pathlib import Path

import pytest
from made_baselines import FRAME, NOW, healthy

from detector.config import ENVIRONMENT, Settings, example_text, load_settings
from detector.journal import kept_baselines
from detector.web.server import SERVICE
from mavdiag import __version__
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


ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "deploy" / "mavdiag-detector.service"
CONTAINER = ROOT / "deploy" / "Containerfile"
BLUEOS = ROOT / "deploy" / "blueos" / "Containerfile"
PROGRAM = "/opt/mavdiag/bin/mavdiag-detector"


def unit() -> dict[str, list[str]]:
    """The settings of the section [Service], each with all its values."""
    found: dict[str, list[str]] = {}
    text = UNIT.read_text()
    parser = RawConfigParser(strict=False)
    parser.read_string(text)
    assert parser.sections() == ["Unit", "Service", "Install"]
    for line in text[text.index("[Service]") : text.index("[Install]")].splitlines():
        name, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(name, []).append(value)
    return found


def instructions(path: Path = CONTAINER) -> list[tuple[str, str]]:
    """Instructions of a container file in order, with what follows each."""
    text = re.sub(r"^#.*\n", "", path.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1]) for line in text.splitlines() if line.strip()]


def set_there(text: str) -> set[str]:
    return set(re.findall(rf"{ENVIRONMENT}(\w+)", text))


def test_the_unit_is_supervised_and_has_no_rights_to_spare() -> None:
    service = unit()
    assert service["Type"] == ["notify"]
    assert float(service["WatchdogSec"][0]) >= 5  # the loop gives a sign of life once a second
    assert service["ExecStart"] == [PROGRAM]
    assert service["ExecStartPre"] == [f"{PROGRAM} --check"]
    for name in ("DynamicUser", "NoNewPrivileges", "ProtectHome", "RestrictNamespaces", "RestrictSUIDSGID"):
        assert service[name] == ["yes"], name
    assert service["ProtectSystem"] == ["strict"]
    assert service["CapabilityBoundingSet"] == [""]
    assert set(service["RestrictAddressFamilies"][0].split()) == {"AF_INET", "AF_INET6", "AF_UNIX"}


def test_the_container_runs_as_nobody_and_can_be_read_only() -> None:
    made = instructions()
    names = [name for name, _ in made]
    last = made[len(names) - names[::-1].index("FROM") - 1 :]
    by_name = dict(last)
    uid = by_name["USER"].split(":")[0]
    assert uid.isdecimal()
    assert int(uid) > 0
    assert json.loads(by_name["ENTRYPOINT"]) == [PROGRAM]
    health = by_name["HEALTHCHECK"].partition("CMD ")[2]
    assert json.loads(health) == [PROGRAM, "--working"]
    assert [value for name, value in last if name == "VOLUME"] == ["/data"]
    assert {"--only-binary=:all:", "/tmp/constraints.txt"} <= set(dict(made[: -len(last)])["RUN"].split())
    copied = [value for name, value in made if name == "COPY" and not value.startswith("--from")]
    assert copied == ["dist/*.whl constraints.txt /tmp/"]  # what `make dist` makes, with the versions that are tried


def test_the_extension_of_blueos_has_the_labels_that_its_store_reads() -> None:
    made = instructions(BLUEOS)
    labels = dict(value.split("=", 1) for name, value in made if name == "LABEL")
    told = {name: text.strip("'\"") for name, text in labels.items()}
    parsed = {name: json.loads(told[name]) for name in ("permissions", "authors", "company", "links", "tags")}
    assert told["version"] == __version__
    assert all({"name", "email"} == set(author) for author in parsed["authors"])
    assert set(parsed["company"]) == {"name", "about", "email"}
    host = parsed["permissions"]["HostConfig"]
    assert (host["CapDrop"], host["ReadonlyRootfs"]) == (["ALL"], True)
    metadata = json.loads(BLUEOS.with_name("metadata.json").read_text())
    assert metadata["name"] == SERVICE["name"]
    environ = dict(re.findall(r"(\w+)=(\"[^\"]*\"|\S+)", dict(made)["ENV"]))
    settings = load_settings(None, {}, {name: value.strip('"') for name, value in environ.items()})
    assert (settings.web or "").startswith("0.0.0.0:")  # BlueOS finds no other server
    assert "blueos.local" in settings.web_names


@pytest.mark.parametrize("path", [UNIT, CONTAINER, BLUEOS])
def test_the_variables_named_there_are_settings(path: Path) -> None:
    named = {name.lower() for name in set_there(path.read_text())}
    assert named
    assert named <= {*Settings.model_fields, "config"}
