"""The whole daemon on a virtual clock and an in-memory link: what it sends, to whom, and when it is silent."""

import errno
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import NoReturn
from unittest.mock import patch

import numpy as np
import pytest
from made_session import baseline_for
from made_vehicle import RATE_HZ, TICK_S, Bench, FakeFitter, MadeVehicle, VirtualHost, received
from memory_port import MemoryEndpoint
from test_attacks import COMMANDS, SENT
from virtual_flight import GroundStation, VirtualFlight, taught

from detector.config import Settings, VehicleSettings
from detector.fleet import Turn
from detector.notify import Notifier
from detector.states import State
from mavdiag.baseline import Baseline
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.datagrams import Datagrams
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId, Severity
from mavdiag.logs.tlog import read_tlog
from mavdiag.telemetry import Instant, Signal
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

UDP_IN, UDP_OUT = "udpin:127.0.0.1:0", "udpout:127.0.0.1:14550"
Benches = Callable[..., Bench]
STATION = Encoder(255, Component.MISSIONPLANNER)
US = (1, Component.ONBOARD_COMPUTER)
WATCH = Settings(connect=UDP_IN, baseline=Path("b.json"))
VEHICLE = replace(qdrone2(), propulsion=replace(qdrone2().propulsion, load_share=0.2))
SETTLED_S = 15.0  # the live gate's 5 s, and the longest window
STREAMS = (MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET, MessageId.SERVO_OUTPUT_RAW, MessageId.ATTITUDE)


@pytest.fixture
def benches() -> Iterator[Benches]:
    made: list[Bench] = []

    def make(settings: Settings, *vehicles: MadeVehicle, **options: object) -> Bench:
        made.append(Bench(settings, vehicles=list(vehicles), **options))  # type: ignore[arg-type]  # of several types
        return made[-1]

    yield make
    for bench in made:
        bench.close()


def of(frames: list[Frame], message: MessageId) -> list[Frame]:
    return [frame for frame in frames if frame.msgid == message]


def texts(frames: list[Frame]) -> list[str]:
    return [frame.text("text") for frame in of(frames, MessageId.STATUSTEXT)]


@pytest.mark.parametrize(("expected", "sysid"), [(None, 1), (42, 42)])
def test_a_link_to_be_spoken_to_first_gets_heartbeats_only(benches: Benches, expected: int | None, sysid: int) -> None:
    bench = benches(Settings(connect=UDP_OUT, learn=5.0, vehicle=expected))
    bench.run(5.0)
    assert Counter((frame.msgid, frame.sysid) for frame in received(bench.far)) == {(MessageId.HEARTBEAT, sysid): 6}


def test_two_vehicles_on_one_link_have_a_session_each(benches: Benches, tmp_path: Path) -> None:
    fitter = FakeFitter(baseline_for())
    settings = Settings(connect=UDP_IN, learn=5.0, save=tmp_path / "b.json")
    bench = benches(settings, MadeVehicle(1), MadeVehicle(2), fitter=fitter)
    bench.run(12.0)
    assert set(fitter.begun) == {1, 2}
    frames = received(bench.far)
    beats = of(frames, MessageId.HEARTBEAT)
    assert {beat.sysid for beat in beats} == {1, 2}
    assert {(beat.value("type"), beat.value("autopilot")) for beat in beats} == {
        (MavType.ONBOARD_CONTROLLER, Autopilot.INVALID)
    }
    assert {frame.compid for frame in frames} == {Component.ONBOARD_COMPUTER}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b-2.json", "b.json"]
    for sysid in (1, 2):  # one sequence for each, without a hole
        seqs = [frame.seq for frame in frames if frame.sysid == sysid]
        assert seqs == [(seqs[0] + k) % 256 for k in range(len(seqs))]


def test_commands_for_others_are_ignored_and_ours_are_declined(benches: Benches) -> None:
    bench = benches(Settings(connect=UDP_IN, learn=5.0), MadeVehicle(1))
    bench.run(3.0)
    received(bench.far)
    station = Encoder(255, 190)
    for target in ((1, 1), (1, 0), (0, 0), (2, 191), (1, 191)):
        bench.far.send(station.encode(MessageId.COMMAND_LONG, *target, MavCmd.REQUEST_MESSAGE, 0, 244))
    bench.run(0.2)
    [ack] = of(received(bench.far), MessageId.COMMAND_ACK)
    assert (ack.value("command"), ack.value("result")) == (MavCmd.REQUEST_MESSAGE, MavResult.UNSUPPORTED)
    assert (ack.sysid, ack.compid) == (1, Component.ONBOARD_COMPUTER)


