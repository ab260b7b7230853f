"""The live page in Debian's Chromium: what a user sees, how soon, and that no text from outside does anything."""

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from detector_process import ended, port_of, running, until
from made_session import baseline_for
from made_vehicle import MadeVehicle
from web_page import browser, give, serving, wait_for

from detector.states import State
from detector.web.child import ServerProcess
from detector.web.snapshot import Level
from mavdiag.airframe.layout import layout_named
from mavdiag.link.ports import open_endpoint
from mavdiag.report.drawing import airframe_svg
from mavdiag.telemetry import Axis

pytestmark = pytest.mark.realtime
HOSTILE = '<img src=x onerror="window.hurt=1"><script>window.hurt=1</script>\u202e{{7*7}}'


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with browser(tmp_path_factory.mktemp("chromium") / "profile") as driver:
        yield driver


@pytest.fixture
def process() -> Iterator[ServerProcess]:
    with serving() as one:
        yield one


def entry(number: int, text: str = "PROP monitoring", severity: int = 6, vehicle: int = 1) -> str:
    content = {"kind": "text", "utc": "2026-05-01T10:00:00.000Z", "vehicle": vehicle, "severity": severity}
    return f"J {number} {json.dumps(content | {'text': text})}"


def fleet(*vehicles: int, sentence: str = "No fault found") -> str:
    like = {"state": "monitoring", "level": "quiet", "sentence": sentence, "received": 1, "lost": 0}
    lines = [like | {"vehicle": one, "judged_s": 45.0, "flight_s": 60.0} for one in vehicles]
    told = {"vehicles": lines, "links": [], "late": 0, "cpu_s": 1.0, "uptime_s": 10.0, "refused": []}
    return f"F {json.dumps(told)}"


def about(vehicle: int, name: str = "QDrone 2") -> str:
    names = ("name", "label", "axis", "unit", "threshold", "decides", "margin")
    slots = (
        ("fsd", "FSD", "roll", "s", 0.12, False, 0.05),
        ("rotor_trim", "rotor trim", "", "fraction of hover", 0.06, True, None),
        ("vibration_level", "vibration", "", "m/s^2", 1.5, True, None),
    )
    told = {"vehicle": vehicle, "airframe": name, "profile": "qdrone2", "layout": "rotor layout x"}
    told |= {"drawing": airframe_svg(layout_named("x"), title=name)}
    return f"A {vehicle} {json.dumps(told | {'slots': [dict(zip(names, slot, strict=True)) for slot in slots]})}"


def now(vehicle: int, first: int, level: Level = Level.QUIET, rotor: int | None = None, sentence: str = "") -> str:
    bins = list(range(first, first + 4))
    high = [0.03 * ((number * 7) % 5 - 2) / 2 for number in bins]
    strip = {"axis": Axis.ROLL, "bins": bins, "low": [value - 0.01 for value in high], "high": high}
    values = ((0.02, ""), (0.11 if rotor else 0.01, ""), (None, "no VIBRATION"))
    shown = {
        "vehicle": vehicle,
        "level": level,
        "sentence": sentence or "No fault found",
        "rotor": rotor,
        "rises": (0.0, 0.11, -0.05, -0.06) if rotor else (0.0, 0.01, -0.01, 0.0),
        "state": State.MONITORING,
        "reason": "monitoring",
        "judged_s": 9.0,
        "flight_s": 14.0,
        "events": 0,
        "slots": [{"value": value, "reason": reason} for value, reason in values],
        "strips": [strip | {"fsd_s": [0.02] * 4, "judged": [True] * 4}],
        "link": {
            "received": 1000,
            "lost": 3,
            "silent_s": 0.0,
            "round_trip_s": 0.04,
            "drift_ppm": None,
            "rates": (("gyro", 200.0), ("VIBRATION", 0.0)),
        },
    }
    return f"N {vehicle} {json.dumps(shown)}"


def open_page(chromium: Any, process: ServerProcess) -> None:
    chromium.get(process.place.url)
    wait_for(lambda: "live" in text(chromium, "#connection"), "the page is live")


def text(chromium: Any, selector: str) -> str:
    found: str = chromium.execute_script(f"return document.querySelector('{selector}')?.textContent ?? ''")
    return found


def rows(chromium: Any) -> list[int]:
    """Numbers of the events in the list, the newest first."""
    script = "return [...document.querySelectorAll('#list li')].map((one) => Number(one.dataset.number))"
    found: list[int] = chromium.execute_script(script)
    return found


def complaints(chromium: Any, process: ServerProcess) -> list[str]:
    """What the browser says of this page; a server of another test has ended."""
    said = [one["message"] for one in chromium.get_log("browser")]
    return [one for one in said if process.place.url in one]


def test_a_fleet_is_seen_at_a_glance_and_a_vehicle_is_chosen_from_it(chromium: Any, process: ServerProcess) -> None:
    open_page(chromium, process)
    give(process, fleet(1))
    wait_for(lambda: text(chromium, "#vehicles [aria-selected=true] .name").endswith("Vehicle 1"))
    assert chromium.execute_script("return document.querySelector('#fleet').hidden")
    told = json.loads(fleet(*range(1, 21)).removeprefix("F "))
    told["vehicles"][6] |= {"level": "fault", "sentence": "motor 2 lost 11% thrust"}
    give(process, f"F {json.dumps(told)}")
    wait_for(lambda: text(chromium, "#fleet-counts") == "19 quiet, 1 fault")
    rows = "return [...document.querySelectorAll('#fleet-rows tr')].map((one) => one.innerText)"
    shown = chromium.execute_script(rows)
    assert len(shown) == 20
    assert shown[6].split() == [
        "✕",
        "7",
        "motor",
        "2",
        "lost",
        "11%",
        "thrust",
        "monitoring",
        "45",
        "s",
        "(75",
        "%)",
        "0",
    ]
    chromium.execute_script("document.querySelectorAll('#fleet-rows button')[6].click()")
    wait_for(lambda: text(chromium, "#vehicles [aria-selected=true] .name").endswith("Vehicle 7"))
    give(process, fleet(1, 2))
    wait_for(lambda: len(chromium.execute_script(rows)) == 2)
    assert complaints(chromium, process) == []


