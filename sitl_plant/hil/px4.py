"""PX4's simulator messages, and those of its flight controllers in HIL mode: frames in, frames out.

    to PX4     HIL_SENSOR at the rate of the link, HIL_GPS at 10 Hz, HIL_STATE_QUATERNION (the truth), HEARTBEAT
    from PX4   HIL_ACTUATOR_CONTROLS, HEARTBEAT, and SET_MESSAGE_INTERVAL for HIL_STATE_QUATERNION

(https://docs.px4.io/main/en/simulation/#simulator-mavlink-api, and PX4's simulator_mavlink). PX4 in simulation takes
its clock from HIL_SENSOR. Bit 0 of its flags says that it waits for each of them, and answers: then the plant waits,
too. A flight controller has a clock of its own, and newer ones use the flags for other things. The plant has no model
of compass, barometer and GPS: their noises are our choice, so that no reading stands still; the field is PX4's.
"""

import math

import numpy as np

from mavdiag.link.codec import Encoder, Frame, field_index
from mavdiag.link.messages import Autopilot, MavCmd, MavType, MessageId, ModeFlag
from mavdiag.telemetry import FloatArray
from mavdiag.units import G
from sitl_plant.autopilot.stream import FIX_3D, SATELLITES, to_global
from sitl_plant.autopilot.wire import integer, number
from sitl_plant.hil.simulation import OutputMap, Simulation
from sitl_plant.plant import PlantSamples

WANTED = (MessageId.HIL_ACTUATOR_CONTROLS, MessageId.HEARTBEAT, MessageId.COMMAND_LONG)
LOCKSTEP = 1
IMU, COMPASS, BARO = 0b111_111, 0b111_000_000, 0b1101_000_000_000  # HIL_SENSOR_UPDATED_FLAGS
SYSID, COMPID = 142, 1  # our choice: neither a vehicle nor a ground station
CM = 100.0
FIELD_N = np.array([0.21523, 0.00771, 0.42741])  # gauss, NED
COMPASS_RMS, PRESSURE_RMS_HPA = 0.001, 0.01
SEA_HPA, TEMPERATURE_C = 1013.25, 20.0

_CONTROLS, _FLAGS, _MODE = (field_index(MessageId.HIL_ACTUATOR_CONTROLS, f) for f in ("controls", "flags", "mode"))