def test_links_behind_get_the_vehicle_and_the_texts_and_can_answer(benches: Benches) -> None:
    vehicle = MadeVehicle(1)
    bench = benches(Settings(connect=UDP_IN, learn=5.0), vehicle, links_behind=2)
    bench.run(4.0)
    for end in bench.behind:
        frames = received(end)
        assert len(of(frames, MessageId.RAW_IMU)) == vehicle.sent
        assert any("learning" in text for text in texts(frames))
        assert of(frames, MessageId.COMMAND_LONG) == []
    received(bench.far)
    bench.behind[0].send(Encoder(255, 190).encode(MessageId.PARAM_REQUEST_LIST, 1, 1))
    bench.run(0.1)
    assert len(of(received(bench.far), MessageId.PARAM_REQUEST_LIST)) == 1


def test_a_fault_is_on_the_wire_as_text_and_as_figures(benches: Benches) -> None:
    vehicle = MadeVehicle(1)
    bench = benches(Settings(connect=UDP_IN, baseline=Path("b.json")), vehicle, baseline=baseline_for())
    bench.run(6.0)
    received(bench.far)
    vehicle.turning = 0.5
    bench.run(3.0)
    frames = received(bench.far)
    said = of(frames, MessageId.STATUSTEXT)
    # This baseline has no monitor of sensors, so nothing is waited for.
    assert [one.numbers("severity", "id") for one in said] == [(Severity.CRITICAL, 0)]
    assert said[0].text("text") == "PROP FAULT roll attitude unlike the model"
    figures = {one.text("name"): one.value("value") for one in of(frames, MessageId.NAMED_VALUE_FLOAT)}
    assert set(figures) == {"PF_RES", "PF_MARG", "PF_FSD", "PF_FML"}
    assert (figures["PF_RES"], figures["PF_FML"]) == (pytest.approx(0.5, abs=0.05), pytest.approx(0.3))


def test_l9_the_recording_reads_back_as_the_flight_that_was_received(benches: Benches, tmp_path: Path) -> None:
    vehicle = MadeVehicle(1)
    bench = benches(Settings(connect=UDP_IN, learn=50.0), vehicle, record=tmp_path / "flight.tlog")
    bench.run(4.0)
    sent = vehicle.sent
    with patch("os.fstatvfs", lambda _: os.statvfs_result((1,) * 10)):  # a byte is left for the journal
        bench.run(1.0)
    assert any("less than 50 MB are left there" in line for line in bench.host.lines)
    assert len(read_tlog(tmp_path / "flight.tlog").telemetry.need(Signal.BODY_RATE)) == sent


class SlowManager(Notifier):
    """Every look with a heartbeat takes 0.1 s longer than it may."""

    host, looks = VirtualHost(), 0

    def status(self, status: str, *, alive: bool) -> None:
        self.looks += 1
        self.host.ns += 100_000_000


def test_bytes_without_a_frame_are_told_once(benches: Benches) -> None:
    bench = benches(Settings(connect=UDP_IN, learn=5.0))
    bench.far.send(bytes(64))
    bench.run(8.0)
    assert [line for line in bench.host.lines if "baud" in line] == [bench.daemon.fleet.link.babble]


def test_l11_looks_that_come_late_are_counted_and_told(benches: Benches) -> None:
    slow = SlowManager({})
    bench = benches(Settings(connect=UDP_IN, learn=5.0, tick_s=0.04), host=slow.host, notifier=slow)
    bench.daemon.run(lambda: slow.looks >= 5)
    assert "5 looks came late, by 0.06 s at most" in slow.host.lines[-1]
    assert bench.daemon.figures().late == 5


