"""What is done about a fault, by the table: when, how often, what calls it off, and who does not cause it."""

from collections.abc import Sequence

import pytest

from detector.reaction import ANSWER_S, NOTICE_S, OWN_S, STICK, Reaction
from detector.rules import AUTOMATIC, parse_modes, parse_rules
from detector.values import Effect, Inbox, Note, SendCommand, SendText
from mavdiag.decision.diagnosis import Diagnosis, Stage
from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.vehicles import Ack, acks_in, mode_in, sticks_in
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Instant

AUTO, LOITER, STABILIZE, RTL, LAND = 3, 5, 0, 6, 9
TICK_S = 0.1
TABLE_TEXT = "gross loss: land; propeller fault after 10 s: rtl; suspected: text"
QUIET, SUSPECTED = Diagnosis(Stage.QUIET), Diagnosis(Stage.SUSPECTED)
RC = MessageId.RC_CHANNELS


def fault(kind: FaultKind = FaultKind.PROPELLER) -> Diagnosis:
    return Diagnosis(Stage.FAULT, kind=kind, rotor=3, seen=True)


class Flight:
    """A reaction on a virtual clock; its autopilot answers with `result` in the next tick, None for never."""

    def __init__(self, table: str = TABLE_TEXT, mode: int | None = AUTO, autopilot: int = 0) -> None:
        self.reaction = Reaction(parse_rules(table), parse_modes(AUTOMATIC), autopilot)
        self.mode, self.armed, self.held = mode, True, QUIET
        self.result: int | None = MavResult.ACCEPTED
        self.ticks = 0
        self.log: list[tuple[float, Effect]] = []
        self._acks: tuple[Ack, ...] = ()
        self.fly(1.0)

    @property
    def s(self) -> float:
        return round(self.ticks * TICK_S, 3)

    def fly(self, seconds: float, sticks: Sequence[int] = ()) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.ticks += 1
            told = {int(RC): tuple(sticks)} if sticks else {}
            inbox = Inbox(alive=True, acks=self._acks, mode=self.mode, sticks=told)
            effects = self.reaction.step(self.held, self.armed, inbox, Instant(round(1e12) + round(self.s * 1e9)))
            self._take(effects)

    def _take(self, effects: Sequence[Effect]) -> None:
        self.log += [(self.s, effect) for effect in effects]
        sent = [effect for effect in effects if isinstance(effect, SendCommand)]
        self._acks = tuple(Ack(one.command, self.result) for one in sent if self.result is not None)

    @property
    def commands(self) -> list[tuple[float, int]]:
        return [(s, effect.command) for s, effect in self.log if isinstance(effect, SendCommand)]

    @property
    def texts(self) -> list[tuple[float, str]]:
        return [(s, effect.text) for s, effect in self.log if isinstance(effect, SendText)]

    @property
    def notes(self) -> list[str]:
        return [effect.text for _, effect in self.log if isinstance(effect, Note)]


def test_the_action_comes_after_its_delay_is_announced_five_seconds_before_and_comes_once() -> None:
    flight = Flight()
    flight.held, began_s = fault(), flight.s + TICK_S
    flight.fly(60.0)
    assert flight.commands == [(round(began_s + 10.0, 3), MavCmd.NAV_RETURN_TO_LAUNCH)]
    assert flight.texts == [
        (round(began_s + 10.0 - NOTICE_S, 3), "PROP rtl in 5 s unless stick/mode/ack"),
        (round(began_s + 10.0, 3), "PROP rtl commanded: propeller fault, rotor unknown"),
    ]
    flight.held = QUIET
    flight.fly(5.0)
    flight.held = fault()
    flight.fly(60.0)
    assert len(flight.commands) == 1
    steps = [note.split(": ")[3] for note in flight.notes if " -> " in note]
    assert steps == ["counting -> announced", "announced -> asked", "asked -> over"]


def test_it_acts_again_in_the_next_flight_only() -> None:
    flight = Flight("fault: hold")
    for armings in (1, 2):
        flight.held = fault()
        flight.fly(5.0)
        assert flight.commands == [(s, MavCmd.NAV_LOITER_UNLIM) for s, _ in flight.commands]
        assert len(flight.commands) == armings
        flight.held, flight.armed = Diagnosis(Stage.INSPECT, kind=FaultKind.PROPELLER), False
        flight.fly(2.0)
        flight.armed = True


