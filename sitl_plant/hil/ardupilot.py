"""ArduPilot's JSON physics (its `libraries/SITL/examples/JSON/readme.md`): servo frames in, one line of JSON out.

    uint16 magic (18458: 16 channels, 29569: 32), uint16 frame_rate [Hz], uint32 frame_count, uint16 pwm[] [us]

ArduPilot sends a frame, waits for the answer, and sends the frame again if none came within about a second. So every
frame is one span of 1/frame_rate, and the same number a second time is the same span: its answer is sent again. A
number that falls, or another address, means that ArduPilot was started anew: so is the plant, on the ground.
"""

import json
import struct
from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

from mavdiag.units import NS_PER_S, RPM
from sitl_plant.hil.simulation import OutputMap, Simulation
from sitl_plant.plant import PlantSamples

CHANNELS = {18458: 16, 29569: 32}  # by magic
SILENT_S = 2.0  # an autopilot that sent nothing for so long gives way to any other (our choice)
LONGEST_S = 1.0  # of one frame: a smaller rate is no simulation
_head = struct.Struct("<HHI")


class ServoFrame(NamedTuple):
    """One frame of ArduPilot. rate_hz: of its frames. number: it runs on. pwm: (16,) or (32,) [us]."""

    rate_hz: int
    number: int
    pwm: tuple[int, ...]


def servo_frame(data: bytes) -> ServoFrame | None:
    """The frame in a datagram, None if it is none: another magic, another length, or no rate."""
    if len(data) < _head.size:
        return None
    magic, rate_hz, count = _head.unpack_from(data)
    channels = CHANNELS.get(magic)
    if channels is None or len(data) != _head.size + 2 * channels or rate_hz * LONGEST_S < 1.0:
        return None
    return ServoFrame(rate_hz, count, struct.unpack_from(f"<{channels}H", data, _head.size))


def answer(row: PlantSamples, current_a: float, outputs: OutputMap) -> bytes:
    """What the sensors measured, and where the vehicle is. ArduPilot's parser wants no blanks, and a line end before.

    rpm_N is the speed of the rotor at output N, by the names of ArduPilot's open pull request 32718: no release reads
    them, and a parser passes over names that it does not know.

    row: samples of length 1. current_a: drawn from the battery [A].
    """
    speeds = zip(outputs.places.tolist(), (row.rotor_speed[0] / RPM).tolist(), strict=True)
    line = {
        "timestamp": row.t_ns[0].item() * 1e-9,
        "imu": {"gyro": row.gyro[0].tolist(), "accel_body": row.accel[0].tolist()},
        "position": row.position[0].tolist(),
        "quaternion": row.quaternion[0].tolist(),
        "velocity": row.velocity[0].tolist(),
        "battery": {"voltage": row.battery_v[0].item(), "current": current_a},
        **{f"rpm_{output + 1}": round(rpm, 1) for output, rpm in sorted(speeds)},
    }
    return b"\n" + json.dumps(line, separators=(",", ":")).encode() + b"\n"


@dataclass(slots=True)
class Counts:
    """What came in."""

    frames: int = 0  # answered for the first time
    resent: int = 0  # answered again
    restarts: int = 0  # of the autopilot
    foreign: int = 0  # datagrams that are no servo frame
    ignored: int = 0  # frames of an autopilot that another one has replaced


class Lockstep:
    """One simulation and the autopilot that flies it: that of the newest address."""

    def __init__(self, simulation: Simulation, outputs: OutputMap) -> None:
        self.counts = Counts()
        self._simulation, self._outputs = simulation, outputs
        self._peer: Hashable = None
        self._replaced: Hashable = None
        self._heard_s = 0.0
        self._number: int | None = None
        self._answer = b""
        self._current_a = 0.0

    def feed(self, data: bytes, peer: Hashable, now_s: float) -> bytes | None:
        """The answer to a datagram of `peer`; None for no answer. now_s: any clock that only goes on."""
        frame, counts = servo_frame(data), self.counts
        if frame is None:
            counts.foreign += 1
            return None
        if peer == self._replaced and now_s - self._heard_s < SILENT_S:
            counts.ignored += 1
            return None
        fresh = peer != self._peer
        if fresh:
            self._replaced, self._peer = self._peer, peer
        self._heard_s = now_s
        if frame.number == self._number and not fresh:
            counts.resent += 1
            return self._answer
        if self._number is not None and (fresh or frame.number <= self._number):
            counts.restarts += 1
            self._simulation.restart()
        self._number = frame.number
        counts.frames += 1
        before = self._simulation.now
        row = self._simulation.step(self._outputs.from_pwm(frame.pwm), 1.0 / frame.rate_hz)
        drawn_as, span_ns = 3600.0 * (row.charge_ah[0] - before.charge_ah[0]), row.t_ns[0] - before.t_ns[0]
        if span_ns > 0:  # else no step of the plant was due
            self._current_a = float(drawn_as / span_ns * NS_PER_S)
        self._answer = answer(row, self._current_a, self._outputs)
        return self._answer