@pytest.mark.parametrize("reading_s", [0.0, 0.1])
def test_all_is_read_and_none_starves_when_there_is_too_much_to_judge(
    benches: Benches, monkeypatch: pytest.MonkeyPatch, reading_s: float
) -> None:
    """Two or four of eight vehicles, of 10 ms each, have their turn in a look, also if reading takes longer than it."""
    host, vehicles = VirtualHost(), [MadeVehicle(sysid) for sysid in range(1, 9)]
    bench = benches(judging(), *vehicles, baseline=baseline_for(), host=host)
    fleet = bench.daemon.fleet
    take, turn = fleet.take, fleet._turn

    def slow_take(*given: object) -> None:
        take(*given)  # type: ignore[arg-type]
        host.ns += round(reading_s * 1e9)

    def slow_turn(sysid: int, now: Instant) -> Turn:
        host.ns, host.cpu = host.ns + 10_000_000, host.cpu + 0.01
        return turn(sysid, now)

    monkeypatch.setattr(fleet, "take", slow_take)
    monkeypatch.setattr(fleet, "_turn", slow_turn)
    bench.run(8.0)
    waits = []
    for _ in range(50):
        bench.run(TICK_S)
        waits.append(fleet.longest_s)
    assert 0.1 < max(waits) < 1.0
    figures = fleet.vehicles.values()
    assert [one.count.lost for one in figures] == [0] * 8
    assert max(one.judged_s for one in figures) - min(one.judged_s for one in figures) < 1.0
    assert min(one.judged_s for one in figures) > 3.0


def judging(**more: object) -> Settings:
    return Settings.model_validate({"connect": UDP_IN, "baseline": Path("b.json"), **more})


def asked(bench: Bench, end: MemoryEndpoint, frame: bytes) -> list[Frame]:
    received(end)
    end.send(frame)
    bench.run(0.1)
    return received(end)


LANDING = """
import sys
from numba.core.dispatcher import Dispatcher
from test_daemon_virtual import Baseline, Bench, Decoder, Encoder, MadeVehicle, Path, judging
from mavdiag.chain import warm
from mavdiag.link.signing import Signing
def compiled():
    found = [one for name, of in sys.modules.items() if name.startswith("mavdiag.") for one in vars(of).values()]
    return {f"{one} {len(one.signatures)}" for one in found if isinstance(one, Dispatcher) and one.signatures}
warm()
before = compiled()
bench = Bench(judging(), vehicles=[], baseline=Baseline.load(Path(sys.argv[1])))
bench.far.send(b"short")
bench.run(0.1)
bench.vehicles.append(MadeVehicle(1))
bench.run(25.0)
bench.vehicles[0].armed = False
bench.run(8.0)
sealing, decoder = Encoder(1, 1, Signing(bytes(32))), Decoder(signing=Signing(bytes(32)))
assert [len(decoder.feed(sealing.encode(0, 2, 3, 0, 0, 4, 3))) for _ in range(2)] == [1, 1]
assert compiled() <= before, compiled() - before"""


def test_nothing_compiles_in_flight_nor_at_its_landing_nor_for_a_few_bytes(tmp_path: Path) -> None:
    """The first landing, and 8 bytes that came alone, held the daemon up for seconds after an installation."""
    baseline_for().save(tmp_path / "b.json")
    own = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", LANDING, tmp_path / "b.json"], check=True, env=own)


def test_rates_that_are_needed_are_kept_and_everything_else_passes(benches: Benches) -> None:
    bench = benches(judging(keep_rates=True), MadeVehicle(1), baseline=baseline_for(), links_behind=1)
    bench.run(4.0)
    received(bench.far)
    ours = STATION.encode(MessageId.COMMAND_LONG, 1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, MessageId.RAW_IMU, 1_000_000)
    more = STATION.encode(MessageId.COMMAND_LONG, 1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0, MessageId.SYS_STATUS, 1_000_000)
    [ack] = of(asked(bench, bench.behind[0], ours), MessageId.COMMAND_ACK)
    assert (ack.value("result"), ack.value("target_system")) == (MavResult.DENIED, 255)
    asked(bench, bench.behind[0], more)
    asked(bench, bench.behind[0], STATION.encode(MessageId.REQUEST_DATA_STREAM, 1, 1, 0, 4, 1))
    frames = received(bench.far)
    assert [one.value("param1") for one in of(frames, MessageId.COMMAND_LONG)] == [MessageId.SYS_STATUS]
    groups = of(frames, MessageId.REQUEST_DATA_STREAM)
    assert {one.value("req_stream_id") for one in groups} == {2, 6, 11}
    assert {one.compid for one in groups} == {Component.ONBOARD_COMPUTER}


def test_vehicles_beyond_the_bound_are_not_watched_and_that_is_said_once(benches: Benches) -> None:
    bench = benches(Settings(connect=UDP_IN, learn=50.0, max_vehicles=2), *(MadeVehicle(k) for k in (1, 2, 3)))
    bench.run(6.0)
    assert set(bench.daemon.fleet.vehicles) == {1, 2}
    words = [line for line in bench.host.lines if "vehicle 3" in line]
    assert words == ["vehicle 3: not watched: there are 2 vehicles already (max_vehicles)"]


