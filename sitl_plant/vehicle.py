"""Vehicles are data: a TOML file with every number and its source becomes these frozen values.

Body frame FRD, origin at the geometric centre. A file may name another vehicle as its `base` and state only what
differs. What the file says is the *type*; one specimen of it is drawn in `sitl_plant.physics.airframe`.
"""

import math
from collections.abc import Mapping
from dataclasses import field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import Place, layout_at
from mavdiag.airframe.load import airframe_named
from mavdiag.errors import InputError, UsageError
from mavdiag.storage import read_toml
from mavdiag.telemetry import FloatArray
from mavdiag.units import G

_FOLDER = Path(__file__).parent
STRICT: Literal["forbid"] = "forbid"  # a misspelt key in the file is an error, not a default

Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share: TypeAlias = Annotated[float, Field(ge=0, lt=1)]
Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Vector: TypeAlias = tuple[Finite, Finite, Finite]
PositiveVector: TypeAlias = tuple[Positive, Positive, Positive]
Gain3: TypeAlias = tuple[NotNegative, NotNegative, NotNegative]
Range: TypeAlias = tuple[Positive, Positive]


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Body:
    """Rigid body and its air drag."""

    mass_kg: Positive
    inertia_kg_m2: PositiveVector
    drag_n_s_m: NotNegative
    hub_moment_n_s: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Rotor:
    """One rotor: hub in body FRD and sense of rotation seen from above."""

    name: str
    position_m: Vector
    spin: Literal["cw", "ccw"]

    @property
    def sign(self) -> float:
        """+1 if the rotor turns positively about body z (down), that is clockwise seen from above."""
        return 1.0 if self.spin == "cw" else -1.0


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Propulsion:
    """What all rotors of the type share (T Eq 2.5, 2.9-2.12)."""

    thrust_coefficient_n_s2: Positive
    thrust_per_torque_1_m: Positive
    motor_lag_s: Positive
    rotor_inertia_kg_m2: NotNegative
    effective_radius_m: Positive
    thrust_noise_rms: NotNegative
    thrust_noise_corner_hz: Positive
    unbalance_max_g_mm: NotNegative
    minimum_duty: Share
    load_share: Annotated[float, Field(ge=0, lt=1)] = 0.0  # of a motor's voltage that drag takes in hover; 0: T Eq 2.10


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Battery:
    """Voltage, sag and the duty-to-speed constant."""

    nominal_v: Positive
    motor_constant_rpm_v: Positive
    open_circuit_v: Positive
    resistance_ohm: NotNegative
    slope_v_per_ah: NotNegative
    drive_efficiency: Annotated[float, Field(gt=0, le=1)]
    avionics_a: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class SoftMount:
    """The mode between airframe and IMU, see `sitl_plant.physics.sensors`."""

    resonance_hz: Positive
    damping_ratio: Positive


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Imu:
    """Inertial sensor: place, noise density (one-sided), on-chip filter, bias, and its mount if that is not rigid."""

    position_m: Vector
    gyro_noise_density: NotNegative
    accel_noise_density: NotNegative
    filter_hz: Positive
    gyro_bias_rms: NotNegative
    mount: SoftMount | None = None


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class LandingGear:
    """Where the vehicle stands, and how it gives way."""

    points_m: Annotated[tuple[Vector, ...], Field(min_length=3)]  # body FRD
    natural_hz: Positive  # of the whole vehicle, bouncing on its gear
    damping_ratio: NotNegative  # of that bounce; 1 is critical
    friction: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class MotionCapture:
    """Cameras and the markers on the airframe (T 2.2.3)."""

    rate_hz: Positive
    latency_s: NotNegative
    marker_noise_rms_m: NotNegative
    occlusion_probability: Share
    markers_m: Annotated[tuple[Vector, ...], Field(min_length=3)]


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Piv:
    """One proportional-integral-velocity loop (T Eq 2.25-2.28)."""

    p: Finite
    v: Finite
    i: Finite


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Control:
    """Gains, filters and limits of the cascaded controller (T Eq 2.22-2.44)."""

    position: Piv
    altitude: Piv
    yaw: Piv
    attitude_p: Finite
    attitude_d: Finite
    rate_p: Finite
    rate_d: Finite
    yaw_rate_p: Finite
    gyro_filter_hz: Positive
    accel_filter_hz: Positive
    complementary_s: Positive
    velocity_filter_hz: Positive
    tilt_limit_rad: Positive
    rate_limit_rad_s: Positive
    yaw_rate_limit_rad_s: Positive
    integral_limit_rad: Positive
    torque_limit_n_m: PositiveVector
    thrust_limit_n: tuple[NotNegative, Positive]


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Spread:
    """How specimens of the type differ, and what age adds."""

    thrust_coefficient_rms: Share
    centre_of_gravity_rms_m: NotNegative
    motor_lag_rms: Share
    inertia_rms: Share
    battery_gain_max: Share
    aged_spread_factor: Positive
    aged_unbalance_factor: Positive
    aged_thrust_coefficient: Finite
    aged_motor_lag: Finite
    aged_noise_factor: Positive


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Wind:
    """How the wind varies about its mean."""

    gust_intensity: NotNegative
    gust_corner_hz: Positive


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Specimen:
    """A drone whose levels are known, by the name of its airframe. gyro_bias_roll: of IMU 0 and 1 [rad/s]."""

    name: str
    gyro_line: Positive
    gyro_broad: Positive
    gyro_bias_roll: tuple[Finite, Finite]
    second_harmonic: NotNegative


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class RecordedSet:
    """In place of the thesis's cascade and IMU: controller, IMUs, motors and ESC telemetry of the recorded QDrone 2.

    It flew the public recordings; every number and its source stand in `qdrone2-recorded.toml`. Filters are natural
    frequency [rad/s] and damping ratio; levels of vibration are rms as recorded in hover, behind filter and hold.
    """

    angle_gain: Positive  # of the manufacturer's cascade; pid rows are P, D, I; D acts on the measured rate
    rate_damping: NotNegative
    yaw_rate_gain: Positive
    rate_limit_rad_s: Positive
    torque_per_rate: PositiveVector
    torque_per_acceleration: Gain3
    torque_limit_n_m: PositiveVector
    horizontal_pid: Gain3
    altitude_pid: Gain3
    yaw_pid: Gain3
    trim_n: Positive
    tilt_limit_rad: Positive
    integral_limit: PositiveVector
    rate_filter: Range
    accel_filter: Range
    velocity_filter: Range
    complementary_p: NotNegative
    complementary_i: NotNegative
    thrust_map: tuple[Positive, NotNegative, Finite]  # F = a V^2 + b V + c of a rotor, as the controller believes
    thrust_over_command: Positive  # what the rotor really lifts at that voltage
    command_delay_s: NotNegative  # from the duty to the voltage
    imu_positions_m: tuple[Vector, Vector]  # IMU 0 is the one that a link carries
    gyro_period_s: Positive
    gyro_filter_hz: Positive
    gyro_range_rad_s: Positive
    gyro_lsb_rad_s: Positive
    gyro_bias_rms_rad_s: NotNegative
    accel_filter_hz: Positive
    accel_range_m_s2: Positive
    accel_lsb_m_s2: Positive
    gyro_line: Range  # lowest and highest of the roll gyro's line at one per revolution among specimens [rad/s]
    gyro_broad: Range  # of its broad part, 50 to 100 Hz [rad/s]
    gyro_axes: PositiveVector  # relative to roll
    accel_axes: PositiveVector  # of the accelerometer's line [m/s^2]
    accel_broad: NotNegative  # of all axes, 50 to 100 Hz [m/s^2]
    broad_corner_hz: Positive  # the broad part is white above it
    second_imu: Positive  # levels of IMU 1 relative to IMU 0
    second_harmonic: NotNegative  # at two per revolution relative to one per revolution, before the filter
    session_rms: NotNegative  # how much the line differs from flight to flight, of its logarithm
    esc_frame_s: Positive  # telemetry: from one motor to the next
    esc_over_read: Positive  # reported over true speed
    esc_first_s: NotNegative  # flight time of the first frame in a flight from the ground
    arm_s: Positive  # when the motors start
    lift_s: Positive
    ground_thrust_n: Positive  # commanded in between
    specimens: Annotated[tuple[Specimen, ...], Field(max_length=100)] = ()


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class HilPilot:
    """How one kind of autopilot flies the vehicle; rotors are counted from 1 as in the file."""

    rotors: tuple[Annotated[int, Field(ge=1)], ...]  # which one turns at the autopilot's motor output 1, 2, and so on
    # suggested for it, by their names; whole numbers are integer parameters
    parameters: Mapping[str, int | float] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Hil:
    """Outputs of autopilots. pwm_us: the pulses of duty 0 and 1, linear between them."""

    pwm_us: tuple[Positive, Positive]
    ardupilot: HilPilot
    px4: HilPilot


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Vehicle:
    """A type of multirotor, as its file describes it."""

    name: str
    body: Body
    rotors: Annotated[tuple[Rotor, ...], Field(min_length=4, max_length=12)]
    propulsion: Propulsion
    landing_gear: LandingGear
    battery: Battery
    imu: Imu
    mocap: MotionCapture
    control: Control
    spread: Spread
    wind: Wind
    recorded: RecordedSet | None = None  # flown in place of the thesis's controller and sensors
    hil: Hil | None = None  # what an autopilot outside needs; None if none can fly it

    @model_validator(mode="after")
    def _can_fly(self) -> Self:
        Ixx, Iyy, Izz = self.body.inertia_kg_m2
        if max(Ixx, Iyy, Izz) > Ixx + Iyy + Izz - max(Ixx, Iyy, Izz):
            raise ValueError("body.inertia_kg_m2 is no rigid body: one moment exceeds the sum of the others")
        if np.linalg.matrix_rank(allocation(self)) < 4:
            raise ValueError("rotors cannot command thrust, roll, pitch and yaw independently")
        markers = np.asarray(self.mocap.markers_m)
        if np.linalg.matrix_rank(markers - markers.mean(axis=0), tol=1e-3) < 2:
            raise ValueError("mocap.markers_m lie on one line")
        return self

    @property
    def hover_rad_s(self) -> float:
        """The rotor speed that carries it."""
        lift = self.body.mass_kg * G / (len(self.rotors) * self.propulsion.thrust_coefficient_n_s2)
        return math.sqrt(lift)


