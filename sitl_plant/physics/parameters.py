"""From an airframe and a flight plan to the constants and the initial state of the compiled loop, for both sets.

A payload taken up in flight, or dropped, already moves as the vehicle does; the rotors keep their speed. With `shift`
the way of the centre of gravity, v' = v + omega × shift and omega' = omega: momentum is kept, and nothing jerks.

Vibration levels of a recorded set are given as recorded, so they are divided here by what the on-chip filter and the
hold leave of them. A rotor's share of the line, and its phase, belong to the specimen; the level also to the flight.
"""

import math
import zlib

import numpy as np

from mavdiag.telemetry import FloatArray
from mavdiag.units import RPM
from sitl_plant.physics import control, kernel, mocap, rotors, sensors
from sitl_plant.physics.air import Air
from sitl_plant.physics.airframe import Airframe, Payload
from sitl_plant.physics.dynamics import GRAVITY, NO_GROUND, RIGID, STAGES, WRENCH, Body, Ground, rotate_to_world
from sitl_plant.physics.trajectory import FLYING, REFERENCE, Path, reference
from sitl_plant.vehicle import RecordedSet, Specimen, Vehicle, allocation

STEP_S = 0.001  # T 5.1: 1 kHz
TAKEOFF_SHARE = 0.7  # of the weight: where the thrust starts when the motors lift (our choice)
SPECIMEN_STREAM = 0x5EC  # our choice: which random streams these are
LEVELS, BIAS, LINE = 0, 1, 2  # what a specimen's streams are for
BAND_HZ = (50.0, 100.0)  # in which the broad level is given


def make_model(
    airframe: Airframe, payload: Payload, path: Path, wind_N: FloatArray, turbulent: bool = False
) -> kernel.Model:
    """The constants of a flight. A path from the ground brings the ground.

    wind_N: (3,) mean wind, world NED [m/s]. turbulent: the gusts are given, and the vehicle file's are left out.
    """
    vehicle, imu, loops = airframe.vehicle, airframe.vehicle.imu, airframe.vehicle.control
    battery, propulsion, cameras = vehicle.battery, vehicle.propulsion, vehicle.mocap
    body, centre = body_with_payload(airframe, payload)
    noise = math.sqrt(0.5 / STEP_S) * np.repeat([imu.gyro_noise_density, imu.accel_noise_density], 3)
    torque = propulsion.thrust_coefficient_n_s2 / propulsion.thrust_per_torque_1_m
    period = max(1, round(1.0 / (cameras.rate_hz * STEP_S)))
    gust_rms = float(vehicle.wind.gust_intensity * np.linalg.norm(wind_N))
    return kernel.Model(
        dt=STEP_S,
        body=body,
        ground=_ground(vehicle, body, centre) if path.start > 0.0 else NO_GROUND,
        rotors=rotors.Rotors(
            hub=np.array([rotor.position_m for rotor in vehicle.rotors]) - centre,
            sign=np.array([rotor.sign for rotor in vehicle.rotors]),
            thrust_coefficient=airframe.thrust_coefficient_n_s2,
            lag=airframe.motor_lag_s,
            decay=np.exp(-0.5 * STEP_S / airframe.motor_lag_s)[:, None] ** np.arange(STAGES),
            torque_per_thrust=1.0 / propulsion.thrust_per_torque_1_m,
            inertia=propulsion.rotor_inertia_kg_m2,
            noise_rms=airframe.thrust_noise_rms,
            noise_decay=_decay(propulsion.thrust_noise_corner_hz),
        ),
        battery=rotors.Battery(
            speed_per_volt=battery.motor_constant_rpm_v * RPM * airframe.battery_gain,
            open_circuit=battery.open_circuit_v,
            resistance=battery.resistance_ohm,
            slope=battery.slope_v_per_ah,
            power_per_cube=torque / battery.drive_efficiency,
            avionics=battery.avionics_a,
        ),
        air=Air(wind_N, 1.0, 0.0) if turbulent else Air(wind_N, gust_rms, _decay(vehicle.wind.gust_corner_hz)),
        imu=sensors.Imu(
            position=np.asarray(imu.position_m) - centre,
            bias=np.concatenate([airframe.gyro_bias, np.zeros(3)]),
            noise=noise,
            filter=sensors.butterworth(imu.filter_hz, STEP_S),
            mount=sensors.mode(imu.mount.resonance_hz, imu.mount.damping_ratio, STEP_S) if imu.mount else sensors.RIGID,
        ),
        mocap=mocap.Mocap(
            markers=np.array(cameras.markers_m),
            centre=-centre,
            noise=cameras.marker_noise_rms_m,
            occlusion=cameras.occlusion_probability,
            period=period,
            latency=round(cameras.latency_s / STEP_S),
            frame_s=period * STEP_S,
            velocity_gain=1.0 - math.exp(-2.0 * math.pi * loops.velocity_filter_hz * (period * STEP_S)),
        ),
        estimator=control.Estimator(
            gyro_filter=control.second_order(2.0 * math.pi * loops.gyro_filter_hz, math.sqrt(0.5), STEP_S),
            accel_gain=1.0 - _decay(loops.accel_filter_hz),
            correction=STEP_S / loops.complementary_s,
        ),
        controller=make_controller(vehicle),
        path=path,
    )


