"""Figures for Prometheus (edge). Imported only if they are asked for.

Label sets are bounded: vehicles by the setting `max_vehicles`, monitors by the registry, links and files by the
settings. docs/detector.md lists the figures.
"""

import itertools
import time
from collections import Counter
from collections.abc import Iterable, Iterator

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from detector.figures import DaemonFigures
from detector.fleet import Turn
from detector.latency import BOUNDS_S, LatencyCounts
from detector.states import State
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import LinkError
from mavdiag.units import NS_PER_S

__all__ = ["Metrics"]


class Metrics(Collector):
    """Serves http://HOST:PORT/metrics. Raises LinkError if the port cannot be had."""

    def __init__(self, host: str, port: int) -> None:
        self._shown: tuple[DaemonFigures, int] | None = None
        self._events: Counter[tuple[str, str]] = Counter()
        self._look, self._verdict = LatencyCounts(), LatencyCounts()
        registry = CollectorRegistry()
        registry.register(self)
        try:
            self._server, self._thread = start_http_server(port, host, registry=registry)
        except OSError as error:
            raise LinkError(
                f"metrics on {host}:{port}: {error.strerror or error}; name another --metrics HOST:PORT"
            ) from error

    @property
    def port(self) -> int:
        """The port that was really bound."""
        return int(self._server.server_port)

    def show(self, figures: DaemonFigures, now_ns: int) -> None:
        """Set all figures. now_ns: monotonic clock."""
        self._shown = figures, now_ns

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
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=1.0)

    def collect(self) -> Iterator[Metric]:
        """All figures, as Prometheus asks for them (from its own thread)."""
        if self._shown is None:
            return
        figures, shown_ns = self._shown
        age_s = (time.monotonic_ns() - shown_ns) / NS_PER_S
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
        for (vehicle, monitor), count in list(self._events.items()):
            events.add_metric([vehicle, monitor], count)
        yield events
        yield _histogram("look_latency", "From the arrival of a gyro sample to the end of its look.", self._look)
        yield _histogram("verdict_latency", "From the arrival of a gyro sample to its verdict.", self._verdict)


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