def test_each_vehicle_of_a_fleet_is_judged_by_its_own_baseline(benches: Benches) -> None:
    own = {2: baseline_for(names=("rotor_trim",)), 3: baseline_for()}
    table = {sysid: VehicleSettings(baseline=Path("b.json")) for sysid in own}
    bench = benches(Settings(connect=UDP_IN, vehicles=table), *(MadeVehicle(k) for k in (1, 2, 3)), baselines=own)
    bench.run(4.0)
    assert {sysid: vehicle.session.baseline for sysid, vehicle in bench.daemon.fleet.vehicles.items()} == own
    words = [line for line in bench.host.lines if "vehicle 1" in line]
    assert words == ["vehicle 1: not watched: it has no baseline; name one in [vehicles.1]"]
    assert not any("but several fly" in line for line in bench.host.lines)
    assert "watching 2 vehicles by baselines of their own" in bench.host.lines[0]


@pytest.fixture
def watching(benches: Benches) -> Benches:
    def make(**options: object) -> Bench:
        bench = benches(WATCH, MadeVehicle(1), baseline=baseline_for(), **options)
        bench.run(6.0)
        assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
        return bench

    return make


def alarms(bench: Bench) -> list[str]:
    """The texts of declared faults since the last time."""
    told = of(received(bench.far), MessageId.STATUSTEXT)
    return texts([one for one in told if one.value("severity") <= Severity.CRITICAL])


def finds_a_fault(bench: Bench) -> bool:
    """Whether it judges again: quiet so far, and an alarm within 3 s of a fault."""
    quiet = not alarms(bench)
    bench.vehicles[0].turning = 0.5
    bench.run(3.0)
    return quiet and bool(alarms(bench))


@pytest.mark.parametrize(("cut_s", "reboots"), [(1.0, 0), (60.0, 0), (4.0, 1)])
def test_a_vehicle_that_was_silent_or_rebooted_is_judged_again(watching: Benches, cut_s: float, reboots: int) -> None:
    bench = watching()
    for _ in range(round(cut_s / TICK_S)):  # it flies on, and nothing of it arrives
        bench.vehicles[0].samples(round(TICK_S * RATE_HZ))
        bench.host.sleep(TICK_S)
        bench.daemon.tick()
    assert (bench.daemon.fleet.vehicles[1].session.state is State.LOST) == (cut_s > 3.0)
    bench.vehicles[0].sent *= 1 - reboots
    bench.run(8.0)
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == reboots
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
    assert finds_a_fault(bench)


def test_an_error_of_the_program_takes_off_one_vehicle_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = tmp_path / "j.jsonl"
    bench = Bench(WATCH, vehicles=[MadeVehicle(1), MadeVehicle(2)], baseline=baseline_for(), journal=journal)
    bench.run(6.0)

    def fails(*_: object) -> NoReturn:
        raise KeyError("a bug")

    monkeypatch.setattr(bench.daemon.fleet.link.vehicles[2], "step", fails)
    bench.run(3.0)
    assert [one.session.state for one in bench.daemon.fleet.vehicles.values()] == [State.MONITORING, State.FAULTED]
    assert [text for text in texts(received(bench.far)) if "OFF" in text] == ["PROP OFF: KeyError: internal error"]
    assert finds_a_fault(bench)
    bench.close()
    lines = [json.loads(one) for one in journal.read_text().splitlines()]
    assert [one for one in lines if one["vehicle"] == 2 and "KeyError('a bug')" in one.get("text", "")]
    assert lines[-1]["kind"] == "stop"


@pytest.mark.parametrize("days", [-400, 400])
def test_a_set_wall_clock_changes_nothing_and_a_vehicles_is_told(watching: Benches, days: int, tmp_path: Path) -> None:
    host = VirtualHost()
    bench = watching(host=host, record=tmp_path / "a.tlog")
    before_s = bench.daemon.fleet.vehicles[1].judged_s
    host.ahead = timedelta(days=days)
    bench.run(5.0)
    assert bench.daemon.fleet.vehicles[1].judged_s == pytest.approx(before_s + 5.0, abs=0.1)
    session = bench.daemon.fleet.vehicles[1].session
    assert session.unix_offset_ns - session.spec.unix_offset_ns == pytest.approx(days * 86400e9, abs=1e9)
    assert np.ptp(read_tlog(tmp_path / "a.tlog")["body_rate"].host_ns) == pytest.approx(abs(days) * 86400e9, rel=1e-3)
    bench.vehicles[0].sent -= 40
    bench.run(5.0)
    assert texts(received(bench.far))[-1] == "PROP clock of the vehicle was set back"
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == 0
    assert finds_a_fault(bench)


