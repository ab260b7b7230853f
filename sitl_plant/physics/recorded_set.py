"""From a vehicle file's `[recorded]` table and a specimen to the constants and the state of `recorded_kernel`.

Vibration levels are given as recorded, so they are divided here by what the on-chip filter and the hold leave of them.
Which share a rotor has in the line, and at which phase, belongs to the specimen; the level also to the flight.
"""

import math
import zlib
from dataclasses import dataclass

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import Airframe
from sitl_plant.physics.dynamics import GRAVITY
from sitl_plant.physics.kernel import Model, Noise, Rows, State
from sitl_plant.physics.recorded_control import Feedback, Loop, LoopState, second_order, voltage_of
from sitl_plant.physics.recorded_kernel import OwnModel, OwnState, fly_recorded
from sitl_plant.physics.recorded_log import log_columns
from sitl_plant.physics.recorded_sensors import HARMONICS, IMUS, TwinImu, TwinImuState, butterworth3, high_pass
from sitl_plant.physics.rotors import Condition
from sitl_plant.physics.sensors import CHANNELS, SensorCondition
from sitl_plant.physics.trajectory import FLYING
from sitl_plant.vehicle import Vehicle, allocation
from sitl_plant.vehicle_recorded import Motors, Recorded, Sensors, Specimen

__all__ = ["RecordedFlight", "recorded_flight", "specimen_of"]

NORMALS = 2 * IMUS * CHANNELS
SPECIMEN_STREAM, FLIGHT_STREAM = 0x5EC, 0xF17  # our choice: which random streams these are
LEVELS, BIAS, LINE = 0, 1, 2  # what a specimen's streams are for
BAND_HZ = (50.0, 100.0)  # in which the broad level is given


@dataclass(slots=True)
class RecordedFlight:
    """One flight of such a vehicle: what `Plant` holds beside its model and state.

    model: the plant's, with the thrust at full duty by the motors' map.
    columns: of the log.
    """

    model: Model
    columns: int
    _own: OwnModel
    _state: OwnState
    _rng: np.random.Generator

    def forget_drift(self) -> None:
        """Take back what the sensors drifted."""
        self._state.imus.drifted[:] = 0.0

    def fly(
        self,
        first: int,
        count: int,
        condition: Condition,
        sensors: SensorCondition,
        state: State,
        noise: Noise,
        commands: FloatArray,
        rows: Rows,
        log: FloatArray,
    ) -> None:
        """As `sitl_plant.physics.kernel.fly`."""
        normals = self._rng.standard_normal((count, NORMALS))
        fly_recorded(
            first,
            count,
            self.model,
            self._own,
            condition,
            sensors,
            state,
            self._state,
            noise,
            normals,
            commands,
            rows,
            log,
        )


def recorded_flight(airframe: Airframe, model: Model, state: State, seed: int) -> RecordedFlight | None:
    """The set for one flight, or None if the vehicle has none. `state` is set to its trim."""
    vehicle = airframe.vehicle
    recorded = vehicle.recorded
    if recorded is None:
        return None
    levels, session = np.random.SeedSequence([seed, FLIGHT_STREAM]).spawn(2)
    scale = math.exp(recorded.vibration.session_rms * np.random.default_rng(levels).standard_normal())
    imus = _imus(airframe, recorded, model, scale)
    own = OwnModel(
        imus=imus,
        feedback=_feedback(recorded, model.dt),
        loop=_loop(vehicle, recorded),
        squared_per_thrust=recorded.motors.thrust_over_command
        * airframe.battery_gain
        / vehicle.propulsion.thrust_coefficient_n_s2,
        delay=round(recorded.motors.command_delay_s / model.dt),
        esc_period=max(1, round(recorded.esc.frame_s / model.dt)),
        esc_first=round(recorded.esc.first_s / model.dt) if model.path.start > 0.0 else -(1 << 62),
        over_read=recorded.esc.over_read,
    )
    full = recorded.motors.thrust_over_command * _map(recorded.motors, vehicle.battery.nominal_v)
    flown = model._replace(controller=model.controller._replace(full_thrust=full))
    rng = np.random.default_rng(session)
    return RecordedFlight(flown, log_columns(len(vehicle.rotors)), own, _initial(own, recorded, state), rng)


