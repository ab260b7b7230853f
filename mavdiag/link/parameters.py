"""The autopilot's own parameters, from the PARAM_VALUE messages that pass by. Nothing is asked for here.

PARAM_VALUE carries every value in a float field. PX4 puts the bytes of an integer there; ArduPilot, and what else is
not PX4, casts the integer to a float (MAVLink parameter protocol, "parameter encoding").
"""

from collections.abc import Iterable, Mapping

import numpy as np

from mavdiag.link.codec import Frame, field_index, record_dtype
from mavdiag.link.messages import Autopilot, Component, MessageId

__all__ = ["MOST_PARAMETERS", "parameters_in", "with_parameters"]

MOST_PARAMETERS = 8192  # names that are kept of one vehicle, so that made-up ones cost little (our choice)

_NAME = field_index(MessageId.PARAM_VALUE, "param_id")
_VALUE = record_dtype(MessageId.PARAM_VALUE, ("param_value", 1), ("param_type", 1))
# MAV_PARAM_TYPE of integers, and what lies in the four bytes of the float.
_INTEGERS = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4"}


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
