"""A flight controller in the loop, to put in the place of the emulator's plant: its motors turn the rotors of a plant
that answers in the messages of `sitl-plant serve-hil`, and neither knows the other but by these bytes.

    plant        HIL_SENSOR and HIL_STATE_QUATERNION, HIL_HZ times a second     (`sitl_plant.hil.px4.Bridge`)
    controller   HIL_ACTUATOR_CONTROLS after each                               (`reference_pilot.Pilot`)

The emulator's autopilot takes the commands of the vehicle's link and says along which leg to fly, as a real one would.
"""

from dataclasses import fields, replace

import numpy as np
from reference_pilot import Commanded, Pilot, Sensed, Target

from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavType, MessageId, ModeFlag
from mavdiag.telemetry import FloatArray
from sitl_plant.autopilot.stream import HOME_ALT_M, to_local
from sitl_plant.autopilot.wire import number
from sitl_plant.hil.px4 import COMPID, SYSID, Bridge
from sitl_plant.hil.simulation import Simulation, output_map
from sitl_plant.physics import trajectory
from sitl_plant.physics.control import LANDED_M
from sitl_plant.physics.faults import fault_injection
from sitl_plant.physics.trajectory import FLYING, IDLE, LANDING, Leg
from sitl_plant.plant import STEP_NS, PlantConfig, PlantSamples

HIL_HZ = 250.0
DEGREES, METRES, CM = 1e-7, 1e-3, 1e-2
HEARD = (MessageId.HIL_SENSOR, MessageId.HIL_STATE_QUATERNION)
NAN = float("nan")


class Controller:
    """The flight controller: frames in, frames out. leg: what it flies along."""

    def __init__(self, config: PlantConfig) -> None:
        vehicle = config.flown_vehicle
        outputs = output_map(vehicle, "px4")
        self.leg, self.motors = Leg(), 0
        self._pilot = Pilot(vehicle, [int(rotor) + 1 for rotor in np.argsort(outputs.places)], self._target)
        self.commanded = Commanded((0.0,) * len(vehicle.rotors), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
        self._encoder, self._decoder = Encoder(1, Component.AUTOPILOT1), Decoder(HEARD)
        self._gyro, self._height_m, self._reference = [0.0, 0.0, 0.0], 0.0, np.zeros(trajectory.REFERENCE)

    def begin(self) -> list[bytes]:
        """Say that it is in HIL mode, and ask for the truth with each sensor message."""
        beat = (MavType.QUADROTOR, Autopilot.PX4, ModeFlag.HIL_ENABLED, 0, 4, 3)
        rate = (MavCmd.SET_MESSAGE_INTERVAL, 0, MessageId.HIL_STATE_QUATERNION, 1e6 / HIL_HZ, 0, 0, 0, 0, 0)
        return [
            self._encoder.encode(MessageId.HEARTBEAT, *beat),
            self._encoder.encode(MessageId.COMMAND_LONG, SYSID, COMPID, *rate),
        ]

    def feed(self, data: bytes) -> list[bytes]:
        """Take a message of the plant; the motors follow each HIL_STATE_QUATERNION."""
        return [controls for frame in self._decoder.feed(data) for controls in self._hear(frame)]

    def _hear(self, frame: Frame) -> list[bytes]:
        if frame.msgid == MessageId.HIL_SENSOR:
            self._gyro = [number(frame, name) for name in ("xgyro", "ygyro", "zgyro")]
            return []
        north, east = to_local(number(frame, "lat") * DEGREES, number(frame, "lon") * DEGREES)
        self._height_m = number(frame, "alt") * METRES - HOME_ALT_M
        velocity = [CM * number(frame, name) for name in ("vx", "vy", "vz")]
        t_us, turned = int(number(frame, "time_usec")), frame.fields[field_index(frame.msgid, "attitude_quaternion") :]
        self.commanded = self._pilot.step(
            Sensed(
                1e-6 * t_us, self._gyro, (north, east, -self._height_m), velocity, [float(one) for one in turned[:4]]
            )
        )
        armed = ModeFlag.CUSTOM_MODE_ENABLED | (ModeFlag.SAFETY_ARMED if self.motors else 0)
        shares = (*self.commanded.duties, *[NAN] * (16 - len(self.commanded.duties)))
        return [self._encoder.encode(MessageId.HIL_ACTUATOR_CONTROLS, t_us, shares, armed, 0)]

    def _target(self, t_s: float) -> Target:
        trajectory.follow(self.leg, t_s, self._reference)
        north, east, down, *velocity, heading, _, motors = self._reference.tolist()
        stands = motors >= LANDING and self._height_m < LANDED_M
        self.motors = int(IDLE if stands else min(motors, FLYING))
        return Target((north, east, down), (velocity[0], velocity[1], velocity[2]), heading, self.motors)


class LoopPlant:
    """Flown as `Plant` by the emulator. config: a commanded flight; its fault begins onset_s after the take-off."""

    def __init__(self, config: PlantConfig) -> None:
        later = (fault_injection(config.fault, config.rotor, config.onset_s),) if config.fault else ()
        self.config, self.controller, self._rows = config, Controller(config), list[PlantSamples]()
        simulation = Simulation(replace(config, fault=None, onset_s=0.0, trajectory="hover"), later, self._watch)
        self.rotors = simulation.rotors
        self._bridge = Bridge(simulation, output_map(config.flown_vehicle, "px4"), HIL_HZ)
        self._decoder = Decoder()
        self._to_plant(self.controller.begin())

    @property
    def t_ns(self) -> int:
        """Flight time of the next step."""
        return self._bridge.simulation.plant.t_ns

    @property
    def takeoff_s(self) -> float | None:
        """When it left the ground."""
        return self._bridge.simulation.takeoff_s

    def lead(self, leg: Leg) -> None:
        """Fly along `leg` from now on."""
        self.controller.leg = leg

    def advance(self, steps: int) -> PlantSamples:
        """Exchange messages for at least so many steps; what the plant measured meanwhile."""
        until_ns = self.t_ns + steps * STEP_NS
        while self.t_ns < until_ns:
            for message in self._bridge.advance():
                self._to_plant(self.controller.feed(message))
        rows, self._rows = self._rows, []
        return PlantSamples(*(np.concatenate([getattr(row, one.name) for row in rows]) for one in fields(PlantSamples)))

    def _to_plant(self, messages: list[bytes]) -> None:
        for message in messages:
            for frame in self._decoder.feed(message):
                self._bridge.hear(frame)

    def _watch(self, samples: PlantSamples, changes: object) -> None:
        n, asked = len(samples), self.controller.commanded

        def held(values: tuple[float, ...]) -> FloatArray:
            return np.tile(values, (n, 1))

        self._rows.append(
            replace(
                samples,
                setpoint=held(asked.setpoint),
                rate_setpoint=held(asked.rates),
                thrust_setpoint=np.full(n, asked.thrust),
                motors=np.full(n, self.controller.motors),
            )
        )
