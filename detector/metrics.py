"""Figures for Prometheus (edge). Imported only if they are asked for."""

from prometheus_client import CollectorRegistry, Counter, Gauge, start_http_server

from detector.fleet import VehicleFigures
from detector.states import State
from mavdiag.errors import LinkError

__all__ = ["Metrics"]


class Metrics:
    """Serves http://HOST:PORT/metrics. Raises LinkError if the port cannot be had."""

    def __init__(self, host: str, port: int) -> None:
        self._registry = CollectorRegistry()
        by_vehicle = ["vehicle"]
        self._state = self._gauge("state", "1 for the state that the session is in.", [*by_vehicle, "state"])
        self._received = self._gauge("frames_received", "Frames received from the autopilot.", by_vehicle)
        self._lost = self._gauge("frames_lost", "Frames lost on the way, by their sequence numbers.", by_vehicle)
        self._rate = self._gauge("gyro_hertz", "Measured rate of the gyro stream.", by_vehicle)
        self._judged = self._gauge("judged_seconds", "Flight time judged.", by_vehicle)
        self._overflowed = self._gauge("datagrams_overflowed", "Datagrams that the system dropped unread.", [])
        self._late = self._gauge("late_ticks", "Looks at the links that came too late.", [])
        self._cpu = self._gauge("cpu_seconds", "Processor time used by the daemon.", [])
        self._events = Counter(
            "mavdiag_events", "Alarms of the monitors.", [*by_vehicle, "monitor"], registry=self._registry
        )
        try:
            self._server, self._thread = start_http_server(port, host, registry=self._registry)
        except OSError as error:
            raise LinkError(
                f"metrics on {host}:{port}: {error.strerror or error}; name another --metrics HOST:PORT"
            ) from error

    @property
    def port(self) -> int:
        """The port that was really bound."""
        return int(self._server.server_port)

    def show(self, vehicles: tuple[VehicleFigures, ...], *, overflowed: int, late: int, cpu_s: float) -> None:
        """Set all figures."""
        for one in vehicles:
            label = str(one.vehicle)
            for state in State:
                self._state.labels(label, state.value).set(state is one.state)
            self._received.labels(label).set(one.received)
            self._lost.labels(label).set(one.lost)
            self._rate.labels(label).set(one.gyro_hz)
            self._judged.labels(label).set(one.judged_s)
        self._overflowed.set(overflowed)
        self._late.set(late)
        self._cpu.set(cpu_s)

    def count_event(self, vehicle: int, monitor: str) -> None:
        """One more alarm."""
        self._events.labels(str(vehicle), monitor).inc()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=1.0)

    def _gauge(self, name: str, text: str, labels: list[str]) -> Gauge:
        return Gauge(f"mavdiag_{name}", text, labels, registry=self._registry)
