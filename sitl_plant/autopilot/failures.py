"""MAV_CMD_INJECT_FAILURE for motors: what is damaged, and what becomes of it.

While the parameter `SIM_PROP_FAULT` is 1 to 3, every failure but OK is a damaged propeller of the thesis: F1 to F3,
with the severity `SIM_PROP_SEV`, SV1 to SV3. At 0, OFF stops the motor and SLOW lets it turn at nine tenths of its
speed.
"""

from collections.abc import Mapping

from mavdiag.link.messages import MavResult
from sitl_plant.autopilot.parameters import Kind, Parameter, Parameters
from sitl_plant.physics.faults import Injection, RotorDamage, fault_injection

FAULT, SEVERITY = "SIM_PROP_FAULT", "SIM_PROP_SEV"
FAULT_PARAMETERS = (Parameter(FAULT, 0, Kind.INT8, (0, 3)), Parameter(SEVERITY, 1, Kind.INT8, (1, 3)))

SYSTEM_MOTOR = 101  # FAILURE_UNIT
OK, OFF, SLOW = 0, 1, 5  # FAILURE_TYPE
SLOW_SHARE = 0.9  # of the commanded speed (our choice)

_MOTORS: Mapping[int, tuple[str, RotorDamage]] = {
    OFF: ("motor off", RotorDamage(speed_factor=0.0)),
    SLOW: ("motor slow", RotorDamage(speed_factor=SLOW_SHARE)),
}


class Failures:
    """What was injected into a vehicle with so many rotors. phenomenology: as of the plant's configuration."""

    def __init__(self, rotors: int, phenomenology: float) -> None:
        self._rotors, self._phenomenology = rotors, phenomenology
        self._present: dict[int, Injection] = {}

    def inject(
        self, parameters: Parameters, unit: int, kind: int, instance: float | None, mask: int
    ) -> tuple[MavResult, list[Injection] | None]:
        """The result of the command, and the causes that are there from now on; None if nothing changes.

        instance: 0 for all motors, None for those of the mask.
        """
        if instance is None:
            motors = [motor for motor in range(1, self._rotors + 1) if mask >> (motor - 1) & 1]
        else:
            motors = [int(instance)] if instance else list(range(1, self._rotors + 1))
        fault = round(parameters.value(FAULT))
        if unit != SYSTEM_MOTOR or (kind != OK and not fault and kind not in _MOTORS):
            return MavResult.UNSUPPORTED, None
        if not motors or not set(motors) <= set(range(1, self._rotors + 1)):
            return MavResult.DENIED, None
        for motor in motors:
            self._present.pop(motor, None)
            if kind != OK:
                self._present[motor] = self._cause(motor, kind, fault, round(parameters.value(SEVERITY)))
        return MavResult.ACCEPTED, list(self._present.values())

    def _cause(self, motor: int, kind: int, fault: int, severity: int) -> Injection:
        if fault:
            return fault_injection(f"F{fault}/SV{severity}", motor, phenomenology=self._phenomenology)
        name, damage = _MOTORS[kind]
        return Injection(damage, motor, name=name)