class Bridge:
    """One simulation, flown over MAVLink. rate_hz: of HIL_SENSOR. controls, restarts: of the autopilot so far.

    answered: whether controls came since the last `advance`. lockstep: whether they say that PX4 waits for us.
    in_hil: what the last heartbeat of an autopilot says; None before the first.
    """

    def __init__(self, simulation: Simulation, outputs: OutputMap, rate_hz: float) -> None:
        self.simulation = simulation
        self._outputs = outputs
        self.period_s = 1.0 / rate_hz
        self._encoder = Encoder(SYSID, COMPID)
        self._noise = np.random.default_rng([simulation.config.seed, 0x1175])
        self.controls = self.restarts = 0
        self._begin()

    def _begin(self) -> None:
        self.answered = self.lockstep = False
        self.in_hil: bool | None = None
        self._duties: FloatArray = np.zeros(self.simulation.rotors)
        self._every_s = {"compass": 0.02, "baro": 0.05, "gps": 0.1, "truth": 0.02, "beat": 1.0}  # of flight
        self._next_s = dict.fromkeys(self._every_s, 0.0)

    def restart(self) -> None:
        """The autopilot was started anew: so is the flight."""
        self.restarts += 1
        self.simulation.restart()
        self._begin()

    def hear(self, frame: Frame) -> None:
        """Take what the autopilot sent."""
        fields = frame.fields
        if frame.msgid == MessageId.HIL_ACTUATOR_CONTROLS:
            armed = int(fields[_MODE]) & ModeFlag.SAFETY_ARMED
            shares = np.array(fields[_CONTROLS : _CONTROLS + 16], dtype=np.float64)
            self._duties = self._outputs.from_share(shares if armed else np.zeros(16))
            self.lockstep = bool(int(fields[_FLAGS]) & LOCKSTEP)
            self.answered = True
            self.controls += 1
        elif frame.msgid == MessageId.HEARTBEAT and integer(frame, "autopilot") != Autopilot.INVALID:
            self.in_hil = bool(integer(frame, "base_mode") & ModeFlag.HIL_ENABLED)
        elif frame.msgid == MessageId.COMMAND_LONG and integer(frame, "command") == MavCmd.SET_MESSAGE_INTERVAL:
            interval_us = number(frame, "param2")
            if integer(frame, "param1") == MessageId.HIL_STATE_QUATERNION and interval_us > 0.0:
                self._every_s["truth"] = 1e-6 * interval_us

    def advance(self) -> list[bytes]:
        """Fly one period with the latest controls, and say what the sensors show."""
        row = self.simulation.step(self._duties, self.period_s)
        self.answered = False
        sent = [self._sensor(row)]
        sent += [self._gps(row)] if self._is_due("gps") else []
        sent += [self._truth(row)] if self._is_due("truth") else []
        if self._is_due("beat"):
            sent.append(self._encoder.encode(MessageId.HEARTBEAT, MavType.GENERIC, Autopilot.INVALID, 0, 0, 4, 3))
        return sent

    def _is_due(self, name: str) -> bool:
        now_s = self.simulation.t_s
        if now_s < self._next_s[name] - 1e-9:
            return False
        self._next_s[name] = max(self._next_s[name] + self._every_s[name], now_s)
        return True

    def _sensor(self, row: PlantSamples) -> bytes:
        updated, field, pressure, altitude_m = IMU, [0.0, 0.0, 0.0], 0.0, float(to_global(row.position)[0, 2])
        if self._is_due("compass"):
            w, v = row.quaternion[0, 0], row.quaternion[0, 1:]
            turned = FIELD_N - 2.0 * w * np.cross(v, FIELD_N) + 2.0 * np.cross(v, np.cross(v, FIELD_N))
            updated, field = updated | COMPASS, (turned + COMPASS_RMS * self._noise.standard_normal(3)).tolist()
        if self._is_due("baro"):
            true = SEA_HPA * math.pow(1.0 - 2.25577e-5 * altitude_m, 5.25588)  # standard atmosphere (ISO 2533)
            updated, pressure = updated | BARO, true + PRESSURE_RMS_HPA * float(self._noise.standard_normal())
        motion = (*row.accel[0].tolist(), *row.gyro[0].tolist())
        air = (pressure, 0.0, altitude_m, TEMPERATURE_C)
        return self._encoder.encode(MessageId.HIL_SENSOR, _micros(row), *motion, *field, *air, updated, 0)

    def _gps(self, row: PlantSamples) -> bytes:
        north, east, down = (CM * row.velocity[0]).tolist()
        course = np.degrees(np.arctan2(east, north)) % 360.0
        moves = (np.hypot(north, east), north, east, down, CM * course)
        return self._encoder.encode(
            MessageId.HIL_GPS, _micros(row), FIX_3D, *_place(row), 30, 40, *map(round, moves), SATELLITES
        )

    def _truth(self, row: PlantSamples) -> bytes:
        velocity, accel = (map(round, one.tolist()) for one in (CM * row.velocity[0], 1e3 / G * row.accel[0]))
        turns, air = (row.quaternion[0].tolist(), *row.omega[0].tolist()), (0, 0)
        return self._encoder.encode(
            MessageId.HIL_STATE_QUATERNION, _micros(row), *turns, *_place(row), *velocity, *air, *accel
        )


def _micros(row: PlantSamples) -> int:
    return int(row.t_ns[0]) // 1000


def _place(row: PlantSamples) -> tuple[int, int, int]:
    """Latitude, longitude [1e-7 deg] and altitude [mm]."""
    latitude, longitude, altitude = to_global(row.position)[0].tolist()
    return round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)