def test_a_fault_is_seen_at_the_rotor_the_bar_and_the_strip(chromium: Any, process: ServerProcess) -> None:
    open_page(chromium, process)
    give(process, fleet(1, 2))
    wait_for(lambda: text(chromium, "#vehicles [aria-selected=true] .name").endswith("Vehicle 1"))
    give(process, about(1), *(now(1, 4 * k) for k in range(100)))
    wait_for(lambda: text(chromium, "#level-text") == "No fault found")
    assert chromium.execute_script("return mavdiag.traces.get('roll').points.length") == 400
    alarm = now(1, 400, Level.FAULT, 2, "PROP FAULT motor 2 weak 11%")
    give(process, entry(1, "PROP FAULT motor 2 weak 11%", 2), alarm)
    wait_for(lambda: text(chromium, "#level-text") == "Fault")
    assert text(chromium, "#alert") == "Vehicle 1: PROP FAULT motor 2 weak 11%"
    classes = "return [...document.querySelectorAll('#airframe .rotor')].map((one) => one.getAttribute('class'))"
    assert chromium.execute_script(classes) == ["rotor", "rotor fault", "rotor", "rotor"]
    assert text(chromium, "#airframe-rotor-2 .rotor-label") == "+11 %"
    states = "return [...document.querySelectorAll('#bars li')].map((one) => one.dataset.state)"
    assert chromium.execute_script(states) == ["under", "over", "idle"]
    assert text(chromium, "#bars li:last-child .reason") == "not judged: no VIBRATION"
    painted = """const canvas = document.querySelector('canvas.residual'), context = canvas.getContext('2d');
        return context.getImageData(0, 0, canvas.width, canvas.height).data.some((one) => one > 0)"""
    wait_for(lambda: chromium.execute_script(painted))
    assert complaints(chromium, process) == []


def test_hostile_texts_stay_text(chromium: Any, process: ServerProcess) -> None:
    open_page(chromium, process)
    give(process, fleet(1, sentence=HOSTILE), about(1, HOSTILE))
    wait_for(lambda: text(chromium, "#vehicles [aria-selected=true] .name").endswith("Vehicle 1"))
    give(process, about(1, HOSTILE), now(1, 0, Level.SUSPECTED, 3, HOSTILE), entry(1, HOSTILE, 4))
    give(process, f"J 2 {json.dumps({'kind': HOSTILE, 'utc': HOSTILE, 'vehicle': HOSTILE})}", "J 3 no JSON")
    wait_for(lambda: rows(chromium) == [2, 1])
    wait_for(lambda: HOSTILE in text(chromium, "#alert"))
    assert HOSTILE in text(chromium, "#list li:last-child .words")
    assert HOSTILE in text(chromium, "#layout")
    found = "return [window.hurt || 0, document.images.length, document.scripts.length]"
    assert chromium.execute_script(found) == [0, 0, 2]
    refused = "try { document.body.innerHTML = '<b>x</b>'; return 'taken' } catch { return 'refused' }"
    assert chromium.execute_script(refused) == "refused"  # trusted types: no text becomes markup by mistake
    inline = "const s = document.createElement('script'); try { s.text = 'window.hurt = 1' } catch {}\n"
    assert chromium.execute_script(f"{inline}document.body.append(s); return window.hurt || 0") == 0


def test_an_alert_of_the_detector_is_on_the_page(chromium: Any, tmp_path: Path) -> None:
    """The whole way: frames to the daemon, its STATUSTEXT to the ground station, the same text on the page."""
    baseline, vehicle = tmp_path / "b.json", MadeVehicle(1)
    baseline_for().save(baseline)
    options = ("--baseline", str(baseline), "--connect", "udpin:127.0.0.1:0", "--web", "0")
    with running(*options) as (child, first), open_endpoint(f"udpout:127.0.0.1:{port_of(first)}") as far:
        assert child.stderr is not None
        chromium.get(child.stderr.readline().split("web page: ")[1].strip())
        until(far, vehicle, "monitoring")
        until(far, vehicle, "FAULT", 6.0)  # nothing is judged in the first seconds of a flight
        vehicle.turning = 0.5
        said = next(one for one in until(far, vehicle, "FAULT") if "FAULT" in one)
        heard_ms = 1000.0 * time.time()
        shown = f"""return [...document.querySelectorAll('#list [data-loud=critical] .words')]
            .filter((one) => one.textContent === {json.dumps(said)})
            .map((one) => Number(one.parentElement.dataset.shown))"""
        found = wait_for(lambda: chromium.execute_script(shown), said)
        until(far, vehicle, "nothing says this", 1.0)
        wait_for(lambda: text(chromium, "#level-text") == "Fault")
        assert said.removeprefix("PROP FAULT ") in text(chromium, "#alert")
        assert found[0] - heard_ms < 10_000
        code, _ = ended(child, signal.SIGTERM)
    assert code == 0
    wait_for(lambda: "no connection" in text(chromium, "#connection"))
    assert text(chromium, "#list li:first-child .kind") == "stop"