def specimen_of(airframe: Airframe, recorded: Recorded) -> Specimen:
    """The levels of an airframe: those of its name in the file, or drawn between the extremes that were measured.

    The draw follows from the airframe's own constants, so a specimen keeps its levels from flight to flight.
    """
    known = {one.name: one for one in recorded.specimens}
    if airframe.name in known:
        return known[airframe.name]
    rng, levels = _specimen_stream(airframe, LEVELS), recorded.vibration
    line, broad = (float(np.exp(rng.uniform(*np.log(extremes)))) for extremes in (levels.gyro_line, levels.gyro_broad))
    bias = (recorded.sensors.gyro_bias_rms_rad_s * rng.standard_normal(IMUS)).tolist()
    return Specimen(airframe.name, line, broad, (bias[0], bias[1]), levels.second_harmonic)


def _specimen_stream(airframe: Airframe, purpose: int) -> np.random.Generator:
    return np.random.default_rng([SPECIMEN_STREAM, purpose, zlib.crc32(airframe.thrust_coefficient_n_s2.tobytes())])


def _map(motors: Motors, volts: float) -> float:
    a, b, c = motors.thrust_map
    return a * volts * volts + b * volts + c


def _kept(filters: FloatArray, frequency_hz: FloatArray, dt: float, held: int) -> FloatArray:
    """Gain of the on-chip low-pass and of the hold over `held` steps, sin(N x) / (N sin x) with x = pi f dt."""
    w = np.exp(-2j * np.pi * frequency_hz * dt)
    b, a, b0, b1, b2, a1, a2 = filters
    gain = np.abs(b * (1 + w) / (1 + a * w) * (b0 + b1 * w + b2 * w * w) / (1 + a1 * w + a2 * w * w))
    x = np.pi * frequency_hz * dt
    return np.asarray(gain * np.abs(np.sin(held * x) / (held * np.sin(x))))


def _filters(sensors: Sensors, dt: float) -> FloatArray:
    gyro, accel = butterworth3(sensors.gyro_filter_hz, dt), butterworth3(sensors.accel_filter_hz, dt)
    return np.array([gyro] * 3 + [accel] * 3)


def _imus(airframe: Airframe, recorded: Recorded, model: Model, session: float) -> TwinImu:
    """Both IMUs of a specimen in one flight. session: factor of the line."""
    sensors, levels, specimen = recorded.sensors, recorded.vibration, specimen_of(airframe, recorded)
    body, propulsion, chip = airframe.vehicle.body, airframe.vehicle.propulsion, airframe.vehicle.imu
    hover = math.sqrt(GRAVITY * body.mass_kg / len(airframe.vehicle.rotors) / propulsion.thrust_coefficient_n_s2)
    period = max(1, round(sensors.gyro_period_s / model.dt))
    filters, shape = _filters(sensors, model.dt), high_pass(levels.broad_corner_hz, model.dt)
    chips = list(zip(filters, [period] * 3 + [1] * 3, strict=True))
    line = np.concatenate([specimen.gyro_line * np.array(levels.gyro_axes), levels.accel_axes])
    broad = np.concatenate([specimen.gyro_broad * np.array(levels.gyro_axes), np.full(3, levels.accel_broad)])
    line /= [_kept(one, np.array([hover / (2.0 * np.pi)]), model.dt, held)[0] for one, held in chips]
    broad /= [_broad_kept(one, shape, model.dt, held) for one, held in chips]
    ratio, drawn = np.array([1.0, levels.second_imu]), _specimen_stream(airframe, BIAS).standard_normal((IMUS, 2))
    bias = np.zeros((IMUS, CHANNELS))
    bias[:, 0], bias[:, 1:3] = specimen.gyro_bias_roll, sensors.gyro_bias_rms_rad_s * drawn
    white = math.sqrt(0.5 / model.dt) * np.repeat([chip.gyro_noise_density, chip.accel_noise_density], 3)
    return TwinImu(
        position=np.array(sensors.positions_m) + model.mocap.centre,
        bias=bias,
        white=np.array([white] * IMUS),
        broad=np.outer(ratio, broad),
        line=_line(airframe, session * np.outer(ratio, line), specimen.second_harmonic),
        hover=hover,
        shape=shape,
        filters=filters,
        span=np.repeat([sensors.gyro_range_rad_s, sensors.accel_range_m_s2], 3),
        lsb=np.repeat([sensors.gyro_lsb_rad_s, sensors.accel_lsb_m_s2], 3),
        gyro_period=period,
    )