def body_with_payload(airframe: Airframe, *payloads: Payload) -> tuple[Body, FloatArray]:
    """Rigid body of airframe and payloads, and its centre of gravity (3,) from the geometric centre.

    I = I_a + mu (|d|^2 E - d d^T), mu = m_a m_p / (m_a + m_p), d from one centre to the other (parallel axes, twice),
    for one payload after the other.
    """
    own = airframe.vehicle.body
    mass, centre, inertia = own.mass_kg, airframe.centre_of_gravity_m, np.diag(airframe.inertia_kg_m2)
    for payload in payloads:
        before, mass = mass, mass + payload.mass_kg
        apart = np.asarray(payload.position_m) - centre
        inertia = inertia + before * payload.mass_kg / mass * (apart @ apart * np.eye(3) - np.outer(apart, apart))
        centre = centre + payload.mass_kg / mass * apart
    hub_moment = own.hub_moment_n_s * len(airframe.vehicle.rotors)
    return Body(mass, inertia, np.asarray(np.linalg.inv(inertia), dtype=np.float64), own.drag_n_s_m, hub_moment), centre


def _decay(corner_hz: float) -> float:
    return math.exp(-2.0 * math.pi * corner_hz * STEP_S)


def _ground(vehicle: Vehicle, body: Body, centre_of_gravity: FloatArray) -> Ground:
    """The plane on which the vehicle stands with its geometric centre at z = 0, but for the sag of the gear."""
    gear = vehicle.landing_gear
    points = np.array(gear.points_m)
    level, omega = float(points[:, 2].max()), 2.0 * math.pi * gear.natural_hz
    return Ground(
        gear=points - centre_of_gravity,
        stuck=np.zeros((len(points), 2)),
        level=level,
        reach=level - float(np.linalg.norm(points - centre_of_gravity, axis=1).max()),
        stiffness=body.mass * omega**2 / len(points),
        damping=2.0 * gear.damping_ratio * body.mass * omega / len(points),
        friction=gear.friction,
    )


