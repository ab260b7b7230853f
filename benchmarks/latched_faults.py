"""What is still told of a declared fault after whatever ends it: sessions on a virtual clock, with emulated flights.

    python benchmarks/latched_faults.py [--flights 3] [--seed 900]

One baseline is learnt from five healthy squares of 40 s. In each flight one propeller breaks (F2/SV3) at 8 s, and is
declared. From 20 s on one of these happens for 20 s: the link is cut; the vehicle lands; it flies as the healthy
flights never did, by turning set-points; the gyro falls silent; the detector is started anew; the propeller is whole
again. Afterwards the vehicle stands, disarmed, and is armed. Counted are flights of which the fault is still held, and
told again at the arming; texts that call it clear or over; and CRITICAL texts from 20 s on. A fault that is still seen
is repeated 15 s after its declaration, at 23 s, also where the windows of the monitors hold the time before a repair.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from chain_speed import blocks
from emulated import as_flight

from detector.config import SessionSettings
from detector.session import Session
from detector.values import SendText, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.inspections import Inspections
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.messages import Severity
from mavdiag.link.profiles import PROFILES
from mavdiag.link.vehicles import Received
from mavdiag.telemetry import Instant, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

STAMP = "1970-01-01T00:00:00+00:00"
STEP_NS = NS_PER_S // 25
ONSET_S, EVENT_S, END_S, ARMED_S, LAST_S = 8.0, 20.0, 40.0, 44.0, 48.0
STEEP_RAD = 0.5  # of set-points that no healthy flight had
EVENTS = ("link cut", "landing", "envelope left", "gyro lost", "restart", "repair")


@cache
def flight(seed: int, fault: str | None) -> Telemetry:
    """One flight of 48 s."""
    config = PlantConfig(seed=seed)
    if fault is not None:
        config = replace(config, fault=fault, rotor=seed % 4 + 1, onset_s=ONSET_S)
    return flight_telemetry(config, LAST_S)[0]


def since_start(one: Series) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Times of the receiver's clock [s], from 0."""
    return np.asarray(one.host_ns / NS_PER_S, dtype=np.float64)


def changed(telemetry: Telemetry, whole: Telemetry, event: str) -> Telemetry:
    """What comes over the link. whole: the same flight with healthy propellers."""
    out = []
    for one in telemetry:
        t_s, values = since_start(one), one.values.copy()
        inside = (t_s >= EVENT_S) & (t_s < END_S)
        if event == "repair":
            values = np.where((t_s >= EVENT_S)[:, None], whole[one.signal].values, values)
        if event == "envelope left" and one.signal is Signal.ATTITUDE_SETPOINT:
            values[inside, 0] += STEEP_RAD * np.sin(2 * np.pi * t_s[inside])
        if one.signal is Signal.ARMED:
            standing = (t_s >= END_S) & (t_s < ARMED_S)
            values[standing | (inside & (event == "landing"))] = 0.0
        kept = ~inside if event == "link cut" or (event == "gyro lost" and one.signal is Signal.BODY_RATE) else t_s >= 0
        out.append(Series(one.signal, one.t_ns[kept], one.host_ns[kept], values[kept]))
    return Telemetry(tuple(out))


def told(
    baseline: Baseline, telemetry: Telemetry, event: str, journal: Path
) -> tuple[Session, list[tuple[float, SendText]]]:
    """The session after a flight, and its texts with their times [s]."""
    spec = SessionSpec(PROFILES["qdrone2"], baseline, SessionSettings(negotiate=False))
    edges = np.arange(0, round(LAST_S * NS_PER_S), STEP_NS)
    session, texts, kept = Session(spec, Instant(0)), list[tuple[float, SendText]](), Inspections(journal, print)
    for edge_ns, piece in zip(edges.tolist(), blocks(telemetry, edges), strict=True):
        if event == "restart" and edge_ns == round(EVENT_S * NS_PER_S):
            kept = Inspections(journal, print)  # the daemon died: it reads what it had written
            session = Session(replace(spec, held=kept.held(1, 0)), Instant(edge_ns))
        for effect in session.step(Received(piece, alive=bool(piece.series)), Instant(edge_ns + STEP_NS)):
            if isinstance(effect, SendText):
                texts.append((edge_ns / NS_PER_S, effect))
            elif isinstance(effect, Change):
                kept.take(1, effect, baseline.digest, 0, STAMP)
        kept.flush()
    return session, texts


def judged(baseline: Baseline, seed: int, event: str, say: Callable[[str], None]) -> Counter[str]:
    """The counts of one flight."""
    telemetry = changed(flight(seed, "F2/SV3"), flight(seed, None), event)
    with tempfile.TemporaryDirectory() as folder:
        session, texts = told(baseline, telemetry, event, Path(folder) / "journal")
    loud = [at for at, one in texts if one.severity <= Severity.CRITICAL]
    held = session.diagnosis.stage in (Stage.FAULT, Stage.INSPECT)
    again = any(at >= ARMED_S and "inspect before flight" in one.text for at, one in texts)
    say("; ".join(f"{at:.1f} {one.text}" for at, one in texts if at > ONSET_S))
    return Counter(
        declared=any(at < EVENT_S for at in loud),
        told=held and again,
        clear=sum("clear" in one.text or "over" in one.text.split() for _, one in texts),
        loud=sum(EVENT_S <= at < ARMED_S for at in loud),
    )


def main() -> None:
    """Print a line for each event."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=3)
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--verbose", action="store_true")
    given = parser.parse_args()
    logs = [as_flight(PlantConfig(seed=given.seed + 100 + number), 40.0) for number in range(5)]
    baseline = learn(logs, LearnOptions(airframe=airframe_of(qdrone2(), "emulated")), created=STAMP)
    for event in EVENTS:
        counts: Counter[str] = Counter()
        for number in range(given.flights):
            counts += judged(baseline, given.seed + number, event, print if given.verbose else lambda _: None)
        print(
            f"{event:14} declared {counts['declared']} of {given.flights}, still told afterwards {counts['told']}, "
            f"called clear {counts['clear']}, CRITICAL after it {counts['loud']}"
        )


if __name__ == "__main__":
    main()
