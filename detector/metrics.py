"""Figures for Prometheus (edge). Imported only if they are asked for. docs/detector.md lists the figures.

The server's own thread sees only what the loop has handed over, whole; it holds few connections, each for a short time,
so that who begins requests and ends none costs nothing.
"""

import asyncio
import threading
import time
from collections.abc import Callable, Iterable, Iterator

from prometheus_client import CollectorRegistry, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

from detector.fleet import Turn
from detector.states import State
from detector.values import DaemonFigures, VehicleFigures, is_working
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import LinkError
from mavdiag.units import NS_PER_S

CONNECTIONS = 16  # at a time: for a further one the oldest is closed (our choice)
REQUEST_S = 2.0  # for a whole request, and for its answer (our choice)
REQUEST_BYTES = 8192
BOUNDS_S = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.15, 0.2, 0.5, 1.0)  # upper ends of the bins of a latency

#: Each figure: what it says, and its labels. Label sets are bounded by the settings and the registry of monitors.
GAUGES: dict[str, tuple[str, tuple[str, ...]]] = {
    "session_working": ("1 unless all sessions are off; no word about the vehicles.", ()),
    "figures_age_seconds": ("Time since the loop set these figures; 1 at most while it goes on.", ()),
    "late_ticks": ("Looks at the links that came too late.", ()),
    "cpu_seconds": ("Processor time used by the daemon.", ()),
    "datagrams_overflowed": ("Datagrams of the vehicle's link that the system dropped.", ()),
    "turn_delay_seconds": ("Longest that a vehicle waited for its turn in the last second.", ()),
    "link_connected": ("1 if somebody is at the other end, as far as this side can know.", ("link",)),
    "link_sent": ("Messages handed to the system.", ("link",)),
    "link_dropped": ("Messages that could not be sent.", ("link",)),
    "state": ("1 for the state that the session is in.", ("vehicle", "state")),
    "verdict": ("1 for what is held of the vehicle.", ("vehicle", "verdict")),
    "fault": ("Of a fault or an open inspection: 1 while it is seen, 0 when not.", ("vehicle", "kind", "rotor")),
    "frames_received": ("Frames received from the autopilot.", ("vehicle",)),
    "frames_lost": ("Frames lost on the way, by their sequence numbers.", ("vehicle",)),
    "stream_hertz": ("Measured rate of a stream.", ("vehicle", "stream")),
    "judged_seconds": ("Flight time judged.", ("vehicle",)),
    "judged_share": ("Flight time judged, of all flight time of this session.", ("vehicle",)),
    "statistic_ratio": ("Statistic over threshold; absent while it is not valid.", ("vehicle", "monitor", "axis")),
    "timesync_round_trip_seconds": ("Round trip of the latest TIMESYNC, to within a look.", ("vehicle",)),
    "clock_drift_ppm": ("Drift between the clocks of the vehicle's messages, where there are two.", ("vehicle",)),
}
COUNTERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "entries_lost": ("Entries that could not be written.", ("file",)),
    "frames_refused": ("Frames that were not heard.", ("cause",)),
    "events": ("Alarms of the monitors.", ("vehicle", "monitor")),
}
Sample = tuple[str, tuple[str, ...], float]


class Metrics(Collector):
    """Serves http://HOST:PORT/metrics. Raises LinkError if the port cannot be had."""

    def __init__(self, host: str, port: int) -> None:
        # All figures of a moment, and that moment (monotonic clock); nothing changes them.
        self._shown: tuple[DaemonFigures, int] | None = None
        registry = CollectorRegistry()
        text = "From the arrival of the first gyro sample that is judged at once to its verdict."
        self._latency = Histogram("mavdiag_verdict_latency_seconds", text, buckets=BOUNDS_S, registry=registry)
        registry.register(self)
        try:
            self._server = _Server(host, port, lambda: generate_latest(registry))
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", "") or error
            raise LinkError(f"metrics on {host}:{port}: {reason}; name another --metrics HOST:PORT") from error
        self.port, self.close = self._server.port, self._server.close  # the port that was really bound

    def show(self, figures: DaemonFigures, now_ns: int) -> None:
        """Hand all figures over. now_ns: monotonic clock."""
        self._shown = (figures, now_ns)

    def observe(self, turns: Iterable[Turn]) -> None:
        """Count how long what was judged waited."""
        for turn in turns:
            if turn.latency_s is not None:
                self._latency.observe(turn.latency_s)

    def collect(self) -> Iterator[Metric]:
        """All figures, as Prometheus asks for them (from its own thread)."""
        if self._shown is None:
            return
        figures, at_ns = self._shown
        families: dict[str, GaugeMetricFamily | CounterMetricFamily] = {}
        families |= {name: GaugeMetricFamily(f"mavdiag_{name}", text, labels=of) for name, (text, of) in GAUGES.items()}
        families |= {n: CounterMetricFamily(f"mavdiag_{n}", text, labels=of) for n, (text, of) in COUNTERS.items()}
        age_s = (time.monotonic_ns() - at_ns) / NS_PER_S
        for name, values, value in _daemon(figures, age_s):
            families[name].add_metric(values, value)
        yield from families.values()


