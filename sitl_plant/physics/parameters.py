"""From an airframe and a flight plan to the constants and the initial state of the compiled loop."""

import math

import numpy as np

from mavdiag.telemetry import FloatArray
from mavdiag.units import RPM
from sitl_plant.physics.airframe import Airframe, Payload
from sitl_plant.physics.attitude import ESTIMATE, Estimator, low_pass_transition
from sitl_plant.physics.controller import Controller, ControlState
from sitl_plant.physics.dynamics import GRAVITY, NO_GROUND, RIGID, STAGES, WRENCH, Body, Ground
from sitl_plant.physics.kernel import Model, State
from sitl_plant.physics.mocap import Mocap, MocapState
from sitl_plant.physics.mount import RIGID_MOUNT, Mount, mode
from sitl_plant.physics.rotors import Rotors, RotorState
from sitl_plant.physics.sensors import CHANNELS, Imu, ImuState, butterworth
from sitl_plant.physics.supply import Air, Battery
from sitl_plant.physics.trajectory import FLYING, REFERENCE, Path, reference
from sitl_plant.vehicle import Vehicle, allocation

__all__ = ["STEP_S", "air_of", "body_with_payload", "initial_state", "make_model"]

STEP_S = 0.001  # T 5.1: 1 kHz
TAKEOFF_SHARE = 0.7  # of the weight: where the thrust starts when the motors lift (our choice)


def make_model(airframe: Airframe, payload: Payload, path: Path, wind_N: FloatArray, turbulent: bool = False) -> Model:
    """The constants of a flight. A path from the ground brings the ground.

    wind_N: (3,) mean wind, world NED [m/s]. turbulent: the gusts are given, and the vehicle file's are left out.
    """
    vehicle = airframe.vehicle
    body, centre_of_gravity = body_with_payload(airframe, payload)
    return Model(
        dt=STEP_S,
        body=body,
        ground=_ground(vehicle, body, centre_of_gravity) if path.start > 0.0 else NO_GROUND,
        rotors=_rotors(airframe, centre_of_gravity),
        battery=_battery(airframe),
        air=air_of(vehicle, wind_N, turbulent),
        imu=_imu(airframe, centre_of_gravity),
        mount=_mount(vehicle),
        mocap=_mocap(vehicle, centre_of_gravity),
        estimator=Estimator(
            gyro_filter=low_pass_transition(vehicle.control.gyro_filter_hz, STEP_S),
            accel_gain=1.0 - _decay(vehicle.control.accel_filter_hz),
            correction=STEP_S / vehicle.control.complementary_s,
        ),
        controller=_controller(vehicle),
        path=path,
    )


def air_of(vehicle: Vehicle, wind_N: FloatArray, turbulent: bool = False) -> Air:
    """The wind, with arguments as those of `make_model`."""
    return Air(
        mean=wind_N,
        gust_rms=1.0 if turbulent else float(vehicle.wind.gust_intensity * np.linalg.norm(wind_N)),
        decay=0.0 if turbulent else _decay(vehicle.wind.gust_corner_hz),
    )


def body_with_payload(airframe: Airframe, *payloads: Payload) -> tuple[Body, FloatArray]:
    """Rigid body of airframe and payloads, and its centre of gravity (3,) from the geometric centre.

    I = I_a + mu (|d|^2 E - d d^T), mu = m_a m_p / (m_a + m_p), d from one centre to the other (parallel axes, twice),
    for one payload after the other.
    """
    own = airframe.vehicle.body
    mass, centre = own.mass_kg, airframe.centre_of_gravity_m
    inertia = np.diag(airframe.inertia_kg_m2)
    for payload in payloads:
        before, mass = mass, mass + payload.mass_kg
        apart = np.asarray(payload.position_m) - centre
        inertia = inertia + before * payload.mass_kg / mass * (apart @ apart * np.eye(3) - np.outer(apart, apart))
        centre = centre + payload.mass_kg / mass * apart
    hub_moment = own.hub_moment_n_s * len(airframe.vehicle.rotors)
    return Body(mass, inertia, np.asarray(np.linalg.inv(inertia), dtype=np.float64), own.drag_n_s_m, hub_moment), centre


