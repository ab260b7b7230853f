"""The emulated flight of the README's pictures, flown once: a QDrone 2 at 400 Hz, whose propeller 1 cracks at 10 s."""

import importlib.util
import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

from made_history import records
from shared_data import written

from mavdiag.history.warn import overview_of
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict
from mavdiag.report.campaign import read_campaign
from mavdiag.report.page import FlightReport, campaign_page, flight_report, flights_page, history_page
from mavdiag.telemetry import Log

DOCS = Path(__file__).resolve().parents[1] / "docs"
ROTOR, ONSET_S, RATE_HZ = 1, 10.0, 400.0
GROWS = {"survey-1": 0.03, "survey-2": 0.0}  # of a threshold a flight, by airframe
CREATED = "2026-01-01T00:00:00+00:00"


@cache
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_report", DOCS / "draw_report.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert (module.ROTOR, module.ONSET_S, module.LINK.rate_hz) == (ROTOR, ONSET_S, RATE_HZ)
    return module


def cracked() -> tuple[Log, JudgedFlight]:
    found: tuple[Log, JudgedFlight] = script().cracked()
    return found


@cache
def pages() -> dict[str, str]:
    """A page of each kind: a flight, a healthy one, several with one that cannot be read, a campaign, a history."""
    learnt, (log, _) = script().baseline(), cracked()
    damaged, healthy = flight_report(log, learnt), flight_report(script().fly(4), learnt)
    several = [healthy, damaged, FlightReport(LogVerdict("flights/gone.bin", Verdict.ERROR, "no such file"))]
    shown = {"flight": [damaged], "healthy": [healthy], "folder": several}
    made = {name: flights_page(flights, learnt, "qdrone2.json", CREATED) for name, flights in shown.items()}
    wear = [overview_of(name, records([0.3 + grows * k for k in range(20)]), ()) for name, grows in GROWS.items()]
    made["history"] = history_page(wear, CREATED)
    with TemporaryDirectory() as folder:
        campaign = read_campaign(written(Path(folder) / "campaign.jsonl", results()))
    return made | {"campaign": campaign_page(campaign, "campaign.jsonl", CREATED)}


def results(other: str = "F1/SV3") -> str:
    """A campaign of forty flights. other: a cause that a fifth of them has."""
    lines = []
    for number in range(40):
        cause, missed = ("healthy", "F1/SV1", "F2/SV2", "F3/SV3", other)[number % 5], number % 7 == 0
        kind = "nothing" if missed else "propeller fault"
        one = {"record": "flight", "key": str(number), "cause": cause, "rotor": 1 + number % 4, "phenomenology": 1.0}
        one |= {"answer": {"kind": kind, "rotor": 1, "fault_type": cause[:2], "severity": 1}, "episodes": 0}
        one |= {"flown_s": 40.0, "healthy_s": 12.0, "onset_s": 15.0, "latency_s": None, "another": "field"}
        if cause == "healthy":
            one |= {"onset_s": None, "verdict": "healthy", "score_before": 0.3 + 0.01 * number}
        else:
            found = {"score_after": 0.35} if missed else {"score_after": 3.0, "latency_s": 0.1 * number}
            one |= {"verdict": "fault", **found}
        lines.append(json.dumps(one))
    return "\n".join([*lines, '{"record": "learn", "key": "a", "baseline": "..."}', '{"record": "fli'])