def make_controller(vehicle: Vehicle) -> control.Controller:
    """The gains and limits of a vehicle's file."""
    given, full_speed = vehicle.control, vehicle.battery.motor_constant_rpm_v * RPM * vehicle.battery.nominal_v
    loops = (given.position, given.position, given.altitude, given.yaw)
    tilt, lift, turn = given.integral_limit_rad, given.thrust_limit_n[1], given.yaw_rate_limit_rad_s
    damped = np.array([[given.rate_p, given.rate_d], [given.rate_p, given.rate_d], [given.yaw_rate_p, 0.0]])
    thesis = control.Controller(
        pose=np.array([[loop.p, loop.v, loop.i] for loop in loops]),
        trim=0.0,
        yaw_rate=1.0,
        attitude_p=given.attitude_p,
        attitude_d=given.attitude_d,
        rate_gain=np.array(vehicle.body.inertia_kg_m2)[:, None] * damped,
        mixer=np.asarray(np.linalg.pinv(allocation(vehicle)), dtype=np.float64),
        full_thrust=vehicle.propulsion.thrust_coefficient_n_s2 * full_speed**2,
        ground_thrust=0.0,
        minimum_duty=vehicle.propulsion.minimum_duty,
        tilt_limit=given.tilt_limit_rad,
        rate_limit=np.array([given.rate_limit_rad_s, given.rate_limit_rad_s, turn]),
        integral_limit=np.array([tilt, tilt, lift, turn]),
        torque_limit=np.array(given.torque_limit_n_m),
        thrust_limit=np.array(given.thrust_limit_n),
    )
    own, volts = vehicle.recorded, vehicle.battery.nominal_v
    if own is None:
        return thesis
    a, b, c = own.thrust_map
    pids = (own.horizontal_pid, own.horizontal_pid, own.altitude_pid, own.yaw_pid)
    return thesis._replace(
        pose=np.array([(p, d, i) for p, d, i in pids]),
        trim=own.trim_n,
        yaw_rate=own.yaw_rate_gain,
        attitude_p=own.angle_gain,
        attitude_d=-own.rate_damping,
        rate_gain=np.column_stack([own.torque_per_rate, -np.array(own.torque_per_acceleration)]),
        full_thrust=own.thrust_over_command * (a * volts * volts + b * volts + c),
        ground_thrust=own.ground_thrust_n,
        tilt_limit=own.tilt_limit_rad,
        rate_limit=np.full(3, own.rate_limit_rad_s),
        integral_limit=np.array(own.integral_limit)[[0, 0, 1, 2]],
        torque_limit=np.array(own.torque_limit_n_m),
    )


def initial_state(model: kernel.Model, azimuth: FloatArray, charge_used_ah: float = 0.0) -> kernel.State:
    """At the first point of the path, level, nearly in trim: in hover, or on the ground with resting rotors.

    azimuth: (n,) of the rotors at the start [rad]. charge_used_ah: drawn from the battery before.
    """
    n = len(azimuth)
    start = np.zeros(REFERENCE)
    reference(model.path, -1.0, start)
    weight = model.body.mass * GRAVITY
    lift = weight if start[8] == FLYING else 0.0
    speed = np.sqrt(lift / n / model.rotors.thrust_coefficient)
    z = np.zeros
    columns = kernel.told_columns(n)
    told = z(columns["esc"].stop)
    parts = {name: told[place] for name, place in columns.items()}
    rigid, reading, estimate, wrench = parts["rigid"], parts["imu"], parts["estimate"], z((STAGES, WRENCH))
    parts["battery"][:] = model.battery.open_circuit - model.battery.slope * charge_used_ah, charge_used_ah
    parts["wrench"][0], parts["motors"][0], parts["speed"][:] = lift, start[8], speed
    rigid[:3], rigid[6], rigid[9] = start[:3], math.cos(start[6] / 2), math.sin(start[6] / 2)
    wrench[:, 2], reading[5], estimate[2] = -lift, -GRAVITY, start[6]
    markers, latency = len(model.mocap.markers), model.mocap.latency
    pose, wave = np.array([*start[:3], start[6]]), np.full((latency + 1, 4), np.nan)
    integral = np.array([0.0, 0.0, -weight if lift else -TAKEOFF_SHARE * weight, 0.0])
    seen, turn = z(markers, dtype=np.int64), np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    rate, duty, motors = parts["rate"], parts["duty"], parts["motors"]
    return kernel.State(
        told=told,
        rigid=rigid,
        wrench=wrench,
        wind=model.air.mean.copy(),
        battery=parts["battery"],
        rotors=rotors.RotorState(parts["speed"], azimuth.copy(), turn, z(n), z(n), np.full(n, lift / n)),
        imu=sensors.ImuState(z((sensors.CHANNELS, 2)), z(sensors.CHANNELS), reading, z((sensors.CHANNELS, 2))),
        mocap=mocap.MocapState(wave, pose, z(3), np.full(1, np.nan), z((markers, 3)), seen, z(RIGID), z((9, 4))),
        estimate=estimate,
        accel_filtered=reading[3:].copy(),
        control=control.ControlState(integral, parts["setpoint"], rate, parts["wrench"], duty, motors),
        work=z((5, RIGID)),
        truth=z((sensors.IMUS, sensors.CHANNELS)),
        path=z(REFERENCE),
        command=z(n),
    )


