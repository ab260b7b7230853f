"""`mavdiag history` as a user meets it: on recordings of the emulator, and on a history of many flights."""

import errno
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from made_history import DAY_NS, START_NS, records
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle, received
from processes import record
from typer.testing import CliRunner
from web_page import wait_for

from detector.config import Settings
from detector.flights import Flights
from detector.hooks import Courier
from detector.journal import baselines_in
from mavdiag.archive.scan import Answer, Options, Question, Record, judge_file
from mavdiag.baseline import Baseline
from mavdiag.cli import app
from mavdiag.history.store import open_history
from mavdiag.history.warn import Mark, MarkKind
from mavdiag.judging import LogVerdict, Verdict
from mavdiag.link.messages import Autopilot, MavCmd, MessageId
from mavdiag.printable import printable

UDP_IN = "udpin:127.0.0.1:0"
UID, OTHER = "0011223344556677", "0011223344556688"


@pytest.fixture
def wearing(tmp_path: Path) -> Path:
    path, rng = tmp_path / "fleet.sqlite", np.random.default_rng(1)
    worn = 0.4 + 0.6 * np.arange(1, 141) / 150 + 0.03 * rng.standard_normal(140)
    calm = 0.4 + 0.03 * rng.standard_normal(60)
    with open_history(str(path), create=True) as history:
        for one in (*records(worn.tolist(), airframe="worn"), *records(calm.tolist(), airframe="calm")):
            history.add(one)
    return path


def test_flights_are_judged_kept_once_and_listed(mavdiag: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "logs.tlog", "--flights", "4", "--duration", "16", "--seed", "70")
    logs = sorted(tmp_path.glob("*.tlog"))
    assert mavdiag("identify", *logs[:3], "-o", "b.json", "--airframe", "qdrone2", "--name", "drone 1")[0] == 0
    (tmp_path / "damaged.tlog").write_bytes(b"")
    logs[2] = logs[2].rename(tmp_path / os.fsdecode(b"no\xffutf-8.tlog"))
    named = printable(str(logs[2]))
    code, out, _ = mavdiag("history", "add", *logs[2:], "damaged.tlog", "--baseline", "b.json", "--jobs", 1)
    said = out.splitlines()
    assert (code, len(said)) == (2, 3)
    assert [": added, healthy, " in line for line in said] == [True, True, False]
    assert said[2].startswith("damaged.tlog: error, ")
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "b.json", "--airframe", "drone 2")
    told = f"{named}: is there already, of drone 1, by another baseline or name; --again judges it anew\n"
    assert (code, out) == (0, told)
    other = Baseline.load("b.json")
    other.model_copy(update={"link": other.link.model_copy(update={"profile": "px4"})}).save("px4.json")
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "px4.json", "--again")
    assert (code, out.startswith(f"{named}: not kept: ")) == (2, True)
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "b.json", "--vehicle", 1)
    assert (code, out) == (0, f"{named}: is there already, of drone 1\n")  # its only vehicle, named or not
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "b.json", "--again")
    assert (code, f"{named}: judged again, healthy" in out) == (0, True)
    code, out, _ = mavdiag("history", "list", "--json")
    flights = [json.loads(line) for line in out.splitlines()]
    assert (code, [one["flight"] for one in flights]) == (0, [1, 2])
    assert ({one["airframe"] for one in flights}, len(flights[0]["rotor_trim"])) == ({"drone 1"}, 4)
    names = [one["monitor"] for one in flights[0]["monitors"]]
    assert names[:2] == ["fsd", "fsd"]
    assert {"innovation", "unbalance", "rotor_trim"} <= set(names)
    assert all(one["median"] <= one["peak"] for one in flights[0]["monitors"])
    assert mavdiag("history")[0] == 0


def test_a_wearing_airframe_is_warned_of_until_its_propellers_are_new(mavdiag: Any, wearing: Path) -> None:
    code, out, err = mavdiag("history", "--database", wearing)
    assert (code, err) == (1, "")
    (warning,) = (line for line in out.splitlines() if "soon" in line)
    assert warning.startswith("  unbalance: reaches the threshold soon")
    assert [line.split(":")[0] for line in out.splitlines() if not line.startswith(" ")] == ["calm", "worn"]
    assert mavdiag("history", "show", "--database", wearing, "--airframe", "calm")[0] == 0
    code, out, _ = mavdiag("history", "show", "--database", wearing, "--airframe", "worn", "--json")
    found = json.loads(out)
    assert (code, found["warned"]) == (1, ["unbalance"])
    (trend,) = (one for one in found["trends"] if one["monitor"] == "unbalance")
    assert trend["outlook"] == "warning"
    assert trend["remaining_low"] <= trend["remaining"] <= trend["remaining_high"]
    at = np.datetime64(START_NS + 200 * DAY_NS, "ns")
    told = ("--airframe", "worn", "--database", wearing, "--new-propellers", "--at", str(at)[:19])
    assert mavdiag("history", "mark", *told) == (0, "worn: new propellers, 2026-07-20\n", "")
    code, out, _ = mavdiag("history", "--database", wearing)
    assert code == 0
    assert "new propellers after the last flight: no trend yet" in out