def _daemon(figures: DaemonFigures, age_s: float) -> Iterator[Sample]:
    yield "session_working", (), is_working([vehicle.state for vehicle in figures.vehicles])
    yield "figures_age_seconds", (), age_s
    yield "late_ticks", (), figures.late
    yield "cpu_seconds", (), figures.cpu_s
    yield "datagrams_overflowed", (), figures.links[0].traffic.overflowed
    yield "turn_delay_seconds", (), figures.delay_s
    for file, count in figures.lost_entries:
        yield "entries_lost", (file,), count
    for cause, count in figures.refused:
        yield "frames_refused", (cause,), count
    for number, link in enumerate(figures.links):
        label = ("vehicle" if number == 0 else f"behind {number} {link.address}",)
        yield "link_connected", label, link.connected
        yield "link_sent", label, link.traffic.sent
        yield "link_dropped", label, link.traffic.dropped
    for vehicle in figures.vehicles:
        for name, labels, value in _vehicle(vehicle):
            yield name, (str(vehicle.vehicle), *labels), value


def _vehicle(vehicle: VehicleFigures) -> Iterator[Sample]:
    held = vehicle.diagnosis
    for state in State:
        yield "state", (state.value,), state is vehicle.state
    for stage in Stage:
        yield "verdict", (stage.value,), stage is held.stage
    if held.kind is not None:
        for rotor in dict.fromkeys(span.rotor for span in held.rotors) or ("",):
            yield "fault", (held.kind, str(rotor)), held.seen and rotor in (held.rotor, "")
    yield "frames_received", (), vehicle.received
    yield "frames_lost", (), vehicle.lost
    for stream, hertz in vehicle.rates:
        yield "stream_hertz", (stream,), hertz
    yield "judged_seconds", (), vehicle.judged_s
    if vehicle.flight_s > 0:
        yield "judged_share", (), min(1.0, vehicle.judged_s / vehicle.flight_s)
    for monitor, count in vehicle.alarms.items():
        yield "events", (monitor,), count
    for monitor, axis, ratio in vehicle.ratios:
        yield "statistic_ratio", (monitor, axis), ratio
    if vehicle.round_trip_s is not None:
        yield "timesync_round_trip_seconds", (), vehicle.round_trip_s
    if vehicle.drift_ppm is not None:
        yield "clock_drift_ppm", (), vehicle.drift_ppm


class _Server:
    """A port that answers every GET with one page, on a thread of its own. Raises OSError if the port cannot be had."""

    def __init__(self, host: str, port: int, page: Callable[[], bytes]) -> None:
        self._page = page
        self._begun: dict[asyncio.StreamWriter, None] = {}  # connections, the oldest first
        self._loop = asyncio.new_event_loop()
        try:
            listening = asyncio.start_server(self._serve, host, port, limit=REQUEST_BYTES, backlog=64)
            self._server = self._loop.run_until_complete(listening)
        except (OSError, UnicodeError):
            self._loop.close()
            raise
        self.port = int(self._server.sockets[0].getsockname()[1])
        self._thread = threading.Thread(target=self._loop.run_forever, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=REQUEST_S + 1.0)
        self._server.close()
        while asyncio.all_tasks(self._loop):  # cancelled, they would be logged as errors
            for writer in self._begun:
                writer.transport.abort()
            self._loop.run_until_complete(asyncio.sleep(0.0))
        self._loop.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while len(self._begun) >= CONNECTIONS:
            self._drop(next(iter(self._begun)))
        self._begun[writer] = None
        try:
            async with asyncio.timeout(REQUEST_S):
                request = await reader.readuntil(b"\r\n\r\n")
                good = request.startswith(b"GET ")
                status, body = ("200 OK", self._page()) if good else ("405 Method Not Allowed", b"")
                head = f"HTTP/1.1 {status}\r\nContent-Type: {CONTENT_TYPE_LATEST}\r\nContent-Length: {len(body)}\r\n"
                writer.write(head.encode() + b"Connection: close\r\n\r\n" + body)
                await writer.drain()
        except (OSError, TimeoutError, EOFError, asyncio.LimitOverrunError):
            pass  # no request, or a reader that is gone or slow
        finally:
            self._drop(writer)

    def _drop(self, writer: asyncio.StreamWriter) -> None:
        if writer in self._begun:
            del self._begun[writer]
            writer.close()
