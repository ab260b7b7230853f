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
from mixed_flights import FAULT_CODES, HOVER, Fault, airframe_of, fly

from mavdiag.airframe.layout import layout_named
from mavdiag.airframe.propellers import FaultType
from mavdiag.decision.grading import (
    SCHEMA,
    FaultCloud,
    FaultTypes,
    Features,
    Gathered,
    assess,
    features_of,
    gather,
    start,
)
from mavdiag.monitors import rotor_signature, rotor_trim, unbalance
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.telemetry import FloatArray

SEED = 20_000
AFTER_S = (3.0, 8.0)
STRENGTHS = (1.0, 0.5, 0.0)
SHRINK = 0.3  # share of the mean covariance in each (our choice)
FLOOR = 1e-4  # least variance
ONSET_S = 8.0
FRAME = layout_named("qdrone2")
OUT = Path(__file__).resolve().parents[1] / "mavdiag" / "decision" / "fault_types.json"


def features_at(monitors: Sequence[Monitor[Any]], rows: Sequence[Rows], rotor: int, after_s: float) -> Features:
    """What is read of a flight from the onset to `after_s` later."""
    state, states, end_ns = start(round(ONSET_S * 1e9)), [one.start() for one in monitors], (ONSET_S + after_s) * 1e9
    for one in rows:
        readings = []
        for i, monitor in enumerate(monitors):
            states[i], reading = monitor.step(states[i], one)
            readings.append(replace(reading, valid=reading.valid & (reading.t_ns <= end_ns)))
        state = gather(state, vibration=readings[0], energy=readings[1], effort=readings[2], rotor=rotor)
    return features_of(state)


def record(airframe_seed: int) -> FloatArray:
    """(27, 2, 3): x of each fault and strength, at each time."""
    airframe, rng = airframe_of(airframe_seed), np.random.default_rng([airframe_seed, 2])
    flights = [fly(airframe, rng, 40.0) for _ in range(8)]
    monitors: list[Monitor[Any]] = [
        unbalance.Unbalance(unbalance.fit(flights, FRAME, HOVER)),
        rotor_signature.RotorSignature(rotor_signature.fit(flights, FRAME)),
        rotor_trim.RotorTrim(rotor_trim.fit(flights, FRAME)),
    ]
    x = np.empty((len(STRENGTHS) * len(FAULT_CODES), len(AFTER_S), 3))
    for i, (strength, code) in enumerate((strength, code) for strength in STRENGTHS for code in FAULT_CODES):
        fault = Fault(code, int(rng.integers(4)) + 1, ONSET_S, strength)
        rows = fly(airframe, rng, ONSET_S + max(AFTER_S) + 0.1, wind_m_s=1.0, fault=fault)
        for k, after_s in enumerate(AFTER_S):
            x[i, k] = features_at(monitors, rows, fault.rotor, after_s).vector
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
    for i, (strength, code) in enumerate((strength, code) for strength in STRENGTHS for code in FAULT_CODES):
        C = (1 - SHRINK) * own[i] + SHRINK * pooled + FLOOR * np.eye(3)
        out.append(FaultCloud(FaultType(code[:2]), int(code[-1]), strength, means[i], C))
    return out


def report(x: FloatArray) -> None:
    """Leave each airframe out in turn."""
    for k, after_s in enumerate(AFTER_S):
        right = np.zeros((len(STRENGTHS), 4))
        for left_out in range(len(x)):
            known = [FaultTypes(after_s, tuple(clouds(np.delete(x, left_out, axis=0)[:, :, k])), "")]
            for i, code in enumerate(FAULT_CODES * len(STRENGTHS)):
                found = assess(made(x[left_out, i, k], after_s), known)
                kind = found.fault_type is not None and found.fault_type.value == code[:2]
                apart = 9 if found.severity is None else abs(found.severity - int(code[-1]))
                right[i // len(FAULT_CODES)] += (kind, kind and apart == 0, apart <= 1, found.fault_type is None)
        for strength, row in zip(STRENGTHS, right / (len(x) * len(FAULT_CODES)), strict=True):
            figures = "  ".join(
                f"{name} {share:.3f}" for name, share in zip(("type", "class", "+-1", "unnamed"), row, strict=True)
            )
            print(f"{after_s:g} s after, fluctuation {strength:g}: {figures}")


def made(x: FloatArray, after_s: float) -> Gathered:
    """A gathering with these features."""
    features = Features(*(None if not np.isfinite(v) else float(v) for v in (np.exp(x[0]), np.exp(x[1]), x[2] / 100)))
    square = [(v * v, 1) if v is not None else (0.0, 0) for v in (features.unbalance_g_mm, features.motion_rad_s)]
    rise = (0.0, 0) if features.rise is None else (features.rise, 1)
    return Gathered(0, square[0], square[1], rise, round(after_s * 1e9))


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
    return json.dumps({"schema": SCHEMA, "trained_on": trained_on, "tables": tables}, indent=1) + "\n"


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