def test_logs_without_a_clock_follow_each_other_as_named_or_by_the_time_of_their_files(
    mavdiag: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    baseline_for().save(tmp_path / "b.json")
    logs = [tmp_path / f"{name}.bin" for name in "abc"]
    flights = [replace(one, started_ns=0) for one in records([0.2, 0.3, 0.4])]
    flights[2] = replace(flights[2], started_ns=START_NS + DAY_NS)  # this log has a clock
    for log, days in zip(logs, (30, 10, 20), strict=True):
        log.touch()
        os.utime(log, ns=(0, START_NS + days * DAY_NS))

    @contextmanager
    def answered(*_: Any, **__: Any) -> Iterator[Any]:
        verdict = LogVerdict("", Verdict.HEALTHY, "no alarm")
        answers = (
            Answer(log, Record(one.content, verdict, flight=one)) for log, one in zip(logs, flights, strict=True)
        )
        yield answers, lambda _: None

    monkeypatch.setattr("mavdiag.commands.history.judging", answered)
    order = {}
    for how in ("named", "file-time"):
        told = ("--baseline", tmp_path / "b.json", "--database", tmp_path / how, "--ordered", how)
        assert mavdiag("history", "add", *logs, "--airframe", "one", *told)[0] == 0
        with open_history(str(tmp_path / how)) as history:
            kept = history.flights("one")
        order[how] = [(Path(one.log).stem, (one.started_ns - START_NS) // DAY_NS) for one in kept if one.started_ns]
        assert [Path(one.log).stem for one in kept] == (["c", "a", "b"] if how == "named" else ["c", "b", "a"])
    assert order == {"named": [("c", 1)], "file-time": [("c", 1), ("b", 10), ("a", 30)]}


def test_a_page_shows_the_trends_and_what_asks_for_attention_first(mavdiag: Any, wearing: Path) -> None:
    with open_history(str(wearing), write=True) as history:
        history.mark(Mark("calm", history.flights("calm")[30].t_ns - 1, MarkKind.NEW_PROPELLERS))
    page = wearing.with_suffix(".html")
    assert mavdiag("history", "show", "--database", wearing, "--html", page)[0] == 1
    text = page.read_text()
    assert text.index('<h2 class="said">worn: ') < text.index('<h2 class="said">calm: ')
    assert text.count("<svg") >= 2
    assert "unbalance: warned of" in text
    assert "new propellers" in text[text.index('<h2 class="said">calm: ') :]
    assert str(wearing) not in text


def flown(bench: Bench, seconds: float, *, armed: bool = True) -> None:
    for vehicle in bench.vehicles:
        vehicle.armed = armed
    bench.run(seconds)


def watching(baseline: Baseline, flights: Flights, *vehicles: MadeVehicle) -> Bench:
    return Bench(Settings(connect=UDP_IN, learn=1.0), baseline=baseline, flights=flights, vehicles=list(vehicles))


def in_this_process(command: list[str], **how: Any) -> SimpleNamespace:
    assert how["env"]["PYTHONSAFEPATH"]  # whatever lies in the present folder
    ran = CliRunner().invoke(app, command[command.index("mavdiag") + 1 :])
    said = "" if ran.exception is None else str(ran.exception)
    return SimpleNamespace(returncode=ran.exit_code, stdout=ran.output, stderr=said)


def test_every_flight_is_in_the_history_as_its_log_would_be(tmp_path: Path) -> None:
    baseline = baseline_for()
    baseline = baseline.model_copy(update={"airframe": baseline.airframe.__class__(name="racer", scope="type")})
    database, folder, said = str(tmp_path / "history.sqlite"), tmp_path / "flights", list[str]()
    flights = Flights(database, folder, said.append)
    bench = watching(baseline, flights, MadeVehicle(3), MadeVehicle(4))
    kept: dict[str, bytes] = {}

    def put(job: Any) -> None:
        kept.setdefault(job[0].name, job[0].read_bytes())
        Courier.put(flights, job)

    with patch.object(flights, "put", put), patch("detector.flights.subprocess.run", in_this_process):
        flown(bench, 3.0, armed=False)
        flown(bench, 20.0)
        flown(bench, 2.0, armed=False)
        flown(bench, 20.0)
        bench.close()  # in flight: what is there is a flight, too
        wait_for(lambda: not list(folder.glob("*.tlog")), "the flights are added")
        flights.close()
    assert (flights.lost, said) == (0, [])
    with open_history(database) as opened:
        assert opened.names() == ("racer 3", "racer 4")
        for number in (3, 4):
            records = opened.flights(f"racer {number}")
            assert len(records) == 2
            for record in records:
                (copy := tmp_path / "copy.tlog").write_bytes(kept[Path(record.log).name])
                whole = judge_file(str(copy), Question.of(baseline, Options(number, figures=True))).flight
                assert whole is not None
                assert (record.verdict, record.slots, record.content) == (whole.verdict, whole.slots, whole.content)
                assert record.judged_s > 10.0


def test_a_flight_with_a_reboot_is_kept_and_a_vehicle_lost_in_flight_begins_no_other(tmp_path: Path) -> None:
    (tmp_path / "20240501T1200-mine.tlog").touch()
    flights = Flights(str(tmp_path / "history.sqlite"), tmp_path, print)
    bench = watching(baseline_for(), flights, MadeVehicle(3))
    with patch.object(flights, "put") as put:
        flown(bench, 12.0)
        bench.vehicles = [MadeVehicle(3)]
        flown(bench, 12.0, armed=False)
        assert bench.daemon.fleet.vehicles[3].session.reboots == 1
        with patch("os.fstatvfs", lambda _: os.statvfs_result((1,) * 10)):  # no room for a flight
            flown(bench, 12.0)
            flown(bench, 2.0, armed=False)
        flown(bench, 12.0)
        bench.vehicles = []
        with patch.object(Path, "open", side_effect=OSError) as opened:
            bench.run(70.0)
        bench.close()
    flights.close()
    assert (put.call_count, opened.call_count) == (2, 0)


@patch("detector.hooks.PAUSE_S", 0.0)
def test_a_flight_that_cannot_be_added_is_told_and_added_by_the_next_start(tmp_path: Path) -> None:
    missing, folder, said = tmp_path / "missing" / "history.sqlite", tmp_path / "flights", list[str]()
    flights = Flights(str(missing), folder, said.append)
    bench = watching(baseline_for(), flights, MadeVehicle(3))
    with patch("detector.flights.subprocess.run", in_this_process):
        flown(bench, 12.0)
        flown(bench, 2.0, armed=False)
        wait_for(lambda: flights.lost, "it gives up")
        bench.host.ahead = timedelta(seconds=-13)  # the wall clock is set back, to when this flight began
        flown(bench, 12.0)
        with (
            patch("detector.flights.MIN_JUDGED_S", 60.0),
            patch.object(Path, "unlink", side_effect=OSError(errno.EROFS, "read-only")),
        ):
            flown(bench, 2.0, armed=False)
        flown(bench, 12.0)
    bench.close()
    flights.close()
    assert (len(list(folder.glob("3-*.tlog"))), flights.lost) == (3, 3)
    assert "there is no folder" in said[0]
    missing.parent.mkdir()
    flights = Flights(str(missing), folder, said.append)
    bench = watching(baseline_for(), flights)
    wait_for(lambda: not list(folder.glob("3-*.tlog")), "the flight is added")
    bench.close()
    flights.close()
    with open_history(str(missing)) as opened:
        assert len(opened.flights(*opened.names())) == 3


def test_a_vehicle_gets_the_baseline_that_is_named_by_its_uid_also_where_it_is_swapped(tmp_path: Path) -> None:
    plain, own, other = (baseline_for(names=(name,)) for name in ("fsd", "rotor_trim", "vibration_level"))
    for name, baseline in (("1", plain), (UID, own), (OTHER, other)):
        baseline.save(tmp_path / f"{name}.json")
    found = baselines_in(tmp_path)
    vehicles, uids = [MadeVehicle(k, Autopilot.GENERIC) for k in (1, 2, 3)], {2: UID}
    flights = Flights(str(tmp_path / "history.sqlite"), tmp_path / "flights", print)
    bench = Bench(Settings(connect=UDP_IN, baselines=tmp_path), baselines=found, vehicles=vehicles, flights=flights)

    def asked() -> dict[int, int]:
        counts = dict.fromkeys((1, 2, 3), 0)
        for _ in range(12):
            bench.run(0.5)
            for frame in received(bench.far):
                if frame.msgid == MessageId.COMMAND_LONG and frame.value("command") == MavCmd.REQUEST_MESSAGE:
                    system = frame.value("target_system")
                    counts[system] += frame.value("param1") == MessageId.AUTOPILOT_VERSION
                    if system in uids:
                        told = (0, 0, 0, 0, 0, (0,) * 8, (0,) * 8, (0,) * 8, 0, 0, int(uids[system], 16))
                        bench.far.send(vehicles[system - 1].encoder.encode(MessageId.AUTOPILOT_VERSION, *told))
        return counts

    def judged() -> dict[int, Baseline | None]:
        return {sysid: vehicle.session.baseline for sysid, vehicle in bench.daemon.fleet.vehicles.items()}

    assert (asked(), judged()) == ({1: 0, 2: 1, 3: 3}, {1: found[1], 2: found[UID]})
    assert any("vehicle 3: not watched" in line for line in bench.host.lines)
    uids |= {2: OTHER, 3: UID}
    vehicles[1:] = [MadeVehicle(k, Autopilot.GENERIC) for k in (2, 3)]
    assert (asked(), judged()) == ({1: 0, 2: 3, 3: 3}, {1: found[1], 2: found[OTHER], 3: found[UID]})
    uids[2] = f"{0x77:016x}"
    vehicles[1] = MadeVehicle(2, Autopilot.GENERIC)
    with patch.object(flights, "put") as put:
        assert (asked(), judged()) == ({1: 0, 2: 3, 3: 0}, {1: found[1], 3: found[UID]})
        assert put.call_count == 1  # its flight has ended
        bench.close()
    flights.close()
