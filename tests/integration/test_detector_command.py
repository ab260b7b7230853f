"""The detector as a user and a service manager meet it: options, settings, deployment, signals, dead links."""

import ctypes
import json
import mmap
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from made_baselines import FRAME, NOW, healthy
from made_session import baseline_for
from made_vehicle import MadeVehicle
from processes import PATIENCE_S, ended, port_of, ran, running, until
from shared_data import written

from detector.config import ENVIRONMENT, Settings, example_text, load_settings
from detector.journal import check_files, kept_baselines
from detector.web.server import SERVICE
from mavdiag import __version__
from mavdiag.errors import BaselineError, UsageError
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.ports import open_endpoint

LEARN, UDP = ("--learn", "10", "--save", "b.json"), ("--connect", "udpin:127.0.0.1:0")
LEARNING = ("--learn", "50", "--save", "b.json", *UDP)
ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "deploy" / "mavdiag-detector.service"
CONTAINER = ROOT / "deploy" / "Containerfile"
BLUEOS = ROOT / "deploy" / "blueos" / "Containerfile"
PROGRAM = "/opt/mavdiag/bin/mavdiag-detector"


def test_help_names_every_option_of_the_contract(program: Any) -> None:
    _, text, _ = program("detector.__main__", "--help")
    own = "connect baseline learn save airframe layout frame name forward journal record metrics web vehicle profile"
    more = "config keep-rates check print-config working signing-key reset-stamp web-token-file version"
    assert set(re.findall(r"--[a-z-]+(?=[ ,\n])", text)) >= {f"--{option}" for option in f"{own} {more}".split()}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_stops_it_cleanly_with_a_summary_and_a_last_line(number: int, tmp_path: Path) -> None:
    """Though its parent has its children ignore SIGHUP, as `nohup` does."""
    journal = tmp_path / "j.jsonl"
    with running(*LEARN, *UDP, "--journal", str(journal), before=lambda: signal.signal(number, signal.SIG_DFL)) as (
        child,
        first,
    ):
        assert port_of(first) > 0
        code, rest = ended(child, number)
    assert (code, len(rest.splitlines())) == (0, 1)
    assert "stopped after" in rest
    assert [json.loads(line)["kind"] for line in journal.read_text().splitlines()] == ["start", "stop"]


@pytest.mark.realtime
def test_over_udp_it_learns_from_the_plant_and_finds_its_fault(tmp_path: Path) -> None:
    """The plant as a process, real time, 1 kHz: 12 s of learning, then a strong fault; it flies until that is told."""
    saved, journal = tmp_path / "learned.json", tmp_path / "j.jsonl"

    def told() -> list[dict[str, Any]]:
        return [json.loads(line) for line in journal.read_text().splitlines() if line.endswith("}")]

    with running("--learn", "12", "--save", str(saved), *UDP, "--journal", str(journal)) as (child, first):
        flight = ("--out", f"udpout:127.0.0.1:{port_of(first)}", "--fault", "F2/SV3", "--onset", "24", "--seed", "3")
        with subprocess.Popen([sys.executable, "-m", "sitl_plant", "run", *flight, "--duration", "600"]) as plant:
            give_up = time.monotonic() + 5 * PATIENCE_S
            while not any(line["kind"] == "text" and line["severity"] == 2 for line in told()):
                assert plant.poll() is None
                assert time.monotonic() < give_up, "nothing was alerted"
                time.sleep(0.2)
            plant.terminate()
        code, rest = ended(child, signal.SIGTERM)
    assert (plant.returncode, code) == (0, 0)
    assert saved.exists()
    assert "0 datagrams overflowed here" in rest
    assert " 0 lost on the way" in rest
    assert [line for line in told() if line["kind"] == "event" and line["t_s"] > 24.0]


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    path = tmp_path / "b.json"
    baseline_for().save(path)
    return path


