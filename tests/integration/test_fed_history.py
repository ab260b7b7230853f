"""The daemon feeds the history after each landing, and takes baselines from a folder by system id or uid."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import pytest
from made_session import baseline_for
from made_vehicle import EPOCH_NS, Bench, MadeVehicle, received

from detector.config import Settings
from detector.flights import Flights
from detector.hooks import Courier
from detector.journal import baselines_in
from mavdiag.archive.scan import Options, Question, judge_file
from mavdiag.baseline import Baseline
from mavdiag.link.codec import field_index
from mavdiag.link.messages import Autopilot, MavCmd, MessageId

UDP_IN = "udpin:127.0.0.1:0"
WAIT_S = 120.0
UID = "0011223344556677"


def wait_for(found: Callable[[], object]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not found():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def flown(bench: Bench, seconds: float, *, armed: bool = True) -> None:
    for vehicle in bench.vehicles:
        vehicle.armed = armed
    bench.run(seconds)


def watching(baseline: Baseline, flights: Flights, *vehicles: MadeVehicle) -> Bench:
    return Bench(Settings(connect=UDP_IN, learn=1.0), baseline=baseline, flights=flights, vehicles=list(vehicles))


def test_every_flight_is_in_the_history_as_its_log_would_be(tmp_path: Path) -> None:
    history = pytest.importorskip("mavdiag.history.store", reason="the history is an extra")
    baseline = baseline_for()
    baseline = baseline.model_copy(update={"airframe": baseline.airframe.__class__(name="racer", scope="type")})
    database, folder, said = str(tmp_path / "history.sqlite"), tmp_path / "flights", list[str]()
    flights = Flights(database, folder, EPOCH_NS, said.append)
    bench = watching(baseline, flights, MadeVehicle(3), MadeVehicle(4))
    kept: dict[str, bytes] = {}

    def put(line: bytes) -> None:
        kept.setdefault(*copied(line))
        Courier.put(flights, line)

    with patch.object(flights, "put", put):
        flown(bench, 3.0, armed=False)
        flown(bench, 20.0)
        flown(bench, 2.0, armed=False)
        flown(bench, 20.0)
        bench.close()  # in flight: what is there is a flight, too
    wait_for(lambda: not list(folder.glob("*.tlog")))
    flights.close()
    assert (flights.lost, said) == (0, [])
    with history.open_history(database) as opened:
        assert opened.names() == ("racer 3", "racer 4")
        for number in (3, 4):
            records = opened.flights(f"racer {number}")
            assert len(records) == 2
            for record in records:
                copy = tmp_path / "copy.tlog"
                copy.write_bytes(kept[Path(record.log).name])
                whole = judge_file(str(copy), Question.of(baseline, Options(number, figures=True))).flight
                assert whole is not None
                assert (record.verdict, record.slots, record.content) == (whole.verdict, whole.slots, whole.content)
                assert record.judged_s > 10.0


def copied(line: bytes) -> tuple[str, bytes]:
    path = Path(json.loads(line)[0])
    return path.name, path.read_bytes()


def test_a_flight_that_cannot_be_added_is_told_and_added_by_the_next_start(tmp_path: Path) -> None:
    history = pytest.importorskip("mavdiag.history.store", reason="the history is an extra")
    missing, folder, said = tmp_path / "missing" / "history.sqlite", tmp_path / "flights", list[str]()
    with patch("detector.hooks.PAUSE_S", 0.0):
        flights = Flights(str(missing), folder, EPOCH_NS, said.append)
    flights._pause_s = 0.0
    bench = watching(baseline_for(), flights, MadeVehicle(3))
    flown(bench, 12.0)
    flown(bench, 2.0, armed=False)
    wait_for(lambda: flights.lost)
    bench.close()
    flights.close()
    assert len(list(folder.glob("3-*.tlog"))) == 1
    assert "there is no folder" in said[0]
    missing.parent.mkdir()
    flights = Flights(str(missing), folder, EPOCH_NS, said.append)
    bench = watching(baseline_for(), flights)
    wait_for(lambda: not list(folder.glob("3-*.tlog")))
    bench.close()
    flights.close()
    with history.open_history(str(missing)) as opened:
        assert len(opened.flights(*opened.names())) == 1


def test_a_vehicle_gets_the_baseline_that_is_named_by_its_uid(tmp_path: Path) -> None:
    plain, own = baseline_for(), baseline_for(names=("rotor_trim",))
    plain.save(tmp_path / "1.json")
    own.save(tmp_path / f"{UID}.json")
    found = baselines_in(tmp_path)
    assert set(found) == {1, UID}
    vehicles = [MadeVehicle(k, Autopilot.GENERIC) for k in (1, 2, 3)]
    bench = Bench(Settings(connect=UDP_IN, baselines=tmp_path), baselines=found, vehicles=vehicles)
    asked = dict.fromkeys((1, 2, 3), 0)
    for _ in range(12):
        bench.run(0.5)
        for frame in received(bench.far):
            if frame.msgid == MessageId.COMMAND_LONG:
                system, command, msgid = (
                    frame.fields[field_index(frame.msgid, name)] for name in ("target_system", "command", "param1")
                )
                if command == MavCmd.REQUEST_MESSAGE and msgid == MessageId.AUTOPILOT_VERSION:
                    asked[int(system)] += 1
                    if system == 2:
                        told = (0, 0, 0, 0, 0, (0,) * 8, (0,) * 8, (0,) * 8, 0, 0, int(UID, 16))
                        bench.far.send(vehicles[1].encoder.encode(MessageId.AUTOPILOT_VERSION, *told))
    judged = {sysid: vehicle.session.baseline for sysid, vehicle in bench.daemon.fleet.vehicles.items()}
    assert judged == {1: found[1], 2: found[UID]}
    assert asked == {1: 0, 2: 1, 3: 3}
    assert any("vehicle 3: not watched" in line for line in bench.host.lines)
    bench.close()
