"""Figures for Prometheus (edge). Imported only if they are asked for.

Label sets are bounded: vehicles by the setting `max_vehicles`, monitors by the registry, links and files by the
settings. docs/detector.md lists the figures. The server's own thread sees only what the loop has handed over, whole; it
holds few connections, each for a short time, so that who begins requests and ends none costs nothing.
"""

import contextlib
import itertools
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

from detector.figures import DaemonFigures
from detector.fleet import Turn
from detector.latency import BOUNDS_S, LatencyCounts
from detector.states import State
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import LinkError
from mavdiag.units import NS_PER_S

__all__ = ["Metrics"]


CONNECTIONS = 16  # at a time: for a further one the oldest is closed (our choice)
REQUEST_S = 2.0  # for a whole request, and for its answer (our choice)
REQUEST_BYTES = 8192


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """All figures at a moment, which nothing changes any more. at_ns: that moment, monotonic clock."""

    figures: DaemonFigures
    at_ns: int
    events: Mapping[tuple[str, str], int]
    look: LatencyCounts
    verdict: LatencyCounts


class Metrics(Collector):
    """Serves http://HOST:PORT/metrics. Raises LinkError if the port cannot be had."""

    def __init__(self, host: str, port: int) -> None:
        self._shown: _Shown | None = None
        self._events: Counter[tuple[str, str]] = Counter()
        self._look, self._verdict = LatencyCounts(), LatencyCounts()
        registry = CollectorRegistry()
        registry.register(self)
        try:
            self._server = _Server(host, port, lambda: generate_latest(registry))
        except OSError as error:
            raise LinkError(
                f"metrics on {host}:{port}: {error.strerror or error}; name another --metrics HOST:PORT"
            ) from error

    @property
    def port(self) -> int:
        """The port that was really bound."""
        return self._server.port

    def show(self, figures: DaemonFigures, now_ns: int) -> None:
        """Hand all figures over. now_ns: monotonic clock."""
        self._shown = _Shown(figures, now_ns, dict(self._events), self._look.copy(), self._verdict.copy())

    def count_event(self, vehicle: int, monitor: str) -> None:
        """One more alarm."""
        self._events[str(vehicle), monitor] += 1

    def observe(self, turns: Iterable[Turn], now_ns: int) -> None:
        """Count how long the samples of a look waited. now_ns: its end, monotonic clock."""
        for turn in turns:
            self._look.add(turn.arrived_ns, now_ns)
            self._verdict.add(turn.judged_ns, now_ns)

    def close(self) -> None:
        """Stop serving."""
        self._server.close()

    def collect(self) -> Iterator[Metric]:
        """All figures, as Prometheus asks for them (from its own thread)."""
        shown = self._shown
        if shown is None:
            return
        figures = shown.figures
        age_s = (time.monotonic_ns() - shown.at_ns) / NS_PER_S
        yield _gauge(
            "session_working", "1 unless all sessions are off; no word about the vehicles.", float(figures.working)
        )
        yield _gauge("figures_age_seconds", "Time since the loop set these figures; 1 at most while it goes on.", age_s)
        yield _gauge("late_ticks", "Looks at the links that came too late.", figures.late)
        yield _gauge("cpu_seconds", "Processor time used by the daemon.", figures.cpu_s)
        overflowed = figures.links[0].traffic.overflowed
        yield _gauge("datagrams_overflowed", "Datagrams of the vehicle's link that the system dropped.", overflowed)
        lost = CounterMetricFamily("mavdiag_entries_lost", "Entries that could not be written.", labels=["file"])
        for name, count in figures.lost_entries:
            lost.add_metric([name], count)
        yield lost
        refused = CounterMetricFamily("mavdiag_frames_refused", "Frames that were not heard.", labels=["cause"])
        for cause, count in figures.refused:
            refused.add_metric([cause], count)
        yield refused
        text = "Longest that a vehicle waited for its turn in the last second; one look, unless there is much to do."
        yield _gauge("turn_delay_seconds", text, figures.delay_s)
        yield from _links(figures)
        yield from _vehicles(figures)
        events = CounterMetricFamily("mavdiag_events", "Alarms of the monitors.", labels=["vehicle", "monitor"])
        for (vehicle, monitor), count in shown.events.items():
            events.add_metric([vehicle, monitor], count)
        yield events
        yield _histogram("look_latency", "From the arrival of a gyro sample to the end of its look.", shown.look)
        yield _histogram("verdict_latency", "From the arrival of a gyro sample to its verdict.", shown.verdict)


