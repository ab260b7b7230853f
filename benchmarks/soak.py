"""The daemon for hours: does memory grow, does a verdict come late, is an alert missed?

    PYTHONPATH=tests python benchmarks/soak.py virtual [--hours 24] [--cpu-minutes 20] [--rate 1000] [--seed 31]
    PYTHONPATH=tests python benchmarks/soak.py real [--minutes 20] [--rate 1000] [--seed 31]

virtual: two recorded loops of the emulated quadrotor, one healthy and one with a fault, are sent again and again with
later stamps through the fleet, on a virtual clock with the default tick and a pause of 1.5 s between loops.
Each loop with a fault must be declared. It stops after the hours asked for, or when the processor time is used up.
real: emulators, one after the other, as processes over UDP on loopback, and the daemon in this process. Each emulator
is a vehicle that has rebooted; every second one has a fault 10 s before its end.

Memory is the resident set; its growth is the slope of a straight line through it after the first quarter. The latency
of a verdict is from the sending of a gyro sample to the end of the look in which its row was judged. As the decision is
made every 80 ms, it is also printed for the first sample at or after each of these times alone.
"""

import argparse
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field

import numpy as np
from bad_link import DRONE, taught
from datagrams import resident_mb

from detector.config import Settings
from detector.daemon import Daemon, Host
from detector.fitting import ProcessFitter
from detector.fleet import Fleet
from detector.values import SendText, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import LOOK_NS
from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.datagrams import as_columns
from mavdiag.link.messages import Component, MessageId, Severity
from mavdiag.link.ports import Endpoint, open_endpoint
from mavdiag.link.samples import SOURCES
from mavdiag.telemetry import Instant, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.emulator import recorded
from sitl_plant.options import FlightPlan
from sitl_plant.plant import PlantConfig

HEALTHY_S, FAULTY_S, ONSET_S, PAUSE_S = 120.0, 14.0, 8.0, 1.5
FAULT, ROTOR = "F2/SV2", 2
STAMPS = {
    source.message: (struct.Struct("<I" if source.time[1].turn else "<Q"), source.time[1].tick_ns)
    for source in SOURCES
    if source.time is not None
}  # every stamp is the first field on the wire
BINS = 2000  # of 1 ms


def _no_ages() -> IntArray:
    return np.zeros(BINS, np.int64)