def test_check_tells_what_a_start_would_do_and_opens_nothing(program: Any, baseline: Path, tmp_path: Path) -> None:
    (config := tmp_path / "detector.toml").write_text(
        f'baseline = "{baseline}"\njournal = "{tmp_path}/j.jsonl"\nforward = ["/dev/absent,57600"]\nmetrics = "9100"\n'
        f'threshold_scale = 2.0\n[vehicles.200]\nbaseline = "{baseline}"\n'
    )
    before = sorted(tmp_path.iterdir())
    with open_endpoint("udpin:127.0.0.1:0") as taken:
        code, out, err = program("detector.__main__", "--config", config, "--connect", taken.address, "--check")
    assert code == 0, err
    assert [line.split()[0] for line in out.splitlines()] == [
        *("link", "watches", "judges", "vehicle", "thresholds", "forwards", "journal", "metrics")
    ]
    assert f"vehicle 200 by {baseline}: made, qdrone2 at 100 Hz, 1 monitors" in out
    assert "not now (/dev/absent,57600: no such device" in out
    assert sorted(tmp_path.iterdir()) == before
    assert "not kept: every start learns anew" in program("detector.__main__", "--check", "--learn", "10")[1]
    assert "name it with --signing-key" in program("detector.__main__", "--reset-stamp", "--learn", "10")[2]


@pytest.mark.realtime
def test_health_tells_a_daemon_that_works_from_one_that_hangs_or_is_gone() -> None:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        metrics = ("--metrics", str(one.getsockname()[1]))
    with running(*LEARNING, *metrics) as (child, _):
        give_up = time.monotonic() + PATIENCE_S
        while (run := ran("--working", *metrics)).returncode and time.monotonic() < give_up:
            pass
        assert (run.returncode, run.stdout) == (0, "working\n")
        child.send_signal(signal.SIGSTOP)
        run = ran("--working", *metrics)
        child.send_signal(signal.SIGCONT)
        assert run.returncode == 1
        assert "does not answer (timed out)" in run.stdout
    run = ran("--working", *metrics)
    assert run.returncode == 1
    assert "Connection refused" in run.stdout


def test_what_it_keeps_in_memory_moves_into_huge_pages() -> None:
    switch, some = Path("/sys/kernel/mm/transparent_hugepage/enabled"), mmap.mmap(-1, 8 << 20, mmap.MAP_PRIVATE)
    some.write(bytes(8 << 20))
    place = ctypes.c_void_p(ctypes.addressof(ctypes.c_char.from_buffer(some)))
    if not switch.is_file() or "[never]" in switch.read_text() or ctypes.CDLL(None).madvise(place, 8 << 20, 25):
        pytest.skip("the system moves no memory into huge pages")
    with running(*LEARNING) as (child, _):
        pages, give_up = Path(f"/proc/{child.pid}/smaps"), time.monotonic() + PATIENCE_S
        while not (huge := re.search(r"AnonHugePages: +[1-9]", pages.read_text())) and time.monotonic() < give_up:
            time.sleep(0.05)
        ended(child, signal.SIGTERM)
    assert huge


