"""The emulated vehicle in virtual time at the end of a link: who receives lets it fly on. Its pilot obeys texts."""

import math
from collections.abc import Callable, Iterable

import numpy as np
from memory_port import memory_pair

from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.layout import Argument
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.link.ports.base import Chunk, Endpoint
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.commands import Autopilot
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.stream import ImuFilters, to_global
from sitl_plant.emulator import Link, obey
from sitl_plant.plant import STEP_NS, Plant, PlantConfig

NAN = float("nan")
CORNERS = ((1.5, 1.5), (1.5, -1.5), (-1.5, -1.5), (-1.5, 1.5))  # m, of the square
AIRBORNE_M = -0.3  # down
TASKS = {"take off": 30.0, "hover": 60.0, "square": 2.6, "nose": 2.5, "land": 60.0}  # how often an order goes out [s]
START_NS = 1000 * NS_PER_S


class Clock:
    """In place of the module `time`: it stands still until the vehicle flies on."""

    def __init__(self) -> None:
        self.ns = START_NS

    def monotonic_ns(self) -> int:
        return self.ns

    def time_ns(self) -> int:
        return 1_777_600_000 * NS_PER_S + self.ns

    def monotonic(self) -> float:
        return self.ns / NS_PER_S

    def time(self) -> float:
        return self.time_ns() / NS_PER_S


class Pilot:
    """Flies by MAVLink commands what a coach's texts say. send: takes the frames. task: what was said last."""

    def __init__(self, profile: str, send: Callable[[bytes], object]) -> None:
        self.task, self._profile, self._send = "", profile, send
        self._station, self._next_s, self._step = Encoder(255, 190), 0.0, 0

    def hear(self, text: str) -> None:
        """Note a task; a task that is said again is gone on with."""
        task = next((task for task in TASKS if f"now {task}" in text), self.task)
        self._next_s = self._next_s if task == self.task else 0.0
        self.task = task

    def fly(self, now_s: float) -> None:
        """Do what is due. now_s: the vehicle's time."""
        if self.task and now_s >= self._next_s:
            self._next_s, self._step = now_s + TASKS[self.task], self._step + 1
            match self.task:
                case "take off":
                    self._take_off()
                case "square":
                    self._go(*CORNERS[self._step % 4], 0.0)
                case "nose":
                    self._go(0.0, 0.0, math.pi / 2 * (self._step % 4))
                case "hover":
                    self._go(0.0, 0.0, 0.0)
                case "land":
                    self._command(MavCmd.NAV_LAND)

    def _take_off(self) -> None:
        if self._profile == "ardupilot":
            self._order(MessageId.SET_MODE, 1, 1, 4)
        self._command(MavCmd.COMPONENT_ARM_DISARM, 1)
        height = NAN if self._profile == "px4" else 2.0
        self._command(MavCmd.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, height)

    def _go(self, north: float, east: float, yaw: float) -> None:
        latitude, longitude, _ = to_global(np.array([[north, east, 0.0]]))[0].tolist()
        place = (round(latitude * 1e7), round(longitude * 1e7), 2.0)
        self._order(MessageId.COMMAND_INT, 1, 1, 6, MavCmd.DO_REPOSITION, 0, 0, 1.5, 0.0, 0.0, yaw, *place)

    def _command(self, command: int, *parameters: float) -> None:
        self._order(MessageId.COMMAND_LONG, 1, 1, command, 0, *parameters)

    def _order(self, msgid: int, *fields: Argument) -> None:
        self._send(self._station.encode(msgid, *fields))


class PilotedVehicle(Endpoint):
    """The near end of the vehicle's link. To receive for some time lets it fly for so long.

    deaf: it hears its pilot only. flown_s: in the air so far.
    """

    datagrams = True
    sources = ()

    def __init__(self, profile: str, clock: Clock, *, deaf: bool = False, seed: int = 0) -> None:
        super().__init__("memory:near")
        self.clock, self.flown_s, self._deaf, dialect = clock, 0.0, deaf, dialect_named(profile)
        flight = PlantConfig(trajectory="commanded", start="ground", seed=seed)
        self.plant, self._filters = Plant(flight), ImuFilters(dialect, flight.seed)
        self._near, far = memory_pair(clock=clock.monotonic_ns)
        self._link = Link(far, dialect, None, self.plant.rotors, fresh=True)
        self.autopilot = Autopilot([self._link.schedule], dialect, flight)
        self.pilot = Pilot(profile, lambda data: self._take(Decoder().feed(data, 0)))

    @property
    def connected(self) -> bool:
        return True

    def filenos(self) -> tuple[int, ...]:
        return ()

    def send(self, data: bytes) -> None:
        self._near.send(data)

    def close(self) -> None:
        """It flies on."""

    def _drain(self) -> list[Chunk]:
        return self._near.receive(0.0)

    def receive(self, timeout_s: float) -> list[Chunk]:
        """Let the vehicle fly on; what it sent."""
        steps = max(1, round(timeout_s * NS_PER_S / STEP_NS))
        filtered = self._filters.step(self.plant.advance(steps))
        self.clock.ns += steps * STEP_NS
        heard = self._link.receive()
        self._take([] if self._deaf else heard)
        self._link.queue(filtered, self.autopilot.dialect)
        self._link.send_due(self.plant.t_ns)
        actions, orders = self.autopilot.watch(filtered.samples)
        for action in actions:
            self._link.act(action)
        for order in orders:
            obey(self.plant, order)
        self.flown_s += timeout_s * bool(filtered.samples.position[-1, 2] < AIRBORNE_M)
        self.pilot.fly(self.plant.t_ns / NS_PER_S)
        return self._drain()

    def _take(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            for action in self.autopilot.step(0, frame, self.plant.t_ns):
                self._link.act(action)