def airframe_of(vehicle: Vehicle, name: str) -> Airframe:
    """What a detector may know of such a vehicle: its rotors, its mass, and the rotor speed that carries it.

    The fault types were trained on the shipped QDrone 2 and hold for it alone.
    """
    places = [Place(rotor.position_m[0], rotor.position_m[1], rotor.spin) for rotor in vehicle.rotors]
    shipped = vehicle == qdrone2()
    return Airframe(
        name=name,
        layout=airframe_named("qdrone2").layout if shipped else layout_at(vehicle.name, places),
        mass_kg=vehicle.body.mass_kg,
        hover_rad_s=vehicle.hover_rad_s,
        classifier=airframe_named("qdrone2").classifier if shipped else None,
    )


def allocation(vehicle: Vehicle) -> FloatArray:
    """The motor mapping matrix in body FRD: rows thrust, roll, pitch, yaw; one column per rotor (T Eq 2.7).

    [ F     ]   [  1            ...]
    [ tau_x ] = [ -y_i          ...] @ [F_1 ... F_n]      thrust F_i acts along -z at (x_i, y_i)
    [ tau_y ]   [  x_i          ...]
    [ tau_z ]   [ -sign_i / K   ...]                      K = thrust per torque, 68.9055 1/m

    T has y to the left and z up: its Eq 2.3 and 2.4 are the negative of rows three and four. T Eq 2.6 prints K in the
    last row; only 2.7 and its inverse 2.8 agree.
    """
    hubs = np.array([rotor.position_m for rotor in vehicle.rotors])
    signs = np.array([rotor.sign for rotor in vehicle.rotors])
    return np.vstack([np.ones(len(hubs)), -hubs[:, 1], hubs[:, 0], -signs / vehicle.propulsion.thrust_per_torque_1_m])