@pytest.mark.realtime
def test_a_full_disk_stops_the_files_and_nothing_else(baseline: Path, tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk: the system refuses to write beyond it."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    vehicle, journal = MadeVehicle(1), tmp_path / "j.jsonl"
    options = ("--baseline", str(baseline), *UDP, "--journal", str(journal), "--record", str(tmp_path / "f.tlog"))
    with running(*options, before=limit) as (child, first):
        with open_endpoint(f"udpout:127.0.0.1:{port_of(first)}") as far:
            until(far, vehicle, "monitoring")
            until(far, vehicle, "FAULT", 3.0)
            vehicle.turning = 0.5
            assert any("FAULT" in text for text in until(far, vehicle, "FAULT"))
        code, rest = ended(child, signal.SIGTERM)
    (told,) = (line for line in rest.splitlines() if f"record {tmp_path}/f.tlog: " in line)
    assert (code, "cannot be written (not all of it fitted); watching goes on without it" in told) == (0, True)
    assert "entries lost to the record" in rest.splitlines()[-1]
    assert " 0 lost on the way" in rest
    assert (tmp_path / "f.tlog").stat().st_size <= 20_000


@pytest.mark.realtime
def test_a_dead_link_behind_does_not_hold_up_the_vehicles(baseline: Path) -> None:
    """One server accepts and never reads, nobody listens on the other, and the device is not there."""
    vehicle = MadeVehicle(1)
    with socket.socket() as deaf, socket.socket() as closed:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for one in (deaf, closed):  # a port that is bound cannot become that of another test
            one.bind(("127.0.0.1", 0))
        deaf.listen(1)
        behind = (*(f"tcp:127.0.0.1:{one.getsockname()[1]}" for one in (deaf, closed)), "/dev/absent,57600")
        options = [part for address in behind for part in ("--forward", address)]
        with running("--baseline", str(baseline), *UDP, *options) as (child, first):
            with open_endpoint(f"udpout:127.0.0.1:{port_of(first)}") as far:
                until(far, vehicle, "monitoring")
                frames = vehicle.samples(20_000)  # 1.5 MB: more than the system keeps for the deaf one
                for start in range(0, len(frames), 50):
                    for frame in frames[start : start + 50]:
                        far.send(frame)
                    time.sleep(0.002)
                vehicle.turning = 0.5
                assert any("FAULT" in text for text in until(far, vehicle, "FAULT"))
            code, rest = ended(child, signal.SIGTERM)
    assert (code, rest.count("the connection is refused: nobody listens there")) == (0, 1)
    assert " 0 lost on the way" in rest
    assert "0 datagrams overflowed here" in rest


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lern = 30", "unknown key 'lern'; known are learn, negotiate, "),
        *((f"learn = {n}", f"Input should be {it} than") for n, it in ((-1, "greater"), (3601, "less"))),
        ("learn = true", "learn: is a value, not true or false"),
        ("baseline = ''", "baseline: is empty; name one, or leave it out"),
        ("learn = 9\nmetrics = '9100'\nweb = 'localhost:9100'", "--web localhost:9100 listen on one port"),
        ("learn = 9\nforward = ['udpin:0.0.0.0:14550']", "udpin:0.0.0.0:14550 listen on one port"),
        ("learn = 9\nconnect = 'udpin:0.0.0.0:9'\nforward = 'udpout:127.0.0.2:9'", "127.0.0.2:9 lead to each other"),
        ("vehicle = 5\n[vehicles.3]\nbaseline = 'b.json'", "vehicle 5 has no baseline here"),
        ("learn = 9\nsuspect = ['fsd.pitch', 'nope']", "suspect: no monitor nope; there are fsd"),
        ("learn = 9\nsuspect = ['fsd.nose']", "suspect: no axis 'nose'; there are roll, pitch, yaw"),
        ("learn = 10\nask_hz = 30.0", "ask_hz 30 is below min_rate_hz 45"),
        ("learn = [", "not TOML"),
        ("learn = 10\nbaseline = 'b.json'", "either --baseline FILE or --learn SECONDS, not both"),
        ("baseline = 'b.json'\nsave = 's.json'", "--save is about what --learn SECONDS learns"),
        *((f"learn = 1\n{it} = 'here'", "address 'here'") for it in ("forward", "metrics")),
        ("baseline = 'b.json'\nhook = ['exec:no-such-program-at-all']", "there is no program 'no-such-program-at-all'"),
        ("baseline = 'b.json'\nhook = ['exec:\"echo']", "No closing quotation"),
        *((f"learn = 1\nhook = '{hook}'", "write exec:P") for hook in ("ftp://h/x", "mqtt://h", "mqtt://h/a/+/b")),
        ("baseline = 'b.json'\nhook = ['http://127.0.0.1:99999/x']", "Port out of range"),
        ("baseline = 'b.json'\nhook = ['http://me:secret@127.0.0.1/x']", "no room for a user or password"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_settings(written(tmp_path / "detector.toml", text), {})
    assert words in str(caught.value)
    assert not {"\n", "secret"} & {*str(caught.value), *re.findall("secret", str(caught.value))}


def test_the_environment_can_say_all_of_it(tmp_path: Path) -> None:
    environ = {
        "MAVDIAG_DETECTOR_CONFIG": str(written(tmp_path / "detector.toml", "learn = 30\nsave = 'b.json'\nweb = 80\n")),
        "MAVDIAG_DETECTOR_FORWARD": "/dev/ttyUSB1,57600 udpout:127.0.0.2:14550",
        "MAVDIAG_DETECTOR_KEEP_RATES": "true",
        "MAVDIAG_DETECTOR_SUSPECT": "fsd",
        "PATH": "/bin",
    }
    settings = load_settings(None, {}, environ)
    assert settings.forward == ("/dev/ttyUSB1,57600", "udpout:127.0.0.2:14550")
    assert (settings.learn, settings.keep_rates, settings.suspect, settings.web) == (30.0, True, ("fsd",), "80")


def test_the_example_is_valid_and_shows_every_setting(tmp_path: Path) -> None:
    settings = load_settings(written(tmp_path / "detector.toml", example_text()), {})
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
    assert set(kept_baselines(path)) == {3, 7}  # of learned.json and learned-7.json
    (link := tmp_path / "link.json").symlink_to(path)
    check_files(Settings(learn=9.0, save=link))  # it is used, and not written
    path.write_text("{}")
    with pytest.raises(BaselineError, match=r"learned\.json"):
        kept_baselines(path)


def instructions(path: Path = CONTAINER) -> list[tuple[str, str]]:
    """Instructions of a container file in order, with what follows each."""
    text = re.sub(r"^#.*\n", "", path.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1]) for line in text.splitlines() if line.strip()]