def _decay(corner_hz: float) -> float:
    """exp(-2 pi f dt): what a first-order filter or an Ornstein-Uhlenbeck process keeps over one step."""
    return math.exp(-2.0 * math.pi * corner_hz * STEP_S)


def _ground(vehicle: Vehicle, body: Body, centre_of_gravity: FloatArray) -> Ground:
    """The plane on which the vehicle stands with its geometric centre at z = 0, but for the sag of the gear."""
    gear = vehicle.landing_gear
    points = np.array(gear.points_m)
    level = float(points[:, 2].max())
    omega = 2.0 * math.pi * gear.natural_hz
    return Ground(
        gear=points - centre_of_gravity,
        stuck=np.zeros((len(points), 2)),
        level=level,
        reach=level - float(np.linalg.norm(points - centre_of_gravity, axis=1).max()),
        stiffness=body.mass * omega**2 / len(points),
        damping=2.0 * gear.damping_ratio * body.mass * omega / len(points),
        friction=gear.friction,
    )


def _rotors(airframe: Airframe, centre_of_gravity: FloatArray) -> Rotors:
    vehicle = airframe.vehicle
    return Rotors(
        hub=np.array([rotor.position_m for rotor in vehicle.rotors]) - centre_of_gravity,
        sign=np.array([rotor.sign for rotor in vehicle.rotors]),
        thrust_coefficient=airframe.thrust_coefficient_n_s2,
        lag=airframe.motor_lag_s,
        torque_per_thrust=1.0 / vehicle.propulsion.thrust_per_torque_1_m,
        inertia=vehicle.propulsion.rotor_inertia_kg_m2,
        noise_rms=airframe.thrust_noise_rms,
        noise_decay=_decay(vehicle.propulsion.thrust_noise_corner_hz),
    )


def _battery(airframe: Airframe) -> Battery:
    battery, propulsion = airframe.vehicle.battery, airframe.vehicle.propulsion
    torque = propulsion.thrust_coefficient_n_s2 / propulsion.thrust_per_torque_1_m
    return Battery(
        speed_per_volt=battery.motor_constant_rpm_v * RPM * airframe.battery_gain,
        open_circuit=battery.open_circuit_v,
        resistance=battery.resistance_ohm,
        slope=battery.slope_v_per_ah,
        power_per_cube=torque / battery.drive_efficiency,
        avionics=battery.avionics_a,
    )


def _imu(airframe: Airframe, centre_of_gravity: FloatArray) -> Imu:
    """White noise of one-sided density D has rms D sqrt(f_s / 2) per sample."""
    imu = airframe.vehicle.imu
    per_sample = math.sqrt(0.5 / STEP_S)
    return Imu(
        position=np.asarray(imu.position_m) - centre_of_gravity,
        bias=np.concatenate([airframe.gyro_bias, np.zeros(3)]),
        noise=per_sample * np.repeat([imu.gyro_noise_density, imu.accel_noise_density], 3),
        filter=butterworth(imu.filter_hz, STEP_S),
    )


def _mount(vehicle: Vehicle) -> Mount:
    soft = vehicle.imu.mount
    return RIGID_MOUNT if soft is None else mode(soft.resonance_hz, soft.damping_ratio, STEP_S)


def _mocap(vehicle: Vehicle, centre_of_gravity: FloatArray) -> Mocap:
    mocap = vehicle.mocap
    period = max(1, round(1.0 / (mocap.rate_hz * STEP_S)))
    frame_s = period * STEP_S
    return Mocap(
        markers=np.array(mocap.markers_m),
        centre=-centre_of_gravity,
        noise=mocap.marker_noise_rms_m,
        occlusion=mocap.occlusion_probability,
        period=period,
        latency=round(mocap.latency_s / STEP_S),
        frame_s=frame_s,
        velocity_gain=1.0 - math.exp(-2.0 * math.pi * vehicle.control.velocity_filter_hz * frame_s),
    )


