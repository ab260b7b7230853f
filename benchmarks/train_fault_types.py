"""Train the fault types on the emulator: `python benchmarks/train_fault_types.py [AIRFRAMES] [--write]`.

Each airframe, drawn by a seed, flies eight healthy flights for its monitors and then each of the nine faults at full,
half and no fluctuation, on rotors drawn by chance. The features 3 s and 8 s after the onset make one Gaussian for each
fault and strength. Printed: how often airframes that were left out are named rightly, at each strength. With --write
the clouds of all airframes become mavdiag/decision/fault_types.json. About ten seconds an airframe.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mavdiag.airframe.propellers import FaultType
from mavdiag.decision.grading import WAIT_S, FaultCloud, FaultTypes, Gathered, assess
from mavdiag.learning import rows_of
from mavdiag.logs import gate_for
from mavdiag.monitors.base import LearnContext, Monitor
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.physics.airframe import Airframe, Payload, draw_airframe
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

SEED = 20_000
AFTER_S = (3.0, 8.0)
STRENGTHS = (1.0, 0.5, 0.0)
FAULT_CODES = tuple(f"F{kind}/SV{severity}" for kind in (1, 2, 3) for severity in (1, 2, 3))
FAULTS = tuple((strength, code) for strength in STRENGTHS for code in FAULT_CODES)
SHRINK = 0.3  # share of the mean covariance in each (our choice)
FLOOR = 1e-4  # least variance
ONSET_S = 8.0
PROFILE, DT_S = "qdrone2", 0.001
WINDOW = window_samples(DT_S)
FRONT = Front(AlignSpec(DT_S, Grid.NATIVE), gate_for(PROFILE), RateSpec.of(DT_S, WINDOW))
CONTEXT = LearnContext(airframe_of(qdrone2(), "emulated"), None, DT_S, WINDOW)
KINDS: tuple[type[Monitor[Any]], ...] = (Unbalance, RotorSignature, RotorTrim)
# shape, speed [m/s], heading [deg]
PATHS = (
    ("square", 0.5, 0),
    ("square", 0.8, 0),
    ("square", 0.5, 45),
    ("square", 0.8, 45),
    ("hover", 0.5, 0),
    ("circle", 0.5, 0),
    ("figure8", 0.5, 0),
)
OUT = Path(__file__).resolve().parents[1] / "mavdiag" / "decision" / "fault_types.json"


def conditions(airframe: Airframe, rng: np.random.Generator, wind_m_s: float) -> PlantConfig:
    """Drawn: path, wind up to `wind_m_s` from anywhere, payload up to 100 g."""
    shape, speed, heading = PATHS[int(rng.integers(len(PATHS)))]
    return PlantConfig(
        airframe=airframe,
        trajectory=shape,
        speed_m_s=speed,
        heading_rad=float(np.radians(heading)),
        wind_m_s=float(rng.uniform(0, wind_m_s)),
        wind_towards_rad=float(rng.uniform(0, 2 * np.pi)),
        payload=Payload(float(rng.uniform(0, 0.1))),
        seed=int(rng.integers(2**31)),
    )


def fly(config: PlantConfig, duration_s: float) -> tuple[Rows, ...]:
    """The rows of one flight."""
    return rows_of(FRONT, flight_telemetry(config, duration_s)[0])


def features(monitors: Sequence[Monitor[Any]], rows: Sequence[Rows], rotor: int) -> FloatArray:
    """x of a flight with a fault, as it is known at each of the times after the onset, (2, 3)."""
    out = np.empty((len(AFTER_S), 3))
    found = [(one, list(one.over(rows))) for one in monitors]
    for k, after_s in enumerate(AFTER_S):
        gathered = Gathered(round(ONSET_S * NS_PER_S))
        for monitor, parts in found:
            end_ns = (ONSET_S + after_s - monitor.delay_s) * NS_PER_S
            begin_ns = (ONSET_S + WAIT_S[str(monitor.feature)]) * NS_PER_S
            for part in parts:
                use = part.valid & (part.t_ns >= begin_ns) & (part.t_ns <= end_ns)
                if use.any():
                    level, rotors = part.level[use], part.rotors[use] if len(part.rotors) else np.empty((1, 0))
                    figures = [np.nan, np.nan, len(level), np.square(level).sum(), level[-1]]
                    sums = np.array([*figures, *rotors[-1], *rotors.sum(axis=0)])
                    gathered = gathered.add(str(monitor.feature), sums, 1 << 62)
        out[k] = gathered.features(rotor)
    return out


def record(airframe_seed: int) -> FloatArray:
    """x of each fault and strength, at each time, (27, 2, 3), on one airframe that is aged or new by chance."""
    chance = np.random.default_rng([airframe_seed, 1])
    airframe = draw_airframe(qdrone2(), aged=bool(chance.random() < 0.5), rng=chance)
    rng = np.random.default_rng([airframe_seed, 2])
    flights = [fly(conditions(airframe, rng, 1.5), 40.0) for _ in range(8)]
    monitors = [kind(spec) for kind in KINDS for spec in kind.fit(flights, CONTEXT)]
    x = np.empty((len(FAULTS), len(AFTER_S), 3))
    for i, (strength, code) in enumerate(FAULTS):
        rotor = int(rng.integers(4)) + 1
        config = replace(
            conditions(airframe, rng, 1.0), fault=code, rotor=rotor, onset_s=ONSET_S, phenomenology=strength
        )
        x[i] = features(monitors, fly(config, ONSET_S + max(AFTER_S) + 0.1), rotor)
    return x


def clouds(x: FloatArray) -> list[FaultCloud]:
    """One Gaussian for each fault and strength, x: (airframes, 27, 3), shrunk towards the mean of those that spread.

    A feature that a time does not give yet (the rise at 3 s) gets a variance of one around zero; it is never told.
    """
    x = np.where(np.isfinite(x), x, 0.0)
    means = x.mean(axis=0)
    own = np.stack([np.cov(x[:, i].T) for i in range(x.shape[1])])
    pooled = own.mean(axis=0)
    out = []
    for i, (strength, code) in enumerate(FAULTS):
        C = (1 - SHRINK) * own[i] + SHRINK * pooled + FLOOR * np.eye(3)
        out.append(FaultCloud(FaultType(code[:2]), int(code[-1]), strength, means[i], C))
    return out


def report(x: FloatArray) -> None:
    """Leave each airframe out in turn."""
    for k, after_s in enumerate(AFTER_S):
        right = np.zeros((len(STRENGTHS), 4))
        for left_out in range(len(x)):
            known = FaultTypes(after_s, tuple(clouds(np.delete(x, left_out, axis=0)[:, :, k])))
            for i, (_, code) in enumerate(FAULTS):
                found = assess(x[left_out, i, k], known)
                kind = found.fault_type is not None and found.fault_type.value == code[:2]
                apart = 9 if found.severity is None else abs(found.severity - int(code[-1]))
                right[i // len(FAULT_CODES)] += (kind, kind and apart == 0, apart <= 1, found.fault_type is None)
        for strength, row in zip(STRENGTHS, right / (len(x) * len(FAULT_CODES)), strict=True):
            figures = "  ".join(
                f"{name} {share:.3f}" for name, share in zip(("type", "class", "+-1", "unnamed"), row, strict=True)
            )
            print(f"{after_s:g} s after, fluctuation {strength:g}: {figures}")


def text_of(x: FloatArray) -> str:
    """The parameters as JSON."""
    tables = [
        {
            "after_s": after_s,
            "clouds": [
                {
                    "type": cloud.fault_type.value,
                    "severity": cloud.severity,
                    "strength": cloud.strength,
                    "mean": np.round(cloud.mean, 5).tolist(),
                    "covariance": np.round(cloud.covariance, 7).tolist(),
                }
                for cloud in clouds(x[:, :, k])
            ],
        }
        for k, after_s in enumerate(AFTER_S)
    ]
    trained_on = f"emulated QDrone 2, {len(x)} airframes, seeds {SEED} to {SEED + len(x) - 1}"
    link = {"profiles": [PROFILE], "rate_hz": 1.0 / DT_S}
    head = {"schema": "mavdiag.fault_types/1", "trained_on": trained_on}
    return json.dumps({**head, **link, "tables": tables}, indent=1) + "\n"


def main() -> None:
    """Fly, print, and write if asked."""
    numbers = [int(one) for one in sys.argv[1:] if one.isdigit()]
    airframes = numbers[0] if numbers else 12
    x = np.stack([record(SEED + i) for i in range(airframes)])
    report(x)
    if "--write" in sys.argv:
        OUT.write_text(text_of(x), encoding="utf-8")
        print(f"wrote {OUT.name}")


if __name__ == "__main__":
    main()
