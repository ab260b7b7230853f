"""The emulator and the daemon in one process, on one virtual clock: minutes of flight in seconds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from unittest.mock import patch

from made_baselines import kept
from made_vehicle import TICK_S, Bench

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Component, MavCmd, MessageId
from mavdiag.link.ports import Endpoint
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.emulator import Link, fly
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

LEAST_S = 1e-5  # so that no rounding stops the clock
CREATED = "2026-01-01T00:00:00Z"


@dataclass
class GroundStation:
    """A ground station on the vehicle's link that sets rates every so often, as MAVProxy does. times: when [s]."""

    requests: Callable[[Encoder], list[bytes]]
    every_s: float = 10.0
    encoder: Encoder = field(default_factory=lambda: Encoder(255, Component.MISSIONPLANNER))
    times: list[float] = field(default_factory=list)

    def due(self, t_s: float) -> list[bytes]:
        """What it sends at a time."""
        if t_s < self.every_s * (1 + len(self.times)):
            return []
        self.times.append(t_s)
        return self.requests(self.encoder)

    @classmethod
    def of(cls, *messages: int) -> "GroundStation":
        """Each message by SET_MESSAGE_INTERVAL; without any all groups by REQUEST_DATA_STREAM: MAVProxy's 4 Hz."""
        all_ = (MessageId.REQUEST_DATA_STREAM, 1, 1, 0, 4, 1)
        each = (MessageId.COMMAND_LONG, 1, 1, MavCmd.SET_MESSAGE_INTERVAL, 0)
        return cls(lambda one: [one.encode(*each, msgid, 250e3) for msgid in messages] or [one.encode(*all_)])


class VirtualFlight:
    """A flight whose messages reach a bench's daemon. judged_s: once a second, what was judged so far [s]."""

    def __init__(self, bench: Bench, station: GroundStation | None = None) -> None:
        self._bench, self._station, self._host = bench, station, bench.host
        self._start_ns = self._next_ns = bench.host.ns
        self.judged_s: list[tuple[float, float]] = []

    @property
    def t_s(self) -> float:
        """Time since the beginning."""
        return (self._host.ns - self._start_ns) / NS_PER_S

    def monotonic(self) -> float:
        """The virtual clock, in place of `time.monotonic`."""
        return self._host.ns / NS_PER_S

    process_time = monotonic

    def sleep(self, span_s: float) -> None:
        """Let time pass; the daemon looks at its links when it is time."""
        until_ns = self._host.ns + round(span_s * NS_PER_S)
        while self._next_ns <= until_ns:
            self._host.ns = self._next_ns
            self._next_ns += round(TICK_S * NS_PER_S)
            for request in self._station.due(self.t_s) if self._station else []:
                self._bench.open[0].send(request)
            self._bench.daemon.tick()
            if self.t_s >= len(self.judged_s):
                vehicles = self._bench.daemon.fleet.vehicles.values()
                self.judged_s.append((self.t_s, sum(vehicle.judged_s for vehicle in vehicles)))
        self._host.ns = until_ns

    def wait(self, endpoints: Sequence[Endpoint], span_s: float) -> list[Endpoint]:
        """In place of `wait` of the ports: time passes, then every link is served."""
        self.sleep(max(span_s, LEAST_S))
        return list(endpoints)

    def fly(
        self,
        config: PlantConfig,
        seconds: float,
        profile: str = "ardupilot",
        rate_hz: float | None = None,
        stop: Callable[[], bool] = lambda: False,
        watch: Callable[[PlantSamples], None] = lambda samples: None,
        plant_of: Callable[[PlantConfig], Plant] = Plant,
    ) -> None:
        """Fly in virtual real time. stop, watch: as of the emulator. plant_of: makes what is flown."""
        plant, dialect = plant_of(config), dialect_named(profile)
        link = Link(self._bench.far, dialect, rate_hz, plant.rotors)
        with patch("sitl_plant.emulator.time", self), patch("sitl_plant.emulator.wait", self.wait):
            fly(plant, dialect, [link], duration_s=seconds, speed=1.0, stop=stop, watch=watch)


def healthy_flights(
    seeds: Sequence[int], seconds: float, profile: str = "ardupilot", rate_hz: float | None = None, **config: object
) -> list[Log]:
    """Flights to learn from, as the link brings them."""
    logs = []
    for seed in seeds:
        telemetry, _ = flight_telemetry(PlantConfig(seed=seed, **config), seconds, LinkSpec(profile, rate_hz))  # type: ignore[arg-type]  # of several types
        logs.append(Log(f"seed {seed}", telemetry.digest, profile, telemetry))
    return logs


def learnt(logs: Sequence[Log], airframe: Airframe | None = None) -> Baseline:
    """A baseline of the emulated vehicle. airframe: None for that of the QDrone 2."""
    options = LearnOptions(airframe=airframe or airframe_named("qdrone2"))
    return kept(" ".join(log.sha256 for log in logs), lambda: learn(list(logs), options, created=CREATED))


def taught(seeds: Sequence[int], seconds: float, profile: str = "ardupilot", **config: object) -> Baseline:
    """What `healthy_flights` teach, which are flown only where that is not kept yet."""
    key = f"{seeds} {seconds} {profile} {config}"
    return kept(key, lambda: learnt(healthy_flights(seeds, seconds, profile, None, **config)))
