"""The run loop (edge): fly in real time, send each message when its time has come, receive and answer in between.
Or a flight as a .tlog file, as fast as it goes.

The plant is computed a short block ahead; within a block messages go out in ticks, never before their time. So a
message is late by at most one tick and by what the machine adds, and the report says how much that was.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.messages import Component
from mavdiag.link.ports import Endpoint, wait
from mavdiag.link.signing import Signing
from mavdiag.logs.tlog import tlog_record
from mavdiag.storage import replacing
from sitl_plant.autopilot.commands import Autopilot
from sitl_plant.autopilot.dialect import Dialect
from sitl_plant.autopilot.stream import FilteredSamples, ImuFilters, Message, messages_due
from sitl_plant.autopilot.wire import Action, Reply
from sitl_plant.options import FlightPlan
from sitl_plant.plant import STEP_NS, Plant, PlantSamples

EPOCH_US = 1_767_225_600_000_000  # of records, 2026-01-01T00:00:00Z: equal options give equal files
RECORD_STEPS = 1000
BLOCK_S, TICK_S = 0.020, 0.002  # wall clock: how far ahead the plant is computed, how often messages go out
SLIP_S = 0.5  # later than this, the flight's clock is set back: the machine slept or is too slow
SENDERS_MAX = 32  # senders whose messages are passed on by one link, each with its own sequence numbers


@dataclass(frozen=True, slots=True)
class FlightReport:
    """How a flight went on the wire."""

    flown_s: float
    wall_s: float
    cpu_s: float
    messages: int
    dropped: int
    received: int  # messages
    late_max_ms: float  # how long after its time a tick went out, at most
    slips: int  # how often the clock was set back, see `SLIP_S`


class Link:
    """One link of the emulated vehicle: an endpoint, its schedule and sequence numbers, and what waits to be sent.

    signing: signs what is sent, and refuses what is not signed; None for a link without.
    fresh: nothing is sent but what the real autopilot sends unasked.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        dialect: Dialect,
        rate_hz: float | None,
        rotors: int = 4,
        signing: Signing | None = None,
        *,
        fresh: bool = False,
    ) -> None:
        self.endpoint = endpoint
        self.schedule = dialect.schedule(rate_hz, rotors, fresh)
        self._signing = signing
        self._encoder = Encoder(dialect.sysid, Component.AUTOPILOT1, signing)
        self._decoder = Decoder(signing=signing)
        self._senders: dict[tuple[int, int], Encoder] = {}
        self._waiting: deque[Message] = deque()

    def receive(self) -> list[Frame]:
        """What came in since the last time."""
        return list(self._decoder.take(self.endpoint.receive(0.0), datagrams=self.endpoint.datagrams))

    def queue(self, filtered: FilteredSamples, dialect: Dialect) -> None:
        """Make the messages of a block; they wait for their time."""
        self._waiting.extend(messages_due(filtered, self.schedule, dialect))

    def send_due(self, t_ns: int) -> int:
        """Send what is due at flight time `t_ns`; returns how many messages that were."""
        waiting, send, encode, sent = self._waiting, self.endpoint.send, self._encoder.encode_payload, 0
        while waiting and waiting[0].t_ns <= t_ns:
            _, msgid, payload = waiting.popleft()
            send(encode(msgid, payload))
            sent += 1
        return sent

    def act(self, action: Action) -> None:
        """Send an answer, or pass a frame on in its sender's name."""
        if isinstance(action, Reply):
            self.endpoint.send(self._encoder.encode(action.msgid, *action.fields))
            return
        frame = action.frame
        source = (frame.sysid, frame.compid)
        if source not in self._senders and len(self._senders) < SENDERS_MAX and 0 not in source:
            self._senders[source] = Encoder(*source, self._signing)
        if source in self._senders:
            self.endpoint.send(self._senders[source].encode_payload(frame.msgid, frame.payload))


