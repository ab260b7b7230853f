"""The autopilot's own parameters: from the PARAM_VALUE messages that pass by, and which ones to ask for by name.

A parameter is read by PARAM_REQUEST_READ and never set. Those that tell the rotors, their outputs and the gyro's filter
are read, a few at a time, each in three tries at most: an autopilot need not know them, or answer.

PARAM_VALUE carries every value in a float field. PX4 puts the bytes of an integer there; ArduPilot, and what else is
not PX4, casts the integer to a float (MAVLink parameter protocol, "parameter encoding").
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mavdiag.link.codec import Frame, field_index, record_dtype
from mavdiag.link.messages import Autopilot, Component, MessageId
from mavdiag.telemetry import Instant

MOST_PARAMETERS = 8192  # names that are kept of one vehicle, so that made-up ones cost little (our choice)

_NAME = field_index(MessageId.PARAM_VALUE, "param_id")
_VALUE = record_dtype(MessageId.PARAM_VALUE, ("param_value", 1), ("param_type", 1))
# MAV_PARAM_TYPE of integers, and what lies in the four bytes of the float.
_INTEGERS = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4"}


_BATCH, _PAUSE_S, _TRIES = 4, 0.2, 3  # names at a time, how far apart, and tries of each (our choices)
_ROTORS_MAX = 12

_OUTPUTS = tuple(f"SERVO{n}_FUNCTION" for n in range(1, 15))
_PX4_OUTPUTS = tuple(f"PWM_{group}_FUNC{n}" for group in ("MAIN", "AUX") for n in range(1, 9))
_PX4_PLACES = ("PX", "PY", "KM", "AX", "AY", "AZ", "CT")


def telling(autopilot: int, known: Mapping[str, float]) -> tuple[str, ...]:
    """The parameters that tell rotors, outputs and gyro filter, by MAV_AUTOPILOT. known: what is known already.

    >>> telling(Autopilot.GENERIC, {})
    ('FRAME_CLASS', 'FRAME_TYPE')
    """
    if autopilot == Autopilot.PX4:
        rotors = range(min(_ROTORS_MAX, int(known.get("CA_ROTOR_COUNT", 0.0))))
        places = tuple(f"CA_ROTOR{n}_{part}" for part in _PX4_PLACES for n in rotors)
        return ("CA_AIRFRAME", "CA_ROTOR_COUNT", *places, *_PX4_OUTPUTS)
    more = ("INS_GYRO_FILTER", *_OUTPUTS) if autopilot == Autopilot.ARDUPILOTMEGA else ()
    return ("FRAME_CLASS", "FRAME_TYPE", *more)


@dataclass(frozen=True, slots=True)
class Reading:
    """Which parameters were asked for so far.

    tries: of each name.
    at: when some were asked for last.
    """

    tries: Mapping[str, int] = field(default_factory=dict)
    at: Instant | None = None

    def step(self, autopilot: int, known: Mapping[str, float], now: Instant) -> tuple["Reading", tuple[str, ...]]:
        """The names to ask for now, those with the fewest tries first. known: the parameters that came so far."""
        if self.at is not None and now - self.at < _PAUSE_S:
            return self, ()
        tries = {name: self.tries.get(name, 0) for name in telling(autopilot, known) if name not in known}
        due = [name for name in sorted(tries, key=lambda name: tries[name]) if tries[name] < _TRIES][:_BATCH]
        if not due:
            return self, ()
        return Reading({**self.tries, **{name: tries[name] + 1 for name in due}}, now), tuple(due)


def parameters_in(frames: Iterable[Frame], autopilot: int) -> dict[str, float]:
    """The latest value of each parameter in the frames of one vehicle's autopilot (component 1), by name.

    autopilot: MAV_AUTOPILOT, which says how integers are encoded. Values that are not finite are left out.
    """
    found: dict[str, float] = {}
    for frame in frames:
        if frame.msgid == MessageId.PARAM_VALUE and frame.compid == Component.AUTOPILOT1:
            name, value = _name(frame), _value(frame, bytewise=autopilot == Autopilot.PX4)
            if name and np.isfinite(value):
                found[name] = value
    return found


def with_parameters(known: Mapping[str, float], frames: Iterable[Frame], autopilot: int) -> Mapping[str, float]:
    """What is known after more frames; the same value if they bring nothing. At most `MOST_PARAMETERS` names."""
    new = parameters_in(frames, autopilot)
    merged = {**known, **new} if new else known
    return merged if len(merged) <= MOST_PARAMETERS else known


def _name(frame: Frame) -> str:
    raw = frame.fields[_NAME]
    return raw.partition(b"\0")[0].decode("latin-1") if isinstance(raw, bytes) else ""


def _value(frame: Frame, *, bytewise: bool) -> float:
    record = np.frombuffer(frame.payload, _VALUE, count=1)
    stored, layout = record["param_value"].copy(), _INTEGERS.get(int(record["param_type"][0]))
    return float(stored[0]) if layout is None or not bytewise else float(stored.view(layout)[0])
