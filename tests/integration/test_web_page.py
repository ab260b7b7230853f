"""The live page in Debian's Chromium: what a user sees, how soon, and that no text from outside does anything."""

import json
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from made_page import FLEETS, about, entry, fleet, flown, now
from made_session import baseline_for
from made_vehicle import MadeVehicle, record
from processes import PATIENCE_S, ended, port_of, running, until
from processes import process as started
from web_page import give, look, serving, wait_for

from detector.web.child import ServerProcess
from mavdiag.decision.diagnosis import Stage
from mavdiag.link.ports import open_endpoint

pytestmark = pytest.mark.realtime
HOSTILE = '<img src=x onerror="window.hurt=1"><script>window.hurt=1</script>\u202e{{7*7}}'


@pytest.fixture
def process() -> Iterator[ServerProcess]:
    with serving() as one:
        yield one


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
    return [one["message"] for one in chromium.get_log("browser") if process.place.url in one["message"]]


def test_a_fault_is_seen_at_the_rotor_the_bar_and_the_strip(chromium: Any, process: ServerProcess) -> None:
    open_page(chromium, process)
    give(process, fleet(1, 2))
    wait_for(lambda: text(chromium, "#vehicles [aria-selected=true] .name").endswith("Vehicle 1"))
    give(process, about(1), *(now(1, 4 * k) for k in range(100)))
    wait_for(lambda: text(chromium, "#level-text") == "No fault found")
    assert chromium.execute_script("return mavdiag.traces.get('roll').points.length") == 400
    found = "A propeller fault of motor 2 was found."
    give(process, entry(1, "PROP FAULT motor 2 weak 11%", 2), now(1, 400, Stage.FAULT, 2, found))
    wait_for(lambda: text(chromium, "#level-text") == "Fault, motor 2")
    assert text(chromium, "#alert") == "Vehicle 1: Fault, motor 2"
    assert text(chromium, "#sentence") == found
    assert text(chromium, "#advice").startswith("Land, then look at the propeller of motor 2")
    classes = "return [...document.querySelectorAll('#airframe .rotor')].map((one) => one.getAttribute('class'))"
    assert chromium.execute_script(classes) == ["rotor", "rotor fault", "rotor", "rotor"]
    assert text(chromium, "#airframe-rotor-2 .rotor-label") == "+11 %"
    states = "return [...document.querySelectorAll('#bars li')].map((one) => one.dataset.state)"
    assert chromium.execute_script(states) == ["under", "over", "idle"]
    assert text(chromium, "#bars li:last-child .reason") == "not judged: no VIBRATION"
    assert text(chromium, "#bars li:nth-child(2) .figure") == "11.00 of 6.00 % of hover"
    assert text(chromium, "#place figcaption").endswith("north up")
    assert chromium.execute_script("return document.getElementById('place').hidden") is False
    assert chromium.execute_script("return document.querySelectorAll('[id]').length") == len(
        set(chromium.execute_script("return [...document.querySelectorAll('[id]')].map((one) => one.id)"))
    )
    painted = """const canvas = document.querySelector('canvas.residual'), context = canvas.getContext('2d');
        return context.getImageData(0, 0, canvas.width, canvas.height).data.some((one) => one > 0)"""
    wait_for(lambda: chromium.execute_script(painted))
    assert complaints(chromium, process) == []


@pytest.mark.parametrize("count", FLEETS)
def test_every_fleet_is_seen_at_a_glance_on_screen_and_phone(chromium: Any, process: ServerProcess, count: int) -> None:
    vehicles, levels = range(1, count + 1), FLEETS[count]
    give(process, fleet(*sorted(vehicles, key=lambda one: one % 7 != 1), levels=levels))  # as they came
    open_page(chromium, process)
    if count:
        wait_for(lambda: chromium.execute_script("return mavdiag.vehicle") == 1)
        give(process, *flown())
        wait_for(lambda: text(chromium, "#sentence").startswith("2 of 3 monitors judge"))
        tiles = "return [...document.querySelectorAll('#vehicles [role=tab]')].map((one) => one.dataset.level)"
        assert chromium.execute_script(tiles) == [levels.get(one, (Stage.QUIET, None))[0] for one in vehicles]
        assert len(rows(chromium)) == 2  # the text, and twelve alarms of one monitor as one event
        assert "12 alarms in 12 s, up to 2.1 times its threshold" in text(chromium, "#list li:first-child .words")
    else:
        wait_for(lambda: "udpin:0.0.0.0:14550" in text(chromium, "#address"))
        assert "--out udpout:127.0.0.1:14550" in text(chromium, "#ways")
    seen = "return ['fleet', 'empty', 'main', 'replay'].filter((id) => !document.getElementById(id).hidden)"
    assert chromium.execute_script(seen) == (["empty"] if not count else ["main"] if count == 1 else ["fleet", "main"])
    for width, dark in ((1280, False), (1280, True), (400, False)):
        look(chromium, f"live-{count}", width, dark=dark)
    assert complaints(chromium, process) == []


