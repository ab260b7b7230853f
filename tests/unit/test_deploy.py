"""The files that a service or a container is made from, as far as they can be checked without installing them."""

import json
import re
from configparser import RawConfigParser
from pathlib import Path

import pytest

from detector.config import ENVIRONMENT, Settings

ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "deploy" / "mavdiag-detector.service"
CONTAINER = ROOT / "deploy" / "Containerfile"
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


def instructions() -> list[tuple[str, str]]:
    """Instructions of the container file in order, with what follows each."""
    text = re.sub(r"^#.*\n", "", CONTAINER.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
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
    assert "--only-binary=:all:" in dict(made[: len(made) - len(last)])["RUN"]
    for name, value in made:
        if name == "COPY" and not value.startswith("--from"):
            *sources, _ = value.split()
            assert all((ROOT / source).exists() for source in sources), value


@pytest.mark.parametrize("path", [UNIT, CONTAINER])
def test_the_variables_named_there_are_settings(path: Path) -> None:
    named = {name.lower() for name in set_there(path.read_text())}
    assert named
    assert named <= {*Settings.model_fields, "config"}
