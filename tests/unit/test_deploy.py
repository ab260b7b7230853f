"""The files that a service or a container is made from, as far as they can be checked without installing them."""

import json
import re
from configparser import RawConfigParser
from pathlib import Path

import pytest

from detector.config import ENVIRONMENT, Settings, load_settings
from detector.web.server import SERVICE
from mavdiag import __version__

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
    assert re.fullmatch(r"\d+\.\d+\.\d+", told["version"])
    assert told["version"] == __version__
    assert told["type"] in ("device-integration", "example", "theme", "other", "tool")
    assert all({"name", "email"} == set(author) for author in parsed["authors"])
    assert set(parsed["company"]) == {"name", "about", "email"}
    assert len(parsed["tags"]) <= 10
    assert all(re.fullmatch(r"[a-z0-9-]+", tag) for tag in parsed["tags"])
    host = parsed["permissions"]["HostConfig"]
    assert host["CapDrop"] == ["ALL"]
    assert host["ReadonlyRootfs"] is True
    assert host["Binds"] == ["mavdiag:/data"]
    metadata = json.loads(BLUEOS.with_name("metadata.json").read_text())
    assert set(metadata) == {"name", "website", "docker", "description"}
    assert metadata["name"] == SERVICE["name"]
    environ = dict(re.findall(r"(\w+)=(\"[^\"]*\"|\S+)", dict(made)["ENV"]))
    settings = load_settings(None, {}, {name: value.strip('"') for name, value in environ.items()})
    assert settings.web is not None
    assert settings.web.startswith("0.0.0.0:")  # BlueOS finds no other server
    assert "blueos.local" in settings.web_names


@pytest.mark.parametrize("path", [UNIT, CONTAINER, BLUEOS])
def test_the_variables_named_there_are_settings(path: Path) -> None:
    named = {name.lower() for name in set_there(path.read_text())}
    assert named
    assert named <= {*Settings.model_fields, "config"}