def fly(
    plant: Plant,
    dialect: Dialect,
    links: Sequence[Link],
    *,
    duration_s: float | None,
    speed: float | None,
    stop: Callable[[], bool],
    watch: Callable[[PlantSamples], None] = lambda samples: None,
    slip: Callable[[float], None] = lambda late_s: None,
) -> FlightReport:
    """Fly until `duration_s` of flight time has passed (None: for ever) or `stop` says so.

    speed: flight seconds a second, None for as fast as it goes. watch: is shown every block's truth.
    slip: is told by how much the flight's clock was set back [s], see `SLIP_S`.
    """
    started_s, started_cpu_s, filters = time.monotonic(), time.process_time(), ImuFilters(dialect, plant.config.seed)
    autopilot = Autopilot([link.schedule for link in links], dialect, plant.config)
    endpoints, messages, received = [link.endpoint for link in links], 0, 0
    zero_s, late_max_s, slips = started_s - plant.t_ns * 1e-9 / (speed or 1.0), 0.0, 0

    def serve(index: int, now_ns: int) -> None:
        nonlocal received
        for frame in links[index].receive():
            received += 1
            act(autopilot.step(index, frame, now_ns))

    def act(actions: Iterable[Action]) -> None:
        for action in actions:
            links[action.link].act(action)

    steps = max(1, round(BLOCK_S * (speed or 10.0) * 1e9 / STEP_NS))
    tick_ns = max(STEP_NS, round(TICK_S * (speed or 10.0) * 1e9))
    end_ns = round(duration_s * 1e9) if duration_s is not None else 1 << 62
    while plant.t_ns < end_ns and not stop():
        from_ns = plant.t_ns
        filtered = filters.step(plant.advance(min(steps, -((from_ns - end_ns) // STEP_NS))))
        watch(filtered.samples)
        for index, link in enumerate(links):
            link.queue(filtered, autopilot.dialect)
            serve(index, from_ns)  # also lets an endpoint reconnect that has nothing to wait for
        for t_ns in [*range(from_ns + tick_ns, plant.t_ns, tick_ns), plant.t_ns]:
            due_s = zero_s + t_ns * 1e-9 / speed if speed else time.monotonic()
            while (left_s := due_s - time.monotonic()) > 0.001:
                for endpoint in wait(endpoints, left_s - 0.001):
                    serve(endpoints.index(endpoint), t_ns)
            if left_s > 0:
                time.sleep(left_s)
            messages += sum(link.send_due(t_ns) for link in links)
            late_s = time.monotonic() - due_s
            late_max_s = max(late_max_s, late_s)
            if late_s > SLIP_S:
                zero_s, slips = zero_s + late_s, slips + 1
                slip(late_s)
        actions, orders = autopilot.watch(filtered.samples)
        act(actions)
        for order in orders:
            order(plant)
    spans_s = plant.t_ns * 1e-9, time.monotonic() - started_s, time.process_time() - started_cpu_s
    dropped = sum(one.traffic.dropped for one in endpoints)
    return FlightReport(*spans_s, messages, dropped, received, 1e3 * late_max_s, slips)


def recorded(plan: FlightPlan, duration_s: float, watch: Callable[[PlantSamples], None]) -> Iterator[tuple[int, bytes]]:
    """Every frame of a flight in order, with its flight time [ns]. watch: is shown every block's truth."""
    plant, filters = Plant(plan.config), ImuFilters(plan.dialect, plan.config.seed)
    schedule = plan.dialect.schedule(plan.rate_hz, plant.rotors)
    encoder = Encoder(plan.dialect.sysid, Component.AUTOPILOT1)
    left = max(1, round(duration_s * 1e9 / STEP_NS))
    while left > 0:
        samples = plant.advance(min(RECORD_STEPS, left))
        left -= len(samples)
        watch(samples)
        for t_ns, msgid, payload in messages_due(filters.step(samples), schedule, plan.dialect):
            yield t_ns, encoder.encode_payload(msgid, payload)


def record_flight(path: Path, plan: FlightPlan, duration_s: float, watch: Callable[[PlantSamples], None]) -> int:
    """Write a flight to a .tlog file; returns its message count. Raises UsageError if the file cannot be written."""
    with replacing(path) as file:
        frames = recorded(plan, duration_s, watch)
        return sum(file.write(tlog_record(EPOCH_US + t_ns // 1000, frame)) > 0 for t_ns, frame in frames)