def test_a_replay_is_scrubbed_sped_up_and_seen_as_a_live_vehicle(chromium: Any, tmp_path: Path) -> None:
    log, baseline = tmp_path / "flight.tlog", tmp_path / "b.json"
    record(log, ((60.0, 0.0), (20.0, 0.5), (240.0, 0.0)))
    baseline_for().save(baseline)
    command = [sys.executable, "-m", "mavdiag", "replay", str(log), "--baseline", str(baseline), "--speed", "10"]
    with started([*command, "--web", "127.0.0.1:0"]) as child:
        assert child.stdout is not None
        chromium.get(next(line for line in child.stdout if " on " in line).split(" on ")[1].split(";")[0])
        at = "return mavdiag.playing ? mavdiag.playing.at_s : 0"
        shown = "return (mavdiag.traces.get('roll')?.newest() ?? 0) * 0.05 - (mavdiag.playing?.begin_s ?? 0)"
        wait_for(lambda: chromium.execute_script(shown) > 5)
        from_s = chromium.execute_script(at)
        wait_for(lambda: chromium.execute_script(at) > from_s + 30)
        wait_for(lambda: abs(chromium.execute_script(at) - chromium.execute_script(shown)) < 10)
        wait_for(lambda: chromium.execute_script("return mavdiag.playing.done"), "all is judged")
        chromium.execute_script("document.getElementById('play').click()")
        wait_for(lambda: chromium.execute_script("return mavdiag.playing.speed") == 0)
        for to_s, level, texts in ((300, "Fault", 1), (40, "No fault found", 0), (70, "Fault", 1)):
            chromium.execute_script(
                "const one = document.getElementById('scrub'); one.value = arguments[0];"
                "one.dispatchEvent(new Event('input'))",
                to_s,
            )
            there = shown.replace("return", "const at =")
            wait_for(partial(chromium.execute_script, f"{there}; return Math.abs(at - {to_s}) < 1"), f"{to_s} s")
            named = f"return document.getElementById('level-text').textContent === '{level}'"
            wait_for(partial(chromium.execute_script, named), level)
            points = "return mavdiag.traces.get('roll').points.length"
            assert chromium.execute_script(points) == pytest.approx(400, abs=12)  # 20 s
            assert text(chromium, "#time").startswith(f"{to_s // 60}:{to_s % 60:02}")
            found = chromium.execute_script("return mavdiag.entries.map((one) => one.content.text ?? '')")
            assert any("FAULT" in one for one in found) == bool(texts)
        for width, dark in ((1280, False), (1280, True), (400, False)):
            look(chromium, "replay", width, dark=dark)
        child.send_signal(signal.SIGINT)
        assert child.wait(PATIENCE_S) == 0


def test_hostile_texts_stay_text(chromium: Any, process: ServerProcess) -> None:
    open_page(chromium, process)
    give(process, fleet(1, sentence=HOSTILE), about(1, HOSTILE))
    wait_for(lambda: text(chromium, "#vehicles [aria-selected=true] .name").endswith("Vehicle 1"))
    give(process, about(1, HOSTILE), now(1, 0, Stage.SUSPECTED, 3, HOSTILE), entry(1, HOSTILE, 4))
    give(process, f"J 2 {json.dumps({'kind': HOSTILE, 'utc': HOSTILE, 'vehicle': HOSTILE})}", "J 3 no JSON")
    wait_for(lambda: rows(chromium) == [2, 1])
    wait_for(lambda: HOSTILE in text(chromium, "#sentence"))
    assert HOSTILE in text(chromium, "#list li:last-child .words")
    assert HOSTILE in text(chromium, "#whose")
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
        shown = f"""return [...document.querySelectorAll('#list [data-loud=critical] .words')]
            .some((one) => one.textContent === {json.dumps(said)})"""
        wait_for(lambda: chromium.execute_script(shown), said)
        until(far, vehicle, "nothing says this", 1.0)
        wait_for(lambda: text(chromium, "#level-text") == "Fault")
        assert text(chromium, "#alert") == "Vehicle 1: Fault"
        assert text(chromium, "#sentence").startswith("A propeller fault was found, rotor unknown: ")
        code, _ = ended(child, signal.SIGTERM)
    assert code == 0
    wait_for(lambda: "no connection" in text(chromium, "#connection"))
    assert text(chromium, "#list li:first-child .kind") == "stop"