def shipped_vehicles() -> tuple[str, ...]:
    """The names of the vehicles in this package; the first is the thesis's."""
    return ("qdrone2", *sorted({path.stem for path in _FOLDER.glob("*.toml")} - {"qdrone2"}))


@cache
def vehicle_named(name: str) -> Vehicle:
    """A vehicle of this package. Raises UsageError, listing the names, if there is none."""
    if name not in shipped_vehicles():
        raise UsageError(f"no vehicle {name!r}: give a FILE.toml or one of {', '.join(shipped_vehicles())}")
    return load_vehicle(_FOLDER / f"{name}.toml")


def vehicle_from(text: str) -> Vehicle:
    """The vehicle of a FILE.toml, or the shipped one of that name. Raises InputError or UsageError if there is none."""
    return load_vehicle(Path(text)) if text.endswith(".toml") else vehicle_named(text)


def qdrone2() -> Vehicle:
    """The vehicle of the thesis."""
    return vehicle_named("qdrone2")


def load_vehicle(path: Path) -> Vehicle:
    """Read a vehicle file. Raises InputError, naming the file and the field, if it cannot be used."""
    try:
        return TypeAdapter(Vehicle).validate_python(_table(path))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "vehicle"
        raise InputError(f"{path.name}: {where}: {first['msg']}") from error


def _table(path: Path) -> dict[str, Any]:
    table = read_toml(path)
    base = table.pop("base", None)
    if base is None:
        return table
    if base not in shipped_vehicles():
        raise InputError(f"{path.name}: base: give one of {', '.join(shipped_vehicles())}, not {base!r}")
    return _merged(_table(_FOLDER / f"{base}.toml"), table)


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    both = {name for name in base.keys() & own.keys() if isinstance(base[name], dict) and isinstance(own[name], dict)}
    return {**base, **own, **{name: _merged(base[name], own[name]) for name in both}}
