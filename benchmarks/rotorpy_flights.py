"""Judge flights of a simulator that others made: RotorPy's vehicle, controller, gusts and IMU (arXiv:2306.04485).

    nox -s rotorpy -- [--vehicle hummingbird] [--seconds 40] [--seed 1] [--flights 4] [--workers 2]

A baseline is learnt from two hovers, a circle and a Lissajous figure in calm air, with the rotors told. Each flight
after it has a seed of its own: healthy as taught, faster, in steps, turning, in gusts, in steady wind, with a load, a
battery that sags, another gain of the attitude's controller, a gyro that drifts; with rotor 2 weaker, at once, by and
by or now and then, or out of balance, from the middle on. RotorPy knows no damage: its vehicle is asked for the wrench
at the speed of the weak rotor times the root of what is left of its thrust and drag, and a rotor out of balance adds
the force m r w^2 at its hub. Where the steps show it all rotors have a little, as propellers of balance quality G 6.3
(ISO 21940-11). The controller has the true position and attitude, and the rate of RotorPy's gyro.
"""

import argparse
import math
import sys
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

import mavdiag as md
from mavdiag.airframe.layout import layout_of_effects
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import FloatArray

RATE_HZ = 250.0
BEFORE_S = 8.0  # flown before the log begins: a flight that begins in mid-air, in gusts at once, is none
G = 9.81  # m/s^2, as RotorPy has it
USUAL_MM_S, PROPELLER_SHARE = 6.3, 0.01  # balance quality G 6.3; mass of a propeller, of the vehicle's (a guess)
GYRO, ACCELEROMETER = 7e-5, 1e-3  # noise densities of a small IMU [rad/s, m/s^2 per root of Hz] (a guess)
FLU_TO_FRD = np.array([1.0, -1.0, -1.0])
SOLVER = {"method": "RK23", "rtol": 1e-3, "atol": 1e-3, "first_step": 1.0 / RATE_HZ}
TAUGHT = ("hover", "hover", "circle", "figure")
PLACES = {"hover": 0.0, "steps": 0.0, "circle": 1.0, "figure": 1.0, "turning circle": 1.0, "fast circle": 1.6}  # pace


@dataclass(frozen=True, slots=True)
class Case:
    """A flight. gusts_m_s: rms on each axis. load: of the mass. sag: share of all thrust that is lost until the end.

    gain: of the attitude's controller, times. drift_rad_s: of the gyro until the end, on each axis.
    left: share of thrust and drag that rotor 2 keeps from the middle on, by and by until the end (`fades`), or for one
    of four seconds (`returns`). balance_mm_s: its balance quality then.
    """

    place: str
    gusts_m_s: float = 0.0
    wind_m_s: float = 0.0
    load: float = 0.0
    sag: float = 0.0
    gain: float = 1.0
    drift_rad_s: float = 0.0
    left: float = 1.0
    fades: bool = False
    returns: bool = False
    balance_mm_s: float = 0.0

    def __str__(self) -> str:
        parts = (
            f"gusts of {self.gusts_m_s:g} m/s" * bool(self.gusts_m_s),
            f"wind of {self.wind_m_s:g} m/s" * bool(self.wind_m_s),
            f"{self.load:.0%} heavier" * bool(self.load),
            f"thrust sags by {self.sag:.0%}" * bool(self.sag),
            f"gain {self.gain:g}" * (self.gain != 1),
            f"gyro drifts by {self.drift_rad_s:g} rad/s" * bool(self.drift_rad_s),
            f"rotor 2 loses {1 - self.left:.0%}" * (self.left < 1)
            + " by and by" * self.fades
            + " at times" * self.returns,
            f"rotor 2 of G {self.balance_mm_s:g}" * bool(self.balance_mm_s),
        )
        return ", ".join(filter(None, (self.place, *parts)))


def rotorpy(name: str) -> Any:
    """A module of RotorPy. Some of its batched classes name torch, which nothing here uses."""
    torch: Any = ModuleType("torch")
    torch.tensor, torch.Tensor = np.array, type("Tensor", (), {})
    with patch.dict(sys.modules, {"torch": torch}):
        return import_module(f"rotorpy.{name}")


def damageable(values: Mapping[str, Any], state: Mapping[str, FloatArray], chance: np.random.Generator) -> Any:
    """RotorPy's vehicle, whose rotors may be weak (`left`, 0..1) and out of balance (`unbalance` [kg m])."""

    class Damageable(rotorpy("vehicles.multirotor").Multirotor):  # type: ignore[misc]
        left, unbalance = np.ones(values["num_rotors"]), np.zeros(values["num_rotors"])
        angle = chance.uniform(0.0, 2.0 * math.pi, values["num_rotors"])

        def compute_body_wrench(
            self, body_rates: FloatArray, rotor_speeds: FloatArray, body_airspeed_vector: FloatArray
        ) -> tuple[FloatArray, FloatArray]:
            speeds = rotor_speeds * np.sqrt(self.left)
            force, moment = super().compute_body_wrench(body_rates, speeds, body_airspeed_vector)
            size = self.unbalance * rotor_speeds**2
            shaken = np.stack((size * np.cos(self.angle), size * np.sin(self.angle), np.zeros_like(size)))
            return force + shaken.sum(axis=1), moment + np.cross(self.rotor_geometry, shaken.T).sum(axis=0)

    return Damageable(values, dict(state), integrator_kwargs=SOLVER)


