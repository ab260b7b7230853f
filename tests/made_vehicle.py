"""A made vehicle on an in-memory link, and a daemon on a virtual clock that receives it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from memory_port import MemoryEndpoint, memory_pair

from detector.config import Settings
from detector.daemon import Daemon, Host
from detector.fitting import ProcessFitter
from detector.flights import Flights
from detector.hooks import Hook
from detector.journal import Journal, Recorder
from detector.metrics import Metrics
from detector.notify import Notifier
from detector.values import FitOutcome, Learn
from detector.web.feed import Feed
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline
from mavdiag.inspections import Inspections
from mavdiag.link.codec import Decoder, Encoder, Frame, frame_length
from mavdiag.link.keys import KeptSigning
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId, ModeFlag
from mavdiag.link.ports import Endpoint
from mavdiag.logs.tlog import tlog_record
from mavdiag.units import NS_PER_S

__all__ = ["Bench", "FakeFitter", "MadeVehicle", "VirtualHost", "record"]

START_NS = 1000 * NS_PER_S
EPOCH_NS = 1_777_600_000 * NS_PER_S
RATE_HZ = 100
TICK_S = 0.04


class VirtualHost(Host):
    """Clocks that stand still until they are moved; log lines are kept. ahead: of the wall clock."""

    tidy = staticmethod(lambda place: 0)

    def __init__(self) -> None:
        self.lines: list[str] = []
        super().__init__(self.lines.append)
        self.ns, self.cpu, self.ahead = START_NS, 0.0, timedelta(0)

    def now_ns(self) -> int:
        return self.ns

    def utc(self) -> datetime:
        return datetime(2026, 5, 1, tzinfo=UTC) + timedelta(seconds=(self.ns - START_NS) / NS_PER_S) + self.ahead

    def cpu_s(self) -> float:
        return self.cpu

    def sleep(self, span_s: float) -> None:
        self.ns += round(span_s * NS_PER_S)


class FakeFitter(ProcessFitter):
    """Answers every job with what it was given, two looks later."""

    def __init__(self, outcome: FitOutcome | None = None) -> None:
        self.outcome = outcome  # without the thread of the real one
        self.begun: list[int] = []
        self._looks: list[tuple[int, int]] = []

    def begin(self, vehicle: int, airframe: Airframe, flight: Learn, accept: bool = False) -> None:
        self.begun.append(vehicle)
        self._looks.append((2, vehicle))

    def poll(self) -> list[tuple[int, FitOutcome]]:
        self._looks = [(looks - 1, vehicle) for looks, vehicle in self._looks]
        done = [(vehicle, self.outcome) for looks, vehicle in self._looks if looks <= 0 and self.outcome is not None]
        self._looks = [one for one in self._looks if one[0] > 0]
        return done

    def close(self) -> None: ...


class MadeVehicle:
    """Sends heartbeats and the two main streams, hovering with random set-points it follows at once."""

    def __init__(self, sysid: int, autopilot: Autopilot = Autopilot.GENERIC, kind: int = MavType.QUADROTOR) -> None:
        self.encoder = Encoder(sysid, Component.AUTOPILOT1)
        self.sysid, self._autopilot, self._kind = sysid, autopilot, kind
        self._rng = np.random.default_rng(sysid)
        self.sent = 0  # samples
        self.armed, self.custom_mode = True, 0
        self.turning = 0.0  # rad/s about roll that no set-point asked for

    def heartbeat(self) -> bytes:
        mode = ModeFlag.CUSTOM_MODE_ENABLED | (ModeFlag.SAFETY_ARMED if self.armed else 0)
        return self.encoder.encode(MessageId.HEARTBEAT, self._kind, self._autopilot, mode, self.custom_mode, 4, 3)

    def samples(self, count: int) -> list[bytes]:
        """The next samples of both streams, with a heartbeat every second."""
        frames: list[bytes] = []
        for _ in range(count):
            if self.sent % RATE_HZ == 0:
                frames.append(self.heartbeat())
            t_ms = 5000 + self.sent * 1000 // RATE_HZ
            frames.append(self.encoder.encode(MessageId.ATTITUDE_TARGET, t_ms, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5))
            gyro = self._rng.normal([1e3 * self.turning, 0.0, 0.0], 5.0).tolist()  # mrad/s
            frames.append(self.encoder.encode(MessageId.RAW_IMU, 1000 * t_ms, 0, 0, -1000, *gyro))
            self.sent += 1
        return frames

    def position(self) -> list[bytes]:
        """Where it is, ten times a second: on a circle of 5 m that takes it a minute."""
        if self.sent % (RATE_HZ // 10):
            return []
        turn = math.tau * self.sent / RATE_HZ / 60
        place = (5 * math.sin(turn), 5 - 5 * math.cos(turn), -1.0)
        return [self.encoder.encode(MessageId.LOCAL_POSITION_NED, 5000 + self.sent * 1000 // RATE_HZ, *place, 0, 0, 0)]


def record(path: Path, spans: Sequence[tuple[float, float]], sysid: int = 1) -> None:
    """Write a flight as a .tlog. spans: how long [s], and how fast it turns about roll though nobody asked [rad/s]."""
    vehicle, data = MadeVehicle(sysid), bytearray()
    for span_s, turning in spans:
        vehicle.turning = turning
        for _ in range(round(span_s * RATE_HZ)):
            time_us = EPOCH_NS // 1000 + vehicle.sent * 1_000_000 // RATE_HZ
            for frame in (*vehicle.samples(1), *vehicle.position()):
                data += tlog_record(time_us, frame)
    path.write_bytes(data)


def recorded(path: Path, most_s: float = math.inf) -> Iterator[tuple[bytes, int]]:
    """Frame and time [ns] of each record at the beginning of a .tlog."""
    data, at = path.read_bytes(), 0
    until_us = int.from_bytes(data[:8], "big") + 1e6 * most_s
    while at + 10 < len(data) and (time_us := int.from_bytes(data[at : at + 8], "big")) < until_us:
        length = frame_length(data, at + 8)
        assert length is not None
        yield data[at + 8 : at + 8 + length], 1000 * time_us
        at += 8 + length


@dataclass
class Bench:
    """A daemon on a memory link. far: the vehicle's end; behind: the far ends of the links behind the daemon."""

    settings: Settings
    baseline: Baseline | None = None
    fitter: FakeFitter = field(default_factory=FakeFitter)
    journal: Path | None = None
    record: Path | None = None
    airframe: Airframe | None = None
    baselines: dict[int | str, Baseline] = field(default_factory=dict)
    flights: Flights | None = None
    notifier: Notifier | None = None
    metrics: Metrics | None = None
    web: Feed | None = None
    inspections: Inspections | None = None
    hooks: tuple[Hook, ...] = ()
    links_behind: int = 0
    host: VirtualHost = field(default_factory=VirtualHost)
    vehicles: list[MadeVehicle] = field(default_factory=list)

    def __post_init__(self) -> None:
        near, self.far = memory_pair(clock=self.host.now_ns)
        pairs = [memory_pair(clock=self.host.now_ns) for _ in range(self.links_behind)]
        self.behind: list[MemoryEndpoint] = [far for _, far in pairs]
        self.open: list[Endpoint] = [near, self.far, *(end for pair in pairs for end in pair)]
        self.recorder = None if self.record is None else Recorder(self.record, self.host.say)
        self.file = None if self.journal is None else Journal(self.journal, self.host.say)
        self.daemon = self.another([near, *(near for near, _ in pairs)])
        self.daemon.begin()

    def another(self, links: Sequence[Endpoint], signing: KeptSigning | None = None) -> Daemon:
        """A daemon on these links, of which the first is the vehicle's."""
        names = ("baseline", "fitter", "airframe", "hooks", "flights", "baselines", "notifier", "metrics", "web")
        given: dict[str, Any] = {name: getattr(self, name) for name in (*names, "inspections")}
        given |= {"journal": self.file, "recorder": self.recorder, "signing": signing}
        return Daemon(self.settings, self.host, links[0], links[1:], **given)

    def run(self, seconds: float) -> None:
        """Let time pass in ticks; every vehicle sends."""
        for _ in range(round(seconds / TICK_S)):
            for vehicle in self.vehicles:
                for frame in vehicle.samples(round(TICK_S * RATE_HZ)):
                    self.far.send(frame)
            self.host.sleep(TICK_S)
            self.daemon.tick()

    def close(self) -> None:
        self.daemon.end()
        for file in (self.file, self.recorder):
            if file is not None:
                file.close()
        for end in self.open:
            end.close()


def received(endpoint: Endpoint) -> list[Frame]:
    decoder = Decoder()
    return [frame for data, host_ns in endpoint.receive(0.0) for frame in decoder.feed(data, host_ns)]