def _full_thrust(vehicle: Vehicle) -> float:
    """K_F K_omega^2 [N]: thrust of one motor at full duty and nominal voltage (T Eq 2.12)."""
    full_speed = vehicle.battery.motor_constant_rpm_v * RPM * vehicle.battery.nominal_v
    return vehicle.propulsion.thrust_coefficient_n_s2 * full_speed**2


def _controller(vehicle: Vehicle) -> Controller:
    control = vehicle.control
    inertia = np.array(vehicle.body.inertia_kg_m2)
    loops = (control.position, control.position, control.altitude, control.yaw)
    tilt, lift = control.integral_limit_rad, control.thrust_limit_n[1]
    damped = np.array([[control.rate_p, control.rate_d], [control.rate_p, control.rate_d], [control.yaw_rate_p, 0.0]])
    return Controller(
        pose=np.array([[loop.p, loop.v, loop.i] for loop in loops]),
        attitude_p=control.attitude_p,
        attitude_d=control.attitude_d,
        rate_gain=inertia[:, None] * damped,
        mixer=np.asarray(np.linalg.pinv(allocation(vehicle)), dtype=np.float64),
        full_thrust=_full_thrust(vehicle),
        minimum_duty=vehicle.propulsion.minimum_duty,
        tilt_limit=control.tilt_limit_rad,
        rate_limit=control.rate_limit_rad_s,
        yaw_rate_limit=control.yaw_rate_limit_rad_s,
        integral_limit=np.array([tilt, tilt, lift, control.yaw_rate_limit_rad_s]),
        torque_limit=np.array(control.torque_limit_n_m),
        thrust_limit=np.array(control.thrust_limit_n),
    )


def initial_state(model: Model, azimuth: FloatArray, charge_used_ah: float = 0.0) -> State:
    """At the first point of the path, level, nearly in trim: in hover, or on the ground with resting rotors.

    azimuth: (n,) of the rotors at the start [rad]. charge_used_ah: drawn from the battery before.
    """
    n = len(azimuth)
    start = np.zeros(REFERENCE)
    reference(model.path, -1.0, start)
    weight = model.body.mass * GRAVITY
    lift = weight if start[8] == FLYING else 0.0
    speed = np.sqrt(lift / n / model.rotors.thrust_coefficient)
    rigid = np.zeros(RIGID)
    rigid[:3] = start[:3]
    rigid[6], rigid[9] = math.cos(start[6] / 2), math.sin(start[6] / 2)
    wrench = np.zeros((STAGES, WRENCH))
    wrench[:, 2] = -lift
    reading = np.zeros(CHANNELS)
    reading[5] = -GRAVITY
    estimate = np.zeros(ESTIMATE)
    estimate[2] = start[6]
    markers = len(model.mocap.markers)
    return State(
        rigid=rigid,
        wrench=wrench,
        wind=model.air.mean.copy(),
        battery=np.array([model.battery.open_circuit - model.battery.slope * charge_used_ah, charge_used_ah]),
        rotors=RotorState(speed, azimuth.copy(), np.zeros(n), np.zeros(n), np.full(n, lift / n)),
        imu=ImuState(np.zeros((CHANNELS, 2)), np.zeros(CHANNELS), reading),
        mount=np.zeros((CHANNELS, 2)),
        mocap=MocapState(
            queue=np.full((model.mocap.latency + 1, 4), np.nan),
            pose=np.array([*start[:3], start[6]]),
            velocity=np.zeros(3),
            received=np.full(1, np.nan),
            seen=np.zeros((markers, 3)),
            visible=np.zeros(markers, dtype=np.int64),
            fit=np.zeros(RIGID),
        ),
        estimate=estimate,
        accel_filtered=reading[3:].copy(),
        control=ControlState(
            integral=np.array([0.0, 0.0, -weight if lift else -TAKEOFF_SHARE * weight, 0.0]),
            setpoint=np.zeros(3),
            rate=np.zeros(3),
            wrench=np.array([lift, 0.0, 0.0, 0.0]),
            duty=np.zeros(n),
            motors=np.array([start[8]]),
        ),
    )