def test_a_full_disk_leaves_the_old_baseline_and_the_watch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "b.json"
    baseline_for(rate_hz=200).save(path)
    before = path.read_bytes()

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    settings = Settings(connect=UDP_IN, learn=5.0, save=path)
    bench = Bench(settings, vehicles=[MadeVehicle(1)], fitter=FakeFitter(baseline_for()))
    bench.run(12.0)
    assert (path.read_bytes(), [one.name for one in tmp_path.iterdir()]) == (before, ["b.json"])
    assert any("baseline is not saved" in line and "No space left" in line for line in bench.host.lines)
    assert "PROP baseline not saved, lost at the end" in texts(received(bench.far))
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
    assert finds_a_fault(bench)
    bench.close()


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    return taught(range(3), 40.0, vehicle=VEHICLE)


@pytest.mark.parametrize("station", [GroundStation.of(), GroundStation.of(*STREAMS)], ids=["66", "511"])
def test_l3_a_station_that_resets_rates_costs_a_tenth_of_the_time(baseline: Baseline, station: GroundStation) -> None:
    with closing(Bench(WATCH, baseline=baseline)) as bench:
        flight = VirtualFlight(bench, station)
        flight.fly(PlantConfig(seed=9, vehicle=VEHICLE), 46.0)
        session = bench.daemon.fleet.vehicles[1].session
        requests = [line for line in bench.host.lines if "asked for RAW_IMU" in line]
    assert session.working
    assert not any(State.FAULTED in line for line in bench.host.lines)
    span_s, judged_s = np.subtract(flight.judged_s[-1], next(one for one in flight.judged_s if one[0] >= SETTLED_S))
    assert judged_s >= 0.9 * span_s
    assert (len(station.times), len(requests)) == (4, 4)  # one each: it is answered, and nobody fights
    assert any("does a ground station set it? (MAVProxy: set streamrate -1)" in line for line in bench.host.lines)


def test_what_tells_rotors_and_filter_is_read_while_it_learns_and_nothing_is_ever_set() -> None:
    heard, decoder = list[Frame](), Decoder()
    with closing(Bench(Settings(connect=UDP_IN, learn=500.0))) as bench:
        receive = bench.far.receive

        def listening(timeout_s: float) -> Datagrams:
            chunks = receive(timeout_s)
            heard.extend(decoder.take(chunks))
            return chunks

        with patch.object(bench.far, "receive", listening):
            VirtualFlight(bench).fly(PlantConfig(seed=3), 8.0)
        parameters = bench.daemon.fleet.link.vehicles[1].parameters
    assert (parameters["FRAME_CLASS"], parameters["INS_GYRO_FILTER"]) == (1.0, 20.0)
    assert {frame.msgid for frame in heard} <= SENT
    names = Counter(frame.text("param_id") for frame in of(heard, MessageId.PARAM_REQUEST_READ))
    assert max(names.values()) <= 3  # an output that this vehicle does not have
    assert {frame.value("command") for frame in of(heard, MessageId.COMMAND_LONG)} <= COMMANDS


@pytest.mark.parametrize("profile", ["ardupilot", "px4"])
def test_esc_telemetry_is_learnt_from_metered_and_the_weak_rotor_is_named(profile: str) -> None:
    baseline = taught(range(3), 30.0, profile, vehicle=VEHICLE)
    assert "rotor_speed" in {entry.spec.kind for entry in baseline.monitors}
    damage = Injection(RotorDamage(thrust_factor=0.9, drag_factor=0.9), rotor=3, onset_s=15.0)
    with closing(Bench(WATCH, baseline=baseline)) as bench:
        VirtualFlight(bench).fly(PlantConfig(seed=9, vehicle=VEHICLE, injections=(damage,)), 26.0, profile)
        (session,) = (vehicle.session for vehicle in bench.daemon.fleet.vehicles.values())
        assert session.judge is not None
        ratios = {slot.monitor.name: ratio for slot, ratio in session.judge.memory.ratios}
        lines = bench.host.lines
    assert any("PROP FAULT motor 3" in line for line in lines)
    assert session.streams.meters[Signal.ROTOR_SPEED].rate_hz == pytest.approx(10.0, rel=0.1)
    assert session.diagnosis.rotor == 3
    assert ratios["rotor_speed"] > 1.0
    assert "rotor_trim" in ratios