def test_the_unit_is_supervised_and_has_no_rights_to_spare() -> None:
    section = UNIT.read_text().partition("[Service]")[2].partition("[Install]")[0]
    service = dict(re.findall(r"^(\w+)=(.*)$", section, re.MULTILINE))
    assert service["Type"] == "notify"
    assert float(service["WatchdogSec"]) >= 5  # the loop gives a sign of life once a second
    assert (service["ExecStart"], service["ExecStartPre"]) == (PROGRAM, f"{PROGRAM} --check")
    for name in ("DynamicUser", "NoNewPrivileges", "ProtectHome", "RestrictNamespaces", "RestrictSUIDSGID"):
        assert service[name] == "yes", name
    assert (service["ProtectSystem"], service["CapabilityBoundingSet"]) == ("strict", "")
    assert set(service["RestrictAddressFamilies"].split()) == {"AF_INET", "AF_INET6", "AF_UNIX"}


def test_the_container_runs_as_nobody_and_can_be_read_only() -> None:
    made = instructions()
    last = made[max(at for at, (name, _) in enumerate(made) if name == "FROM") :]
    by_name = dict(last)
    assert int(by_name["USER"].split(":")[0]) > 0
    assert json.loads(by_name["ENTRYPOINT"]) == [PROGRAM]
    assert json.loads(by_name["HEALTHCHECK"].partition("CMD ")[2]) == [PROGRAM, "--working"]
    assert [value for name, value in last if name == "VOLUME"] == ["/data"]
    assert {"--only-binary=:all:", "/tmp/constraints.txt"} <= set(dict(made[: -len(last)])["RUN"].split())
    copied = [value for name, value in made if name == "COPY" and not value.startswith("--from")]
    assert copied == ["dist/*.whl constraints.txt /tmp/"]  # what `make dist` makes, with the versions that are tried


def test_the_extension_of_blueos_has_the_labels_that_its_store_reads() -> None:
    made = instructions(BLUEOS)
    labels = (value.split("=", 1) for name, value in made if name == "LABEL")
    told = {name: text.strip("'\"") for name, text in labels}
    parsed = {name: json.loads(told[name]) for name in ("permissions", "authors", "company", "links", "tags")}
    assert told["version"] == __version__
    assert all({"name", "email"} == set(author) for author in parsed["authors"])
    assert set(parsed["company"]) == {"name", "about", "email"}
    host = parsed["permissions"]["HostConfig"]
    assert (host["CapDrop"], host["ReadonlyRootfs"]) == (["ALL"], True)
    assert json.loads(BLUEOS.with_name("metadata.json").read_text())["name"] == SERVICE["name"]
    environ = dict(re.findall(r"(\w+)=(\"[^\"]*\"|\S+)", dict(made)["ENV"]))
    settings = load_settings(None, {}, {name: value.strip('"') for name, value in environ.items()})
    assert (settings.web or "").startswith("0.0.0.0:")  # BlueOS finds no other server
    assert "blueos.local" in settings.web_names


@pytest.mark.parametrize("path", [UNIT, CONTAINER, BLUEOS])
def test_the_variables_named_there_are_settings(path: Path) -> None:
    named = {name.lower() for name in re.findall(rf"{ENVIRONMENT}(\w+)", path.read_text())}
    assert set() < named <= {*Settings.model_fields, "config"}