def _broad_kept(filters: FloatArray, shape: tuple[float, ...], dt: float, held: int) -> float:
    """Share of unit white noise, rms, that is left between 50 and 100 Hz behind high-pass, low-pass and hold."""
    frequency_hz = np.linspace(*BAND_HZ, 101)
    w = np.exp(-2j * np.pi * frequency_hz * dt)
    b0, b1, b2, a1, a2 = shape
    gain = np.abs((b0 + b1 * w + b2 * w * w) / (1 + a1 * w + a2 * w * w)) * _kept(filters, frequency_hz, dt, held)
    return math.sqrt(float(np.mean(gain**2)) * 2.0 * dt * (BAND_HZ[1] - BAND_HZ[0]))


def _line(airframe: Airframe, level: FloatArray, second: float) -> FloatArray:
    """(2, 6, 2, n, 2) amplitudes of the specimen's rotors; their squares sum to 2 level^2, (2, 6)."""
    n, rng = len(airframe.vehicle.rotors), _specimen_stream(airframe, LINE)
    share = rng.uniform(0.5, 1.5, (IMUS, CHANNELS, HARMONICS, n))
    share /= np.sqrt((share**2).sum(axis=-1, keepdims=True))
    phase = rng.uniform(0.0, 2.0 * np.pi, share.shape)
    amplitude = math.sqrt(2.0) * level[:, :, None, None] * np.array([1.0, second])[:, None] * share
    return np.stack([amplitude * np.cos(phase), amplitude * np.sin(phase)], axis=-1)


def _feedback(recorded: Recorded, dt: float) -> Feedback:
    given = recorded.feedback
    return Feedback(
        rate=second_order(*given.rate, dt),
        accel=second_order(*given.accel, dt),
        velocity=second_order(*given.velocity, dt),
        correction_p=given.complementary_p,
        correction_i=given.complementary_i,
    )


def _loop(vehicle: Vehicle, recorded: Recorded) -> Loop:
    gains = recorded.gains
    return Loop(
        angle=gains.angle,
        rate_damping=gains.rate_damping,
        yaw_rate=gains.yaw_rate,
        rate_limit=gains.rate_limit_rad_s,
        torque_per_rate=np.array(gains.torque_per_rate),
        torque_per_acceleration=np.array(gains.torque_per_acceleration),
        torque_limit=np.array(gains.torque_limit_n_m),
        pid=np.array([[p, d, i] for p, d, i in (gains.horizontal_pid, gains.altitude_pid, gains.yaw_pid)]),
        integral_limit=np.array(gains.integral_limit),
        trim=gains.trim_n,
        tilt_limit=gains.tilt_limit_rad,
        thrust_limit=np.array(vehicle.control.thrust_limit_n),
        mixer=np.asarray(np.linalg.pinv(allocation(vehicle)), dtype=np.float64),
        thrust_map=recorded.motors.thrust_map,
        minimum_duty=vehicle.propulsion.minimum_duty,
        ground_thrust=recorded.ground.thrust_n,
    )


def _initial(own: OwnModel, recorded: Recorded, state: State) -> OwnState:
    """At rest on the ground, or in the trim of hover: the thrust that carries the weight is less than the trim."""
    n = len(state.control.duty)
    reading = np.zeros((IMUS, CHANNELS))
    reading[:, 5] = -GRAVITY
    angle = np.zeros((IMUS, 3))
    angle[:, 2] = state.estimate[2]
    state.control.integral[:] = 0.0
    queue = np.zeros((own.delay + 1, n))
    if state.control.motors[0] == FLYING:
        thrust = state.control.wrench[0] / recorded.motors.thrust_over_command
        state.control.integral[2] = own.loop.trim - thrust  # down is positive
        state.control.wrench[0] = thrust
        queue[:] = voltage_of(own.loop.thrust_map, thrust / n) / state.battery[0]
    return OwnState(
        imus=TwinImuState(
            shaped=np.zeros((IMUS, CHANNELS, 2)),
            memory=np.zeros((IMUS, CHANNELS, 3)),
            drifted=np.zeros(CHANNELS),
            reading=reading.copy(),
            turns=np.zeros((HARMONICS, n, 2)),
        ),
        loop=LoopState(
            angle=angle,
            rate=np.zeros((IMUS, 3)),
            acceleration=np.zeros((IMUS, 3)),
            accel=reading[:, 3:].copy(),
            accel_slope=np.zeros((IMUS, 3)),
            correction=np.zeros((IMUS, 2)),
            seen=state.mocap.pose.copy(),
            velocity=np.zeros(4),
            asked=np.zeros(3),
            pid=np.zeros(4),
            desired=state.mocap.pose.copy(),
        ),
        queue=queue,
        esc=np.full(n, np.nan),
    )