@dataclass(slots=True)
class Record:
    """What is measured on the way. ages: rows judged at each age [ms]; deciding: of them, those a decision needs."""

    ages: IntArray = field(default_factory=_no_ages)
    deciding: IntArray = field(default_factory=_no_ages)
    judged_ns: int | None = None
    memory: list[tuple[float, float]] = field(default_factory=list)

    def look(self, fleet: Fleet, host_ns: int, lead_ns: int) -> None:
        """Note the rows that this look judged. lead_ns: of the host's clock over the vehicle's."""
        for vehicle in fleet.vehicles.values():
            judge = vehicle.session.judge
            now_ns = None if judge is None else judge.memory.now_ns
            if now_ns is None or judge is None:
                continue
            if self.judged_ns is not None and 0 < now_ns - self.judged_ns < NS_PER_S:
                step_ns = round(judge.baseline.link.dt_s * NS_PER_S)
                rows = np.arange(self.judged_ns + step_ns, now_ns + 1, step_ns)
                ages = ((host_ns - lead_ns - rows) // NS_PER_MS).clip(0, BINS - 1)
                np.add.at(self.ages, ages, 1)
                np.add.at(self.deciding, ages[np.diff(rows // LOOK_NS, prepend=self.judged_ns // LOOK_NS) > 0], 1)
            self.judged_ns = now_ns

    def print_figures(self) -> None:
        """Latency and growth."""
        for name, ages in (("sample to verdict", self.ages), ("of these, what decides", self.deciding)):
            within = np.cumsum(ages)
            p50, p99 = (int(np.searchsorted(within, share * within[-1])) + 1 for share in (0.5, 0.99))
            print(f"{name}: p50 {p50} ms, p99 {p99} ms, of {within[-1]} rows")
        hours, mb = np.array(self.memory).T
        late = hours >= hours[-1] / 4
        slope = float(np.polyfit(hours[late], mb[late], 1)[0]) if late.sum() > 2 else float("nan")
        print(f"memory: {mb[0]:.1f} MB at first, {mb[-1]:.1f} MB at last, {slope:+.2f} MB/h after the first quarter")


def loop_of(fault: str | None, seconds: float, rate_hz: float, seed: int) -> list[tuple[int, int, bytes]]:
    """(flight time [ns], message, payload) of a flight in hover."""
    config = PlantConfig(
        drone=DRONE, trajectory="hover", seed=seed, fault=fault, rotor=ROTOR, onset_s=ONSET_S if fault else 0.0
    )
    plan, decoder = FlightPlan(config, dialect_named("qdrone2"), rate_hz), Decoder()
    return [
        (t_ns, frame.msgid, frame.payload)
        for t_ns, data in recorded(plan, seconds, lambda samples: None)
        for frame in decoder.feed(data, 0)
    ]


def shifted(msgid: int, payload: bytes, shift_ns: int) -> bytes:
    """The payload with its stamp so much later."""
    if msgid not in STAMPS:
        return payload
    stamp, tick_ns = STAMPS[msgid]
    (count,) = stamp.unpack_from(payload)
    return stamp.pack(count + shift_ns // tick_ns & (1 << 8 * stamp.size) - 1) + payload[stamp.size :]


def virtual(hours: float, cpu_s: float, rate_hz: float, seed: int) -> None:
    """Run on the virtual clock and print the figures."""
    baseline = taught(rate_hz, seed)
    settings = Settings(learn=1.0, negotiate=False)
    fleet = Fleet(
        lambda sysid, profile: SessionSpec(profile, baseline, settings), profile=None, only=None, datagrams=True
    )
    loops = [loop_of(None, HEALTHY_S, rate_hz, seed + 50), loop_of(FAULT, FAULTY_S, rate_hz, seed + 51)]
    encode = Encoder(1, Component.AUTOPILOT1).encode_payload
    record, base_ns, started_s = Record(), 1000 * NS_PER_S, time.process_time()
    now_ns, turn, found, missed, false = base_ns, 0, 0, 0, 0
    at_ns, told_s = 0, 0.0
    while at_ns < hours * 3600 * NS_PER_S and time.process_time() - started_s < cpu_s:
        texts = list[tuple[int, str]]()
        chunks = list[tuple[bytes, int]]()
        for t_ns, msgid, payload in loops[turn % 2]:
            while base_ns + at_ns + t_ns > now_ns:
                texts += _look(fleet, record, chunks, now_ns, base_ns)
                chunks, now_ns = [], fleet.next_look(Instant(now_ns), settings.tick_s).ns
            chunks.append((encode(msgid, shifted(msgid, payload, at_ns)), now_ns))
        onset_ns = at_ns + round(ONSET_S * NS_PER_S)
        if turn % 2:
            found += any(when_ns >= onset_ns for when_ns, _ in texts)
            missed += not any(when_ns >= onset_ns for when_ns, _ in texts)
        false += sum(when_ns < onset_ns or not turn % 2 for when_ns, _ in texts)
        at_ns += round(((FAULTY_S if turn % 2 else HEALTHY_S) + PAUSE_S) * NS_PER_S) // NS_PER_MS * NS_PER_MS
        turn += 1
        record.memory.append((at_ns / NS_PER_S / 3600, resident_mb()))
        if time.process_time() - told_s > 60.0:
            told_s = time.process_time()
            print(
                f"{at_ns / NS_PER_S / 3600:.2f} h, {resident_mb():.1f} MB, {found} found, {missed} missed", flush=True
            )
    judged_s = sum(one.judged_s for one in fleet.vehicles.values())
    ran_h, spent_s = at_ns / NS_PER_S / 3600, time.process_time() - started_s
    print(
        f"{ran_h:.2f} of {hours:g} h at {rate_hz:g} Hz, {judged_s / 3600:.2f} h judged, "
        f"{spent_s / 60:.1f} min of processor"
    )
    print(f"{found} faults found, {missed} missed, {false} texts of a fault without one")
    record.print_figures()


def _look(
    fleet: Fleet, record: Record, chunks: list[tuple[bytes, int]], now_ns: int, base_ns: int
) -> list[tuple[int, str]]:
    """One look at the link; texts of a fault, seen again or not, with their time since the beginning."""
    fleet.take(as_columns(chunks), Instant(now_ns))
    said = [
        (now_ns - base_ns, effect.text)
        for turn in fleet.judge(Instant(now_ns))
        for effect in turn.effects
        if isinstance(effect, SendText) and effect.severity <= Severity.WARNING
    ]
    record.look(fleet, now_ns, base_ns)
    return said


def real(minutes: float, rate_hz: float, seed: int) -> None:
    """Run on the wall clock and print the figures."""
    baseline = taught(rate_hz, seed)
    link, station = open_endpoint("udpin:127.0.0.1:0"), open_endpoint("udpin:127.0.0.1:0")
    settings = Settings(connect="udpin:127.0.0.1:0", learn=1.0, negotiate=False)
    behind = open_endpoint(station.address.replace("udpin", "udpout"))
    said = list[str]()
    daemon = _watching(settings, Host(said.append), link, behind, baseline)
    record, decoder = Record(), Decoder({MessageId.STATUSTEXT})
    until_s, begun_s, flights, found, missed, false = time.monotonic() + 60 * minutes, time.monotonic(), 0, 0, 0, 0
    while time.monotonic() < until_s:
        span_s = min(100.0, max(30.0, until_s - time.monotonic()))
        faulty, onset_s = flights % 2 == 1, span_s - 10.0
        plant = _emulator(link.address, rate_hz, span_s, seed + flights, onset_s if faulty else None)
        started_s, lead_ns, times = time.monotonic(), 1 << 62, list[float]()
        next_s = time.monotonic()
        while plant.poll() is None:
            daemon.tick()
            host_ns = time.monotonic_ns()
            for stream in daemon.fleet.link.vehicles.values():
                if stream.state.timeline.reboots == flights and stream.state.timeline.t_ns is not None:
                    lead_ns = min(
                        lead_ns, int(stream.state.timeline.records[0]["host_ns"][0]) - stream.state.timeline.t_ns
                    )
                    record.look(daemon.fleet, host_ns, lead_ns)
            for data, now_ns in station.receive(0.0):
                for frame in decoder.feed(data, now_ns):
                    if frame.numbers("severity") <= (Severity.CRITICAL,):
                        times.append(time.monotonic() - started_s)
            next_s = daemon.fleet.next_look(Instant(host_ns), settings.tick_s).ns / NS_PER_S
            time.sleep(max(0.0, next_s - time.monotonic()))
            if not record.memory or time.monotonic() - begun_s - 3600 * record.memory[-1][0] > 5.0:
                record.memory.append(((time.monotonic() - begun_s) / 3600, resident_mb()))
        flights += 1
        late = [one for one in times if faulty and one > onset_s]
        found, missed = found + bool(late), missed + (faulty and not late)
        false += len(times) - len(late)
        record.judged_ns = None
        print(
            f"flight {flights}: {'fault' if faulty else 'healthy'}, {len(late)} texts of it, {resident_mb():.1f} MB",
            flush=True,
        )
    daemon.end()
    print(f"{minutes:g} min at {rate_hz:g} Hz, {flights} flights, {link.traffic.overflowed} datagrams overflowed")
    print(f"{found} faults found, {missed} missed, {false} texts of a fault without one")
    record.print_figures()


def _watching(settings: Settings, host: Host, link: Endpoint, behind: Endpoint, baseline: Baseline) -> Daemon:
    daemon = Daemon(settings, host, link, [behind], baseline=baseline, fitter=ProcessFitter())
    daemon.begin()
    return daemon


def _emulator(
    address: str, rate_hz: float, span_s: float, seed: int, onset_s: float | None
) -> "subprocess.Popen[bytes]":
    """An emulated vehicle in flight, as a process."""
    out = address.replace("udpin", "udpout")
    options = [
        "--out",
        out,
        "--drone",
        str(DRONE),
        "--rate",
        str(rate_hz),
        "--duration",
        f"{span_s:.1f}",
        "--seed",
        str(seed),
    ]
    if onset_s is not None:
        options += ["--fault", FAULT, "--rotor", str(ROTOR), "--onset", f"{onset_s:.1f}"]
    return subprocess.Popen([sys.executable, "-m", "sitl_plant", "run", *options], stdout=subprocess.DEVNULL)


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clock", choices=("virtual", "real"))
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--cpu-minutes", type=float, default=20.0)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seed", type=int, default=31)
    options = parser.parse_args()
    if options.clock == "virtual":
        virtual(options.hours, 60 * options.cpu_minutes, options.rate, options.seed)
    else:
        real(options.minutes, options.rate, options.seed)


if __name__ == "__main__":
    main()
