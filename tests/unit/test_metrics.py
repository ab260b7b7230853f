"""What the daemon tells those who supervise it: figures for Prometheus, and signs of life for systemd."""

import json
import re
import socket
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import Bench, FakeFitter, MadeVehicle

from detector.config import Settings
from detector.metrics import COUNTERS, GAUGES, Metrics
from detector.notify import Notifier
from mavdiag.link.messages import Autopilot


@pytest.fixture
def metrics() -> Iterator[Metrics]:
    one = Metrics("127.0.0.1", 0)
    yield one
    one.close()


def page(metrics: Metrics) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{metrics.port}/metrics", timeout=5.0) as answer:
        text: str = answer.read().decode()
    return text


def flown(metrics: Metrics, vehicles: int = 1) -> Bench:
    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
    flying = [MadeVehicle(k + 1) for k in range(vehicles)]
    bench = Bench(settings, baseline_for(), vehicles=flying, links_behind=1, metrics=metrics)
    bench.run(12.0)
    return bench


def value(text: str, name: str) -> float:
    found = re.search(rf"^mavdiag_{re.escape(name)} (.+)$", text, re.MULTILINE)
    assert found, name
    return float(found[1])


def test_the_figures_of_a_flight_are_on_the_page(metrics: Metrics) -> None:
    bench = flown(metrics)
    text = page(metrics)
    bench.close()
    assert value(text, 'state{state="monitoring",vehicle="1"}') == 1
    assert value(text, 'state{state="lost",vehicle="1"}') == 0
    assert value(text, 'verdict{vehicle="1",verdict="quiet"}') == 1
    assert value(text, 'verdict{vehicle="1",verdict="fault"}') == 0
    assert "mavdiag_fault{" not in text
    assert value(text, 'frames_received{vehicle="1"}') > 2000
    assert value(text, 'frames_lost{vehicle="1"}') == 0
    assert value(text, 'stream_hertz{stream="body_rate",vehicle="1"}') == pytest.approx(100.0, rel=0.01)
    assert value(text, 'judged_seconds{vehicle="1"}') > 4.0
    assert 0.3 < value(text, 'judged_share{vehicle="1"}') < 1.0  # the first five seconds are not judged
    assert 0.0 <= value(text, 'statistic_ratio{axis="roll",monitor="fsd",vehicle="1"}') < 1.0
    assert value(text, 'link_connected{link="vehicle"}') == 1
    assert value(text, 'link_dropped{link="behind 1 memory:near"}') == 0
    assert value(text, "session_working") == 1


def test_requests_that_are_never_ended_cost_no_thread_and_hide_no_page(metrics: Metrics) -> None:
    bench = flown(metrics)
    threads = threading.active_count()
    with ExitStack() as stack:
        for _ in range(300):
            begun = stack.enter_context(socket.create_connection(("127.0.0.1", metrics.port)))
            begun.send(b"GET /metrics HTTP/1.1\r\nX: ")
        assert threading.active_count() == threads
        assert "mavdiag_state" in page(metrics)
    bench.close()


def test_the_dashboard_asks_only_for_figures_and_labels_that_there_are(metrics: Metrics) -> None:
    text = Path(__file__).parents[2].joinpath("deploy", "grafana-dashboard.json").read_text()
    board = json.loads(text)
    bench = flown(metrics, vehicles=2)
    bench.close()
    served = page(metrics)
    known = set(re.findall(r"^# TYPE (\w+) ", served, re.MULTILINE))
    known |= {f"{name}_{more}" for name in known for more in ("bucket", "total")}
    asked = set(re.findall(r"mavdiag_\w+", text))
    assert len(asked) >= 12
    assert asked <= known
    labels = {label for _, of in (GAUGES | COUNTERS).values() for label in of}
    for panel in board["panels"]:
        for target in panel["targets"]:
            assert set(re.findall(r"{{(\w+)}}", target["legendFormat"])) <= labels
    places = [(one["x"], one["y"]) for one in (panel["gridPos"] for panel in board["panels"])]
    assert len(set(places)) == len(places)


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "notify"))
        one.setblocking(False)
        yield one


def told(manager: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(manager.recv(4096).decode())
        except BlockingIOError:
            return found


def environ(manager: socket.socket, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": str(manager.getsockname()), **more}


def test_the_daemon_gives_no_sign_of_life_while_all_sessions_are_off(manager: socket.socket) -> None:
    """The baseline is of another profile."""
    notifier = Notifier(environ(manager, WATCHDOG_USEC="30000000"))
    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
    vehicle = MadeVehicle(1, Autopilot.ARDUPILOTMEGA)
    bench = Bench(settings, baseline_for(), FakeFitter(), vehicles=[vehicle], notifier=notifier)
    bench.run(5.0)
    told(manager)
    for _ in range(10):
        bench.run(1.0)
        assert "WATCHDOG=1" not in told(manager)
    bench.close()
    notifier.close()