class _Server:
    """A port that answers every GET with one page, on a thread of its own. Raises OSError if the port cannot be had."""

    def __init__(self, host: str, port: int, page: Callable[[], bytes]) -> None:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        self._listener, self._page = socket.create_server((host, port), family=family, backlog=64), page
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._begun: dict[socket.socket, tuple[float, bytes]] = {}  # the oldest first: its deadline, what came so far
        self._selector = selectors.DefaultSelector()
        self._wake, self._woken = socket.socketpair()
        for one in (self._listener, self._woken):
            self._selector.register(one, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering."""
        self._wake.send(b"x")
        self._thread.join(timeout=REQUEST_S + 1.0)
        for one in (*self._begun, self._listener, self._wake, self._woken):
            one.close()
        self._selector.close()

    def _run(self) -> None:
        while True:
            ready = [key.fileobj for key, _ in self._selector.select(REQUEST_S)]
            if self._woken in ready:
                return
            for one in ready:
                if one is self._listener:
                    self._accept()
                elif isinstance(one, socket.socket) and one in self._begun:
                    self._read(one)
            for one in [one for one, (until, _) in self._begun.items() if until < time.monotonic()]:
                self._drop(one)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            link, _ = self._listener.accept()
            link.setblocking(False)
            while len(self._begun) >= CONNECTIONS:
                self._drop(next(iter(self._begun)))
            self._begun[link] = time.monotonic() + REQUEST_S, b""
            self._selector.register(link, selectors.EVENT_READ)

    def _read(self, link: socket.socket) -> None:
        until, before = self._begun[link]
        try:
            more = link.recv(REQUEST_BYTES)
        except OSError:
            more = b""
        request = before + more
        if b"\r\n\r\n" in request:
            self._answer(link, request)
        if not more or b"\r\n\r\n" in request or len(request) > REQUEST_BYTES:
            self._drop(link)
        else:
            self._begun[link] = until, request

    def _answer(self, link: socket.socket, request: bytes) -> None:
        status, body = ("200 OK", self._page()) if request.startswith(b"GET ") else ("405 Method Not Allowed", b"")
        head = f"HTTP/1.1 {status}\r\nContent-Type: {CONTENT_TYPE_LATEST}\r\nContent-Length: {len(body)}\r\n"
        with contextlib.suppress(OSError):  # the reader is gone, or slow
            link.settimeout(REQUEST_S)
            link.sendall(head.encode() + b"Connection: close\r\n\r\n" + body)

    def _drop(self, link: socket.socket) -> None:
        self._selector.unregister(link)
        del self._begun[link]
        link.close()


def _histogram(name: str, text: str, counts: LatencyCounts) -> Metric:
    sums = itertools.accumulate(counts.counts.tolist())
    bins = zip((*(f"{bound:g}" for bound in BOUNDS_S), "+Inf"), sums, strict=True)
    return HistogramMetricFamily(f"mavdiag_{name}_seconds", text, list(bins), counts.sum_s)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"mavdiag_{name}", text, value)


def _links(figures: DaemonFigures) -> Iterator[Metric]:
    texts = {
        "connected": "1 if somebody is at the other end, as far as this side can know.",
        "sent": "Messages handed to the system.",
        "dropped": "Messages that could not be sent.",
    }
    families = {name: GaugeMetricFamily(f"mavdiag_link_{name}", text, labels=["link"]) for name, text in texts.items()}
    for number, one in enumerate(figures.links):
        label = ["vehicle" if number == 0 else f"behind {number} {one.address}"]
        families["connected"].add_metric(label, one.connected)
        families["sent"].add_metric(label, one.traffic.sent)
        families["dropped"].add_metric(label, one.traffic.dropped)
    yield from families.values()


def _vehicles(figures: DaemonFigures) -> Iterator[Metric]:
    def family(name: str, text: str, *labels: str) -> GaugeMetricFamily:
        return GaugeMetricFamily(f"mavdiag_{name}", text, labels=["vehicle", *labels])

    state = family("state", "1 for the state that the session is in.", "state")
    received = family("frames_received", "Frames received from the autopilot.")
    lost = family("frames_lost", "Frames lost on the way, by their sequence numbers.")
    rate = family("stream_hertz", "Measured rate of a stream.", "stream")
    judged = family("judged_seconds", "Flight time judged.")
    share = family("judged_share", "Flight time judged, of all flight time of this session.")
    ratio = family("statistic_ratio", "Statistic over threshold; absent while it is not valid.", "monitor", "axis")
    verdict = family("verdict", "1 for what is held of the vehicle.", "verdict")
    fault = family("fault", "Of a fault or an open inspection: 1 while it is seen, 0 when it is not.", "kind", "rotor")
    round_trip = family("timesync_round_trip_seconds", "Round trip of the latest TIMESYNC, to within a look.")
    drift = family("clock_drift_ppm", "Drift between the clocks of the vehicle's messages, where there are two.")
    for one in figures.vehicles:
        label = str(one.vehicle)
        if one.timesync.round_trip_s is not None:
            round_trip.add_metric([label], one.timesync.round_trip_s)
        if one.drift_ppm is not None:
            drift.add_metric([label], one.drift_ppm)
        for other in State:
            state.add_metric([label, other.value], other is one.state)
        held = one.diagnosis
        for stage in Stage:
            verdict.add_metric([label, stage.value], stage is held.stage)
        if held.kind is not None:
            for rotor in dict.fromkeys(span.rotor for span in held.rotors) or ("",):
                fault.add_metric([label, held.kind, str(rotor)], held.seen and rotor in (held.rotor, ""))
        received.add_metric([label], one.received)
        lost.add_metric([label], one.lost)
        for stream, hertz in one.rates:
            rate.add_metric([label, stream], hertz)
        judged.add_metric([label], one.judged_s)
        if one.flight_s > 0:
            share.add_metric([label], min(1.0, one.judged_s / one.flight_s))
        for monitor, axis, value in one.ratios:
            ratio.add_metric([label, monitor, axis], value)
    yield from (state, verdict, fault, received, lost, rate, judged, share, ratio, round_trip, drift)