def reload(model: kernel.Model, state: kernel.State, airframe: Airframe, payloads: tuple[Payload, ...]) -> kernel.Model:
    """The model with these payloads on the airframe; `state` is changed to that of the new centre of gravity."""
    body, centre = body_with_payload(airframe, *payloads)
    shift = centre + model.mocap.centre  # mocap.centre is the way back to the geometric centre
    state.rigid[3:6] += rotate_to_world(state.rigid, *np.cross(state.rigid[10:13], shift).tolist())
    state.rigid[:3] += rotate_to_world(state.rigid, *shift.tolist())
    state.wrench[:, 3:6] -= np.cross(shift, state.wrench[:, :3])
    ground = model.ground
    if len(ground.gear):
        gear = ground.gear - shift
        ground = ground._replace(gear=gear, reach=ground.level - float(np.linalg.norm(gear, axis=1).max()))
    return model._replace(
        body=body,
        ground=ground,
        rotors=model.rotors._replace(hub=model.rotors.hub - shift),
        imu=model.imu._replace(position=model.imu.position - shift),
        mocap=model.mocap._replace(centre=-centre),
    )


def recorded_set(
    airframe: Airframe, recorded: RecordedSet, model: kernel.Model, state: kernel.State, seed: int
) -> kernel.Recorded:
    """The recorded set for one flight. `state` is set to its trim."""
    scale = math.exp(recorded.session_rms * kernel.recorded_streams(seed)[0].standard_normal())
    flown, dt, n, z = state.control, model.dt, len(state.control.duty), np.zeros
    queue = z((round(recorded.command_delay_s / dt) + 1, n))
    flown.integral[:] = 0.0
    if flown.motors[0] == FLYING:
        thrust = flown.wrench[0] / recorded.thrust_over_command
        flown.integral[2] = model.controller.trim - thrust  # down is positive
        flown.wrench[0] = thrust
        queue[:] = control.voltage_of(recorded.thrust_map, thrust / n) / state.battery[0]
    imus = _imus(airframe, recorded, model, scale, state.imu.drifted)
    pairs = recorded.rate_filter, recorded.accel_filter, recorded.velocity_filter
    rate, slope, speed = (control.second_order(*pair, dt) for pair in pairs)
    angle, accel, still = z((sensors.IMUS, 3)), imus.reading[:, 3:].copy(), [z((sensors.IMUS, 3)) for _ in range(3)]
    angle[:, 2] = state.estimate[2]
    estimator = rate, slope, speed, recorded.complementary_p, recorded.complementary_i, angle, still[0], still[1], accel
    lifted = recorded.thrust_over_command * airframe.battery_gain
    esc = state.told[-n:]
    esc[:] = np.nan
    return kernel.Recorded(
        imus=imus,
        estimates=control.TwinEstimator(*estimator, still[2], z((sensors.IMUS, 2)), state.mocap.pose.copy(), z(4)),
        thrust_map=recorded.thrust_map,
        squared_per_thrust=lifted / airframe.vehicle.propulsion.thrust_coefficient_n_s2,
        esc_period=max(1, round(recorded.esc_frame_s / dt)),
        esc_first=round(recorded.esc_first_s / dt) if model.path.start > 0.0 else -(1 << 62),
        over_read=recorded.esc_over_read,
        queue=queue,
        esc=esc,
    )


def specimen_of(airframe: Airframe, recorded: RecordedSet) -> Specimen:
    """The levels of an airframe: those of its name in the file, or drawn by its constants between the extremes."""
    known = {specimen.name: specimen for specimen in recorded.specimens}
    if airframe.name in known:
        return known[airframe.name]
    rng, extremes = _specimen_stream(airframe, LEVELS), (recorded.gyro_line, recorded.gyro_broad)
    line, broad = (float(np.exp(rng.uniform(*np.log(pair)))) for pair in extremes)
    bias = (recorded.gyro_bias_rms_rad_s * rng.standard_normal(sensors.IMUS)).tolist()
    return Specimen(airframe.name, line, broad, (bias[0], bias[1]), recorded.second_harmonic)


def _specimen_stream(airframe: Airframe, purpose: int) -> np.random.Generator:
    return np.random.default_rng([SPECIMEN_STREAM, purpose, zlib.crc32(airframe.thrust_coefficient_n_s2.tobytes())])


