"""What the frames of one vehicle show of the way it sends: its heartbeats, its messages, what it weighs in counts."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.link.batch import Batch, Column, total
from mavdiag.link.codec import Frame, field_index, record_dtype
from mavdiag.link.layout import FieldValue
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId
from mavdiag.telemetry import FloatArray, IntArray

_NAMES = ("type", "autopilot")
_TYPE, _AUTOPILOT = (field_index(MessageId.HEARTBEAT, name) for name in _NAMES)
_HEARTBEAT = record_dtype(MessageId.HEARTBEAT, *((name, 1) for name in _NAMES))
_RAW_IMU = record_dtype(MessageId.RAW_IMU, ("time_usec", 1), ("xacc", 3))


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the frames of one vehicle's autopilot show of its profile.

    autopilots: what its heartbeats name it, MAV_AUTOPILOT.
    counts: how many frames of each message.
    weight: median size of RAW_IMU's acceleration, in counts; NaN without RAW_IMU. A vehicle feels its own weight.
    period_us: median period of RAW_IMU [us]; NaN if it is not known.
    """

    autopilots: frozenset[int]
    counts: Mapping[int, int]
    weight: float
    period_us: float

    def weighs(self, span: tuple[float, float]) -> bool:
        """Whether one g is within this span of counts."""
        return span[0] <= self.weight < span[1]


def is_autopilot_heartbeat(frame: Frame) -> bool:
    """Whether a frame is the heartbeat of a vehicle's autopilot, not of a ground station or an on-board computer."""
    if frame.msgid != MessageId.HEARTBEAT or frame.compid != Component.AUTOPILOT1:
        return False
    fields = frame.fields
    return _is_autopilot(fields[_TYPE], fields[_AUTOPILOT])


def _is_autopilot(kind: FieldValue, autopilot: FieldValue) -> bool:
    """Whether these are the type and autopilot of a vehicle."""
    return autopilot != Autopilot.INVALID and kind not in (MavType.GCS, MavType.ONBOARD_CONTROLLER)


def mav_type_of(heartbeat: Frame) -> int:
    """The MAV_TYPE that a heartbeat tells."""
    return int(str(heartbeat.fields[_TYPE]))


def mav_types_of(batch: Batch) -> Counter[int]:
    """How often the heartbeats of a vehicle's autopilot tell each MAV_TYPE; see `is_autopilot_heartbeat`."""
    types = Counter[int]()
    for (kind, _), count in _beats(batch).items():
        types[kind] += count
    return types


def autopilots_of(batch: Batch) -> frozenset[int]:
    """What the heartbeats of a vehicle's autopilot name it, MAV_AUTOPILOT; see `is_autopilot_heartbeat`."""
    return frozenset(autopilot for _, autopilot in _beats(batch))


def _beats(batch: Batch) -> Counter[tuple[int, int]]:
    """MAV_TYPE and MAV_AUTOPILOT of the heartbeats of a vehicle's autopilot, and how often they come."""
    column = batch.columns.get(MessageId.HEARTBEAT)
    record = np.empty(0, _HEARTBEAT) if column is None else column.record(_HEARTBEAT)
    beats = Counter(zip(*(record[name].tolist() for name in _NAMES), strict=True))
    return Counter({(kind, autopilot): n for (kind, autopilot), n in beats.items() if _is_autopilot(kind, autopilot)})


def evidence_of(batches: Sequence[Batch]) -> Evidence:
    """What the frames of one vehicle show, in several pieces, in order of arrival."""
    raw = [_raw_imu(column) for batch in batches if (column := batch.columns.get(MessageId.RAW_IMU))]
    weight = period_us = float("nan")
    if raw:
        weight = float(np.median(np.concatenate([sizes for sizes, _ in raw])))
        times_us = np.concatenate([times for _, times in raw])
        period_us = float(np.median(np.diff(times_us))) if len(times_us) > 1 else period_us
    beats = frozenset[int]().union(*map(autopilots_of, batches))
    return Evidence(beats, total(batches), weight, period_us)


def _raw_imu(column: Column) -> tuple[FloatArray, IntArray]:
    """Sizes of the accelerations in counts, and times [us]."""
    record = column.record(_RAW_IMU)
    return np.linalg.norm(record["xacc"].astype(np.float64), axis=1), record["time_usec"].astype(np.int64)