def test_a_graver_finding_goes_before_and_a_lesser_one_never_after_it() -> None:
    flight = Flight()
    flight.held = SUSPECTED
    flight.fly(2.0)
    flight.held = fault()
    flight.fly(7.0)
    flight.held = fault(FaultKind.GROSS_LOSS)
    flight.fly(1.0)
    flight.held = fault()
    flight.fly(60.0)
    assert [command for _, command in flight.commands] == [MavCmd.NAV_LAND]
    assert flight.texts[0][1] == "PROP on fault: suspected, rotor unknown"
    assert flight.texts[-1][1].startswith("PROP land commanded: gross loss of thrust")
    assert any("no longer called for: gross loss of thrust" in note for note in flight.notes)


def test_a_graver_kind_without_a_row_counts_as_a_propeller_fault_and_a_sensor_fault_does_not() -> None:
    flight = Flight("propeller fault after 2 s: rtl")
    flight.held = fault(FaultKind.SENSOR)
    flight.fly(10.0)
    assert flight.log == []
    flight.held = fault()
    flight.fly(1.0)
    flight.held = fault(FaultKind.GROSS_LOSS)
    flight.fly(1.5)
    assert [command for _, command in flight.commands] == [MavCmd.NAV_RETURN_TO_LAUNCH]


def test_two_rows_of_a_finding_are_steps_and_the_first_ones_mode_calls_nothing_off() -> None:
    flight = Flight("propeller fault: hold; propeller fault after 6 s: rtl")
    flight.held, began_s = fault(), flight.s + TICK_S
    flight.fly(0.9)
    flight.mode = LOITER  # the heartbeat after the command
    flight.fly(9.0)
    assert flight.commands == [
        (began_s, MavCmd.NAV_LOITER_UNLIM),
        (round(began_s + 6.0, 3), MavCmd.NAV_RETURN_TO_LAUNCH),
    ]


@pytest.mark.parametrize("how", ["mode", "stick", "ack"])
def test_the_pilot_calls_it_off_for_this_flight(how: str) -> None:
    flight = Flight()
    flight.fly(1.0, (1500, 1500, 1500, 1500))
    flight.held = fault()
    flight.fly(7.0, (1500, 1500, 1500, 1500))
    assert len(flight.texts) == 1
    if how == "mode":
        flight.mode = LOITER
    elif how == "ack":
        flight._take(flight.reaction.acknowledge("255/190"))
    flight.fly(1.0, (1500, 1500 + STICK * (how == "stick"), 1500, 1500))
    flight.fly(60.0)
    assert flight.commands == []
    reason = {"mode": "mode loiter", "stick": "a stick was moved", "ack": "acknowledged by 255/190"}[how]
    assert flight.texts[1][1].startswith(f"PROP rtl called off: {reason}"[:48])
    flight.held = fault(FaultKind.GROSS_LOSS)  # graver than what was called off
    flight.fly(1.0)
    assert [command for _, command in flight.commands] == [MavCmd.NAV_LAND]


def test_before_it_is_announced_sticks_and_modes_are_ordinary_flight() -> None:
    flight = Flight()
    flight.held, began_s = fault(), flight.s + TICK_S
    flight.fly(2.0, (1500, 1500, 1500, 1500))
    flight.mode = LOITER
    flight.fly(2.0, (1900, 1100, 1500, 1500))
    flight.fly(8.0)
    assert flight.commands == [(round(began_s + 10.0, 3), MavCmd.NAV_RETURN_TO_LAUNCH)]


@pytest.mark.parametrize(("armed", "mode"), [(False, AUTO), (True, STABILIZE), (True, RTL), (True, 99), (True, None)])
def test_nothing_is_done_disarmed_or_in_another_mode(armed: bool, mode: int | None) -> None:
    flight = Flight(mode=mode)
    flight.armed, flight.held = armed, fault(FaultKind.GROSS_LOSS)
    flight.fly(60.0)
    assert flight.log == []


@pytest.mark.parametrize("stage", [Stage.INSPECT, Stage.NOT_JUDGED, Stage.QUIET])
def test_what_is_not_suspected_or_declared_in_this_flight_causes_nothing(stage: Stage) -> None:
    flight = Flight()
    flight.held = Diagnosis(stage, kind=FaultKind.GROSS_LOSS)
    flight.fly(60.0)
    assert flight.log == []