def wanted(place: str, t_s: float, phase: float) -> dict[str, Any]:
    """The flat output of a place: a hover, a step of 0.5 m every 4 s, or a curve 2 m wide, whose nose may turn."""
    pace = PLACES[place]
    across, along = (1.0, 2.0) if "figure" in place else (1.0, 1.0)
    a, b, size = across * pace, along * pace, 1.0 if pace else 0.0
    turn_rad_s = 0.5 if "turning" in place else 0.0
    x = size * np.array([math.cos(a * t_s + phase), math.sin(b * t_s + phase), 0.0])
    v = size * np.array([-a * math.sin(a * t_s + phase), b * math.cos(b * t_s + phase), 0.0])
    turn = np.array([a * a, b * b, 0.0])
    nose = {"yaw": turn_rad_s * t_s, "yaw_dot": turn_rad_s, "yaw_ddot": 0.0}
    at = np.array([0.5, 0.0, 0.0]) * (int(t_s // 4.0) % 2) if place == "steps" else x
    return {"x": at, "x_dot": v, "x_ddot": -turn * x, "x_dddot": np.zeros(3), "x_ddddot": np.zeros(3), **nose}


def winds(case: Case, count: int) -> FloatArray:
    """Steady wind from the front, and RotorPy's Dryden gusts with the rms that is asked for, (count, 3)."""
    gust = rotorpy("wind.dryden_winds").DrydenGust(1.0 / RATE_HZ, np.zeros(3), np.ones(3))
    gusts = np.array([gust.update(0.0, np.zeros(3)) for _ in range(count)])
    air: FloatArray = gusts * (case.gusts_m_s / gusts.std(axis=0)) - np.array([case.wind_m_s, 0.0, 0.0])
    return air


def angles(quaternion: FloatArray) -> FloatArray:
    """Roll, pitch and yaw in FRD of an attitude in FLU [rad]."""
    yaw, pitch, roll = Rotation.from_quat(quaternion).as_euler("ZYX")
    return np.array([roll, -pitch, -yaw])


def flown(vehicle: str, seconds: float, case: Case, seed: int) -> md.Log:
    """The flight as a log, in FRD: what an autopilot records of it."""
    values = dict(rotorpy(f"vehicles.{vehicle}_params").quad_params)
    empty, count, top = values["mass"], values["num_rotors"], values["rotor_speed_max"]
    controller = rotorpy("controllers.quadrotor_control").SE3Control(values)
    controller.kp_att = controller.kp_att * case.gain
    values["mass"] = empty * (1.0 + case.load)  # the controller does not know
    chance, dt_s = np.random.default_rng(seed), 1.0 / RATE_HZ
    np.random.seed(seed)  # noqa: NPY002 - from which RotorPy draws
    hover = hover_of(values)
    state = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state |= {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(count, hover)}
    steps, before = (round(part_s * RATE_HZ) for part_s in (seconds, BEFORE_S))
    begin = wanted(case.place, -BEFORE_S, float(seed))
    state |= {"x": begin["x"], "v": begin["x_dot"]}
    plant = damageable(values, state, chance)
    of_grade = PROPELLER_SHARE * empty / hover / 1000.0  # kg m a mm/s
    plant.unbalance[:] = usual = USUAL_MM_S * of_grade * chance.uniform(0.2, 1.0, count) * carries_line(vehicle)
    noise = ({"noise_density": np.full(3, size)} for size in (ACCELEROMETER, GYRO))
    imu = rotorpy("sensors.imu").Imu(
        *({**one, "initial_bias": np.zeros(3), "random_walk": np.zeros(3)} for one in noise), sampling_rate=RATE_HZ
    )
    command = {"cmd_motor_speeds": np.full(count, hover)}
    wind, rows = winds(case, before + steps), []
    for k in range(-before, steps):
        done = max(k, 0) / steps
        plant.left[:], imu.gyro_bias = 1.0 - case.sag * done, np.full(3, case.drift_rad_s * done)
        if k >= steps // 2 and (not case.returns or k * dt_s % 4.0 < 1.0):
            plant.left[1] *= 1.0 - (1.0 - case.left) * (2.0 * done - 1.0 if case.fades else 1.0)
            plant.unbalance[1] = max(usual[1], case.balance_mm_s * of_grade)
        state["wind"] = wind[before + k]
        measured = imu.measurement(state, plant.statedot(state, command, dt_s))
        command = controller.update(
            k * dt_s, {**state, "w": measured["gyro"]}, wanted(case.place, k * dt_s, float(seed))
        )
        speeds = np.clip(command["cmd_motor_speeds"], 0.0, top)
        thrust = command["cmd_thrust"] / (count * values["k_eta"] * top**2)
        body = measured["gyro"] * FLU_TO_FRD, measured["accel"] * FLU_TO_FRD
        height = state["x"][2] + 2.0
        rows.append(
            np.concatenate((*body, angles(state["q"]), angles(command["cmd_q"]), [thrust], speeds / top, [height]))
        )
        half = -0.5 * dt_s * state["rotor_speeds"] * values["rotor_directions"]  # a rotor turns against its torque
        plant.angle = plant.angle + half
        state = plant.step(state, command, dt_s)
        plant.angle = plant.angle + half
    parts = np.split(np.array(rows[before:]), [3, 6, 9, 12, 13, 13 + count], axis=1)
    names = "body_rate", "specific_force", "attitude", "attitude_setpoint", "thrust_setpoint", "actuator", "height"
    t_s = np.arange(steps) * dt_s
    return md.Log.from_arrays(
        f"{case}, seed {seed}", {name: (t_s, part) for name, part in zip(names, parts, strict=True)}
    )


def airframe_of(vehicle: str) -> md.Airframe:
    """Its rotors, as RotorPy places them."""
    values = rotorpy(f"vehicles.{vehicle}_params").quad_params
    places = zip(values["rotor_pos"].values(), values["rotor_directions"], strict=True)
    effects = [(float(y), float(x), -float(turn)) for (x, y, _), turn in places]
    gate = GateSpec(min_thrust=0.03)  # it hovers at a tenth of its thrust
    return md.Airframe(name=vehicle, layout=layout_of_effects(vehicle, effects), gate=gate)


CASES = (
    *map(Case, PLACES),
    *(Case("circle", gusts_m_s=size) for size in (0.3, 1.0)),
    Case("circle", wind_m_s=2.0),
    Case("circle", load=0.1),
    Case("circle", sag=0.2),
    *(Case("circle", gain=gain) for gain in (0.8, 1.2)),
    Case("circle", drift_rad_s=0.003),
    *(Case(place, left=0.9, fades=True) for place in ("hover", "circle")),
    *(Case(place, left=0.9, returns=True) for place in ("hover", "circle")),
    *(Case(place, left=left) for place in ("hover", "circle") for left in (0.97, 0.95, 0.9, 0.8)),
    *(Case(place, balance_mm_s=grade) for place in ("hover", "circle") for grade in (16.0, 40.0, 100.0)),
)


def hover_of(values: Mapping[str, Any]) -> float:
    """The rotor speed that carries a vehicle [rad/s]."""
    return math.sqrt(values["mass"] * G / values["num_rotors"] / values["k_eta"])


def carries_line(vehicle: str) -> bool:
    """Whether a step is less than a third of a rotor's turn: what shakes is held for a step."""
    return hover_of(rotorpy(f"vehicles.{vehicle}_params").quad_params) < 2.0 * math.pi / 3.0 * RATE_HZ


def main() -> None:
    """Print what the verdicts are of."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="hummingbird", help="of rotorpy.vehicles")
    parser.add_argument("--seconds", type=float, default=40.0, help="of a flight")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--flights", type=int, default=4, help="of each case")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    cases = [case for case in CASES if not case.balance_mm_s or carries_line(arguments.vehicle)]
    cases = [*map(Case, TAUGHT), *(case for case in cases for _ in range(arguments.flights))]
    seeds = range(arguments.seed, arguments.seed + len(cases))
    with ProcessPoolExecutor(arguments.workers) as pool:
        fly = partial(flown, arguments.vehicle, arguments.seconds)
        logs = list(pool.map(fly, cases, seeds))
    baseline = md.learn(logs[: len(TAUGHT)], airframe=airframe_of(arguments.vehicle))
    print(f"{arguments.vehicle}: taught by {len(TAUGHT)} flights of {arguments.seconds:g} s; seed {arguments.seed}")
    found: dict[Case, list[md.LogVerdict]] = {}
    for case, log in zip(cases[len(TAUGHT) :], logs[len(TAUGHT) :], strict=True):
        found.setdefault(case, []).append(md.judge(log, baseline))
    table = Table("flight", "healthy", "suspected", "fault", "not judgeable", "names rotor 2", "another", "first [s]")
    for case, verdicts in found.items():
        counts = Counter(one.verdict for one in verdicts)
        kinds = md.Verdict.HEALTHY, md.Verdict.SUSPECTED, md.Verdict.FAULT, md.Verdict.NOT_JUDGEABLE
        rotors = Counter("other" if one.rotor != 2 else "right" for one in verdicts if one.rotor is not None)
        first = [one.events[0].t_s - arguments.seconds / 2 for one in verdicts if one.events]
        told = *(counts[kind] for kind in kinds), rotors["right"], rotors["other"]
        table.add_row(str(case), *(f"{one or '.'}" for one in told), f"{min(first):.1f}" if first else "")
    Console(width=120).print(table)
    for case, verdicts in found.items():
        if case.left == 1.0 and not case.balance_mm_s:
            for one in verdicts:
                if one.verdict is not md.Verdict.HEALTHY:
                    print(f"{case}: {one.verdict}: {one.reason.split(';')[0]}")


if __name__ == "__main__":
    main()
