"""What is asked for, how often, and what is said of it; parameters by name."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest

from detector.negotiate import HELD_S, Negotiation
from detector.values import AskInterval, Note
from mavdiag.link.messages import Autopilot, MavCmd, MavResult, MessageId
from mavdiag.link.profiles import LAST_RESORT
from mavdiag.link.vehicles import Ack
from mavdiag.link.wants import Want
from mavdiag.telemetry import Instant, Signal

TICK_S = 0.04
GYRO = Want(
    Signal.BODY_RATE, MessageId.RAW_IMU, 100.0, 98.0, 102.0, mandatory=True, others=(MessageId.HIGHRES_IMU, LAST_RESORT)
)


@dataclass
class Seen:
    """A stream that is wanted, as it comes; its own meter."""

    want: Want
    hz: float
    steady_hz: float = 0.0


class Streams:
    """In place of the measured ones."""

    def __init__(self, *seen: Seen) -> None:
        self._seen = {stream.want.signal: stream for stream in seen}

    def rate_hz(self, signal: Signal, now: Instant) -> float:
        return self._seen[signal].hz

    def meter(self, signal: Signal) -> Seen:
        return self._seen[signal]


@dataclass
class Talk:
    """A negotiation, and all that came of it with its time [s]."""

    negotiation: Negotiation = field(default_factory=lambda: Negotiation(Autopilot.ARDUPILOTMEGA))
    ticks: int = 0
    asked: list[tuple[float, int]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def wait(self, seconds: float, *seen: Seen, acks: tuple[Ack, ...] = ()) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.ticks += 1
            now = Instant(round(self.ticks * TICK_S * 1e9))
            streams: Any = Streams(*seen)
            effects, _ = self.negotiation.step([stream.want for stream in seen], streams, acks, now)
            acks = ()
            self.asked += [(self.ticks * TICK_S, one.msgid) for one in effects if isinstance(one, AskInterval)]
            self.notes += [one.text for one in effects if isinstance(one, Note)]


def test_a_drop_is_answered_at_once_each_time_the_rate_had_held() -> None:
    talk = Talk()
    for _ in range(20):
        talk.wait(9.0, Seen(GYRO, 100.0))
        talk.wait(0.2, Seen(GYRO, 4.0))
    times = [at for at, _ in talk.asked]
    assert len(times) == 20
    for number, at in enumerate(times):
        assert at == pytest.approx(9.0 + 9.2 * number, abs=0.3)


@pytest.mark.parametrize("right_s", [0.2, 1.0, 2.5, 4.5])
def test_two_that_set_the_same_rate_do_not_fight(right_s: float) -> None:
    """Another one changes it before it holds: asked for ever more seldom, and never twice in 2 s."""
    talk = Talk()
    for _ in range(round(120.0 / (right_s + 0.5))):
        talk.wait(0.5, Seen(GYRO, 4.0))
        talk.wait(right_s, Seen(GYRO, 100.0))
    times = [at for at, _ in talk.asked]
    assert min(b - a for a, b in pairwise(times)) >= 2.0
    assert len(times) <= 10
    assert len([one for one in times if one > 60.0]) <= 2
    assert right_s < HELD_S


@pytest.mark.parametrize("result", [MavResult.DENIED, None])
def test_another_imu_message_is_asked_for_where_the_profiles_own_is_not_to_be_had(result: MavResult | None) -> None:
    talk = Talk()
    for _ in range(60):
        acks = () if result is None else (Ack(MavCmd.SET_MESSAGE_INTERVAL, result),)
        talk.wait(1.0, Seen(GYRO, 0.0), acks=acks)
    order = list(dict.fromkeys(msgid for _, msgid in talk.asked))
    assert order == [MessageId.RAW_IMU, MessageId.HIGHRES_IMU, LAST_RESORT]