def test_a_finding_that_ends_in_time_causes_nothing_and_may_come_again() -> None:
    flight = Flight("suspected after 8 s: hold")
    flight.held = SUSPECTED
    flight.fly(7.0)
    flight.held = QUIET
    flight.fly(5.0)
    assert flight.commands == []
    flight.held = SUSPECTED
    flight.fly(9.0)
    assert len(flight.commands) == 1


@pytest.mark.parametrize("result", [None, MavResult.DENIED])
def test_a_command_that_is_not_taken_is_sent_once_more_and_then_told(result: MavResult | None) -> None:
    flight = Flight("gross loss: land")
    flight.result, flight.held = result, fault(FaultKind.GROSS_LOSS)
    flight.fly(60.0)
    (first_s, _), (again_s, _) = flight.commands
    assert again_s - first_s == pytest.approx(ANSWER_S if result is None else TICK_S)
    assert [effect.confirmation for _, effect in flight.log if isinstance(effect, SendCommand)] == [0, 1]
    assert flight.texts[-1][1] == f"PROP land not taken, {'no answer' if result is None else 'DENIED'}"


def test_a_lost_answer_is_no_reason_to_ask_again_once_the_mode_shows_it() -> None:
    flight = Flight("gross loss: land")
    flight.result, flight.held = None, fault(FaultKind.GROSS_LOSS)
    flight.fly(0.5)
    flight.mode = LAND
    flight.fly(10.0)
    assert len(flight.commands) == 1
    assert flight.notes[-1].endswith("asked -> over: the autopilot took it: mode land")
    assert OWN_S > 1.0  # a heartbeat


def test_answers_of_other_systems_and_to_others_do_not_count() -> None:
    ours = (MavCmd.NAV_LAND, MavResult.ACCEPTED, 0, 0)
    frames = []
    for sender, target in [((2, 1), (2, 191)), ((1, 190), (1, 191)), ((1, 1), (255, 190)), ((1, 1), (7, 191))]:
        frames += Decoder().feed(Encoder(*sender).encode(MessageId.COMMAND_ACK, *ours, *target), 0)
    # The frames of another system never reach a vehicle's session, see `LinkDecoder.received`.
    assert acks_in(frame for frame in frames if frame.sysid == 1) == ()
    [right] = Decoder().feed(Encoder(1, 1).encode(MessageId.COMMAND_ACK, *ours, 1, Component.ONBOARD_COMPUTER), 0)
    assert acks_in([right]) == (Ack(MavCmd.NAV_LAND, MavResult.ACCEPTED),)


def test_modes_and_sticks_are_read_from_the_autopilots_own_frames() -> None:
    autopilot, other = Encoder(1, 1), Encoder(1, 190)
    beats = [
        autopilot.encode(MessageId.HEARTBEAT, 2, 3, 129, 5, 4, 3),
        other.encode(MessageId.HEARTBEAT, 6, 8, 1, 9, 4),
    ]
    pulses = (1100, 1500, 1900, 1501, *[0] * 14, 0)
    told = [one.encode(RC, 0, 18, *pulses) for one in (autopilot, other)]
    frames = [frame for data in (*beats, *told) for frame in Decoder().feed(data, 0)]
    assert mode_in(frames) == LOITER
    assert sticks_in(frames[:3]) == {RC: (1100, 1500, 1900, 1501)}
    assert sticks_in(frames[3:]) == {}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("gross loss land", "cannot read"),
        (": land", "no finding ''"),
        ("wing broken: land", "no finding 'wing broken'; known are gross loss of thrust"),
        ("fault after 1.2.3 s: land", "no delay '1.2.3'"),
        ("fault after 3600 s: land", "too long"),
        ("fault: explode", "no action 'explode'"),
        ("fault: rtl 5", "no action 'rtl 5'"),
        ("fault: DO_PARACHUTE two", "no action"),
        ("fault: 99999", "no action"),
        ("fault: DO_PARACHUTE 1 2 3 4 5 6 7 8", "no action"),
        ("fault: DO_PARACHUTE nan", "no action"),
        ("fault: COMPONENT_ARM_DISARM 0 21196", "neither arms nor disarms"),
        ("fault: 400 0", "neither arms nor disarms"),
        ("fault: rtl; fault: land", "two rows"),
    ],
)
def test_a_row_that_cannot_be_read_is_refused_with_one_line(text: str, why: str) -> None:
    with pytest.raises(UsageError, match="on_fault: ") as caught:
        parse_rules(text)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)
