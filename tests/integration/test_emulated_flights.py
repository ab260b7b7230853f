"""What is learnt, found and named on emulated flights: models, layouts, unbalance, and all monitors together."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from broken_teaching import MONITORS, Pool, Tally, judge_sets, pool_of

import mavdiag as md
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.decision.alarm import Stage
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.monitors import BY_NAME
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import Log, Signal, Telemetry
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import airframe_of

ONSET_S = 12.0  # 5 s after take-off nothing is judged


def flown(config: PlantConfig, duration_s: float) -> Telemetry:
    return flight_telemetry(config, duration_s)[0]


@cache
def baseline() -> Baseline:
    flights = [
        Log(f"f{seed}", f"{seed:064x}", "qdrone2", flown(PlantConfig(seed=100 + seed), 25.0)) for seed in range(6)
    ]
    return parse(
        dump(learn(flights, LearnOptions(airframe=airframe_named("qdrone2")), created="2026-01-01T00:00:00+00:00"))
    )


@cache
def damaged(rotor: int) -> Telemetry:
    return flown(PlantConfig(seed=7, fault="F2/SV2", rotor=rotor, onset_s=ONSET_S), 26.0)


def test_every_monitor_can_work_on_this_link() -> None:
    assert [one.monitor for one in baseline().not_judgeable] == ["vibration_level"]  # no such message
    kinds = {entry.spec.kind for entry in baseline().monitors}
    assert kinds == set(BY_NAME) - {"vibration_level"}


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_crack_is_declared_soon_and_its_rotor_named(rotor: int) -> None:
    verdict = judge(Log("crack", "", "qdrone2", damaged(rotor)), baseline())
    assert verdict.verdict is Verdict.FAULT
    faults = [one for one in verdict.changes if one.stage is Stage.FAULT]
    assert ONSET_S < faults[0].t_ns / 1e9 < ONSET_S + 3.0
    assert {one.event.rotor for one in verdict.events if one.event.rotor is not None} == {rotor}
    assert {one.fault_type for one in faults} <= {None, "F2", "F3"}  # a crack, or what looks like one


@pytest.mark.parametrize("seed", [900, 901, 902])
def test_a_healthy_flight_is_healthy(seed: int) -> None:
    verdict = judge(Log("healthy", "", "qdrone2", flown(PlantConfig(seed=seed), 25.0)), baseline())
    assert verdict.verdict is Verdict.HEALTHY, f"seed {seed}: {verdict.reason}"


pytest.importorskip("numba", reason="the plant is an extra")


FRONT = Front(AlignSpec(0.001, Grid.NATIVE), GateSpec(min_thrust=0.1), RateSpec.of(0.001, 101))
QDRONE2 = Airframe(layout=layout_named("qdrone2"), mass_kg=1.504, hover_rad_s=1047.2)


def fly(seed: int, fault: str | None = None, rotor: int = 1, seconds: float = 16.0) -> list[Rows]:
    config = PlantConfig(drone=1, seed=seed, fault=fault, rotor=rotor, wind_m_s=0.5)
    state, rows = FRONT.step(FRONT.start(), flight_telemetry(config, seconds)[0])
    return [one for one in (*rows, *FRONT.finish(state)[1]) if isinstance(one, Rows)]


def test_the_estimated_unbalance_is_that_of_the_table_and_placed() -> None:
    monitor = Unbalance(*Unbalance.fit([fly(11), fly(12)], LearnContext(QDRONE2, None, 0.001, 101)))
    found = [(one.level[one.valid], one.rotors[one.valid]) for one in monitor.over(fly(51, "F3/SV1", 2, seconds=6.0))]
    level, rotors = (np.concatenate(columns) for columns in zip(*found, strict=True))
    assert float(level.mean()) == pytest.approx(3.77, rel=0.15)  # T Table 3.2; own unbalance adds
    assert int(rotors.sum(axis=0).argmax()) + 1 == 2


@pytest.fixture(scope="module")
def flights() -> dict[int, PlantSamples]:
    return {drone: Plant(PlantConfig(drone=drone, seed=drone)).advance(33_000) for drone in (1, 2, 3)}


NOW = "2026-01-01T00:00:00+00:00"


@cache
def pool() -> Pool:
    """Of an airframe at 1 kHz."""
    return pool_of(7001, 0, 8)


def learnt(*flights: Log) -> Baseline:
    frame = airframe_of(pool().session.airframe.vehicle, "made")
    return learn(flights, LearnOptions(airframe=frame, monitors=MONITORS), created=NOW)


def test_drawn_sets_are_marked_where_one_is_broken_and_nowhere_else() -> None:
    """A short form of `benchmarks/broken_teaching.py`, on an airframe of a seed of its own."""
    tally = Tally()
    judge_sets(pool(), 1, np.random.default_rng(7001), tally)
    for kind, counts in tally.kinds.items():
        if kind.startswith("healthy"):
            assert counts[True] == 0, (kind, tally.wrong)
        elif kind != "one broken of 1":  # physics alone does not show every one
            assert counts[False] == 0, (kind, tally.wrong)


@pytest.mark.parametrize("code", ["F1/SV2", "F2/SV1", "F3/SV3"])
def test_a_crack_in_one_flight_names_the_flight_and_the_time(code: str) -> None:
    half = pool().half[code]
    weak = learnt(half).weak
    assert half.name in weak or "all flights" in weak
    broken = pool().broken[code]
    assert f"{broken.name}: " in learnt(pool().healthy[0], broken, pool().healthy[1]).weak


def test_more_unbalance_than_a_rotor_may_have_is_not_learnt() -> None:
    found = learnt(pool().broken["F3/SV3"])
    assert (found.grade, "grade G40" in found.weak) == ("D", True)


def weakened(log: Log, rotor: int, loss: float) -> Log:
    """The log with a rotor that lost thrust at half: its command rises, that of all together stays."""
    parts = []
    for one in log.telemetry.series:
        if one.signal is Signal.ACTUATOR:
            values = one.values.copy()
            late = one.t_ns > (one.t_ns[0] + one.t_ns[-1]) // 2
            values[late, rotor - 1] += (1 / np.sqrt(1 - loss) - 1) * values[late, :4].mean(axis=1)
            one = replace(one, values=values)
        parts.append(one)
    return replace(log, name="weakened", sha256="", telemetry=Telemetry(tuple(parts)))


def test_what_the_baseline_says_that_it_notices_it_notices() -> None:
    baseline = learnt(*pool().healthy[:4])
    assert baseline.least_damage is not None
    fresh = pool().healthy[5]
    assert md.judge(fresh, baseline).verdict == "healthy"
    for rotor, loss in enumerate(baseline.least_damage.thrust_loss, 1):
        assert 0.005 < loss < 0.2
        assert md.judge(weakened(fresh, rotor, 0.3 * loss), baseline).verdict == "healthy"
        assert md.judge(weakened(fresh, rotor, 1.6 * loss + 0.01), baseline).verdict != "healthy"


TESTS = Path(__file__).resolve().parents[1]
JUDGED = """
from flying_telemetry import flying
from made_baselines import whole
from made_telemetry import cut
from mavdiag.chain import chain_of, warm
from mavdiag import kernel
from mavdiag.rows import align, gate, rates

baseline = whole()
kernels = [kernel.judge, align._take, align._rows, gate._follow, rates._filter]
warm()
chain = chain_of(baseline)
state, telemetry = chain.start(), flying(3000, 7)
first = int(telemetry.series[0].t_ns[0])
for chunk in cut(telemetry, [first + k * 40_000_000 for k in range(1, 700)]):
    state, _ = chain.step(state, chunk)
assert state.judged_s > 10.0
print({len(kernel.signatures) for kernel in kernels})
"""


def test_a_live_flight_finds_every_kernel_compiled() -> None:
    """No look waits for a compilation: a second one would be of another kind of array."""
    environment = os.environ | {"PYTHONPATH": str(TESTS)}
    run = [sys.executable, "-c", JUDGED]
    done = subprocess.run(run, capture_output=True, text=True, check=False, env=environment, cwd=TESTS.parent)
    assert (done.returncode, done.stdout) == (0, "{1}\n"), done.stderr