def _kept(filters: FloatArray, frequency_hz: FloatArray, dt: float, held: int) -> FloatArray:
    """Gain of the on-chip low-pass and of the hold over `held` steps, sin(N x) / (N sin x) with x = pi f dt."""
    gain = sensors.gain_of(filters[0], frequency_hz, dt) * sensors.gain_of(filters[1], frequency_hz, dt)
    x = np.pi * frequency_hz * dt
    return np.asarray(gain * np.abs(np.sin(held * x) / (held * np.sin(x))))


def _imus(
    airframe: Airframe, recorded: RecordedSet, model: kernel.Model, session: float, drifted: FloatArray
) -> sensors.TwinImu:
    from scipy.signal import butter  # only a vehicle as it was recorded has it

    specimen, propulsion, chip = specimen_of(airframe, recorded), airframe.vehicle.propulsion, airframe.vehicle.imu
    n, dt = len(airframe.vehicle.rotors), model.dt
    hover = math.sqrt(GRAVITY * airframe.vehicle.body.mass_kg / n / propulsion.thrust_coefficient_n_s2)
    period = max(1, round(recorded.gyro_period_s / dt))
    corners = [recorded.gyro_filter_hz] * 3 + [recorded.accel_filter_hz] * 3
    filters = np.array([butter(3, corner_hz * dt, fs=1.0, output="sos")[:, [0, 1, 2, 4, 5]] for corner_hz in corners])
    shape, band_hz = sensors.butterworth(recorded.broad_corner_hz, dt, "highpass"), np.linspace(*BAND_HZ, 101)
    shaped, width = sensors.gain_of(shape, band_hz, dt), 2.0 * dt * (BAND_HZ[1] - BAND_HZ[0])
    line = np.concatenate([specimen.gyro_line * np.array(recorded.gyro_axes), recorded.accel_axes])
    broad = np.concatenate([specimen.gyro_broad * np.array(recorded.gyro_axes), np.full(3, recorded.accel_broad)])
    for channel, held in enumerate([period] * 3 + [1] * 3):
        line[channel] /= _kept(filters[channel], np.array([hover / (2.0 * np.pi)]), dt, held)[0]
        gain = shaped * _kept(filters[channel], band_hz, dt, held)
        broad[channel] /= math.sqrt(float(np.mean(gain**2)) * width)
    ratio, bias = np.array([1.0, recorded.second_imu]), np.zeros((sensors.IMUS, sensors.CHANNELS))
    bias[:, 0] = specimen.gyro_bias_roll
    drawn = _specimen_stream(airframe, BIAS).standard_normal((sensors.IMUS, 2))
    bias[:, 1:3] = recorded.gyro_bias_rms_rad_s * drawn
    white = math.sqrt(0.5 / dt) * np.repeat([chip.gyro_noise_density, chip.accel_noise_density], 3)
    # amplitudes of the specimen's rotors, (2, 6, 2, n, 2); their squares sum to 2 level^2
    rng = _specimen_stream(airframe, LINE)
    share = rng.uniform(0.5, 1.5, (sensors.IMUS, sensors.CHANNELS, sensors.HARMONICS, n))
    share /= np.sqrt((share**2).sum(axis=-1, keepdims=True))
    phase = rng.uniform(0.0, 2.0 * np.pi, share.shape)
    level, harmonics = session * np.outer(ratio, line), np.array([1.0, specimen.second_harmonic])
    amplitude = math.sqrt(2.0) * level[:, :, None, None] * harmonics[:, None] * share
    z, channels, reading = np.zeros, sensors.IMUS * sensors.CHANNELS, np.zeros((sensors.IMUS, sensors.CHANNELS))
    reading[:, 5] = -GRAVITY
    return sensors.TwinImu(
        position=np.array(recorded.imu_positions_m) + model.mocap.centre,
        bias=bias,
        white=np.array([white] * sensors.IMUS),
        broad=np.outer(ratio, broad),
        line=np.stack([amplitude * np.cos(phase), amplitude * np.sin(phase)], axis=-1),
        hover=hover,
        shape=shape,
        filters=filters,
        span=np.repeat([recorded.gyro_range_rad_s, recorded.accel_range_m_s2], 3),
        lsb=np.repeat([recorded.gyro_lsb_rad_s, recorded.accel_lsb_m_s2], 3),
        gyro_period=period,
        shaped=z((channels, 2)),
        memory=z((channels, 4)),
        drifted=drifted,
        reading=reading,
        turns=z((sensors.HARMONICS, n, 2)),
    )
