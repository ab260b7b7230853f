"""Small .tlog files of made flights, and a baseline for them: quick to write, to read and to judge."""

import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from flying_telemetry import flying
from made_baselines import FRAME, NOW, kept
from scipy.spatial.transform import Rotation

from mavdiag.archive.scan import Options, Question
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Autopilot, MavType, MessageId
from mavdiag.logs import read_log
from mavdiag.logs.tlog import tlog_record
from mavdiag.telemetry import Signal

__all__ = ["MONITORS", "START_US", "archive_baseline", "asked", "content", "made"]

START_US = 1_763_000_000_000_000
MONITORS = ("fsd", "innovation", "sensor_noise")
ARMED = 128


@cache
def content(seed: int, n: int = 1500, shaken_from: int | None = None) -> bytes:
    """A flight of n samples at 100 Hz as PX4 sends it. shaken_from: sample from which on the gyro sees a vibration."""
    telemetry, encoder, records = flying(n, seed), Encoder(1, 1), []
    rates = telemetry[Signal.BODY_RATE].values.copy()
    if shaken_from is not None:
        rates[shaken_from:] += np.random.default_rng(seed).normal(0.0, 0.4, (n - shaken_from, 3))
    setpoint, force = telemetry[Signal.ATTITUDE_SETPOINT].values, telemetry[Signal.SPECIFIC_FORCE].values
    attitude = Rotation.from_euler("ZYX", setpoint[:, ::-1]).as_quat()[:, [3, 0, 1, 2]]
    for k in range(n):
        time_us = START_US + 10_000 * k
        frames = [
            encoder.encode(MessageId.ATTITUDE_TARGET, 5_000 + 10 * k, 0, tuple(attitude[k]), 0, 0, 0, 0.5),
            encoder.encode(
                MessageId.HIGHRES_IMU, 5_000_000 + 10_000 * k, *force[k], *rates[k], 0, 0, 0, 0, 0, 0, 0, 63, 0
            ),
        ]
        if k % 100 == 0:
            frames.append(encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, Autopilot.PX4, ARMED, 0, 4, 3))
        records += [tlog_record(time_us, frame) for frame in frames]
    return b"".join(records)


def made(folder: Path, *names: str, first_seed: int = 1, shaken: Sequence[str] = ()) -> list[Path]:
    """Flights below a folder under these names, each another one. shaken: names of those that shake in the middle."""
    paths = []
    for number, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content(first_seed + number, shaken_from=800 if name in shaken else None))
        paths.append(path)
    return paths


@cache
def archive_baseline() -> Baseline:
    def learnt() -> Baseline:
        with tempfile.TemporaryDirectory() as folder:
            logs = [read_log(path) for path in made(Path(folder), "a", "b", "c", first_seed=100)]
        return learn(logs, LearnOptions(airframe=FRAME, monitors=MONITORS), created=NOW)

    return kept("archive", learnt)


def asked(options: Options | None = None) -> Question:
    return Question.of(archive_baseline(), options or Options())
