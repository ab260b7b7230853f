"""What is said of a fault, and what is done on it."""

import itertools
import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.alerts import Kind, Notice, Presenter, Telling
from detector.reaction import ANSWER_S, NOTICE_S, OWN_S, STICK, Reaction
from detector.rules import AUTOMATIC, parse_modes, parse_rules
from detector.values import Effect, Note, SendCommand, SendText
from mavdiag.as_json import event_json, json_line
from mavdiag.decision.alarm import Event
from mavdiag.decision.diagnosis import Diagnosis, RotorSpan, Stage
from mavdiag.decision.words import held_advice, held_sentence
from mavdiag.errors import UsageError
from mavdiag.judging import MonitorSummary
from mavdiag.link.codec import TEXT_BYTES, Decoder, Encoder, Frame
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.vehicles import Ack, Received, acks_in, mode_in, sticks_in
from mavdiag.monitors import MONITORS, by_name
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Axis, Instant

AUTO, LOITER, STABILIZE, RTL, LAND = 3, 5, 0, 6, 9
TICK_S = 0.1
TABLE_TEXT = "gross loss: land; propeller fault after 10 s: rtl; suspected: text"
QUIET, SUSPECTED = Diagnosis(Stage.QUIET), Diagnosis(Stage.SUSPECTED)
RC = MessageId.RC_CHANNELS
FIGURES = (0.0, 0.118, 98.7, 1e9, float("inf"), float("nan"))
CAUSES = list(itertools.product((None, 1, 12), (None, "F3"), (None, 3)))
UNITS = {"fsd": "s", "unbalance": "g mm"}
FAULT = Notice(Kind.FAULT, ("roll x",), "roll")
PROPELLER = Diagnosis(monitor="rotor_trim", statistic=0.066, threshold=0.02, kind=FaultKind.PROPELLER)
CRACK = replace(PROPELLER, rotor=3, fault_type="F2", severity=2, seen=True, rotors=(RotorSpan(3, 0),))
SENSOR = Diagnosis(Stage.FAULT, kind=FaultKind.SENSOR, statistic=math.inf, threshold=1.0)


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
            told = {(int(RC), f"chan{n}_raw"): at for n, at in enumerate(sticks, 1)}
            received = Received(alive=True, acks=self._acks, mode=self.mode, sticks=told)
            effects = self.reaction.step(self.held, self.armed, received, Instant(round(1e12) + round(self.s * 1e9)))
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
        (round(began_s + 10.0, 3), "PROP rtl commanded: propeller fault, motor 3"),
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
    steps = [(began_s, MavCmd.NAV_LOITER_UNLIM), (round(began_s + 6.0, 3), MavCmd.NAV_RETURN_TO_LAUNCH)]
    assert flight.commands == steps


def test_what_is_graver_acts_in_the_mode_that_the_action_before_it_brought() -> None:
    flight = Flight("gross loss: land; propeller fault: rtl")
    for flight.held, flight.mode in ((fault(), AUTO), (fault(FaultKind.GROSS_LOSS), RTL)):
        flight.fly(5.0)
    assert [command for _, command in flight.commands] == [MavCmd.NAV_RETURN_TO_LAUNCH, MavCmd.NAV_LAND]


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


@pytest.mark.parametrize(
    ("armed", "mode", "stage"),
    [
        *((True, mode, Stage.FAULT) for mode in (STABILIZE, RTL, 99, None)),
        *((True, AUTO, stage) for stage in (Stage.INSPECT, Stage.NOT_JUDGED, Stage.QUIET)),
        (False, AUTO, Stage.FAULT),
    ],
)
def test_nothing_is_done_disarmed_or_in_another_mode_or_without_a_finding_in_this_flight(
    armed: bool, mode: int | None, stage: Stage
) -> None:
    flight = Flight(mode=mode)
    flight.armed, flight.held = armed, Diagnosis(stage, kind=FaultKind.GROSS_LOSS, rotor=3, seen=True)
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


def test_modes_and_sticks_are_read_from_the_autopilots_own_frames() -> None:
    own, other = Encoder(1, 1), Encoder(1, 190)
    beats = [own.encode(MessageId.HEARTBEAT, 2, 3, 129, 5, 4, 3), other.encode(MessageId.HEARTBEAT, 6, 8, 1, 9, 4)]
    pulses, lost = (1100, 1500, 1900, 1501), (974, 65535, 1910, 65534)
    told = [one.encode(RC, 0, 18, *at, *[0] * 14, 0) for one, at in ((own, pulses), (own, lost), (other, pulses))]
    told.insert(0, own.encode(MessageId.MANUAL_CONTROL, 1, 32767, -1000, 1000, 32767, 0))
    frames = [frame for data in (*beats, *told) for frame in Decoder().feed(data, 0)]
    assert mode_in(frames) == LOITER
    where = {(MessageId.MANUAL_CONTROL, "y"): -1000, (MessageId.MANUAL_CONTROL, "z"): 1000}
    where |= {(RC, f"chan{n}_raw"): at for n, at in enumerate((1100, 1500, 1910, 1501), 1)}  # what is lost stays
    assert (sticks_in(frames[:5]), sticks_in(frames[5:])) == (where, {})


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
        (f"fault: {'9' * 5000}", "no action"),
        ("fault: DO_PARACHUTE 1 2 3 4 5 6 7 8", "no action"),
        ("fault: DO_PARACHUTE nan", "no action"),
        ("fault: COMPONENT_ARM_DISARM 0 21196", "neither arms nor stops motors"),
        *((f"fault: {refused}", "neither arms nor stops") for refused in ("400 0", "DO_FLIGHTTERMINATION 1")),
        ("fault: rtl; fault: land", "two rows"),
    ],
)
def test_a_row_that_cannot_be_read_is_refused_with_one_line(text: str, why: str) -> None:
    with pytest.raises(UsageError, match=why) as caught:
        parse_rules(text)
    assert "\n" not in str(caught.value)


def finding(
    monitor: str = "fsd",
    axis: Axis | None = Axis.ROLL,
    found: float = 0.41,
    limit: float = 0.12,
    cause: tuple[int | None, str | None, int | None] = (None, None, None),
    stage: Stage = Stage.FAULT,
) -> Diagnosis:
    rotor, fault_type, severity = cause
    told: dict[str, Any] = {"axis": axis, "rotor": rotor, "fault_type": fault_type, "severity": severity, "seen": True}
    told |= {"unit": UNITS.get(monitor, ""), "statistic": found, "threshold": limit, "kind": by_name(monitor).kind}
    return Diagnosis(stage, "made", monitor=monitor, rotors=() if rotor is None else (RotorSpan(rotor, 0),), **told)


def text(*diagnoses: Diagnosis) -> str:
    telling = Telling()
    [notice] = [telling.step(diagnosis, 1) for diagnosis in diagnoses][-1]
    return notice.text


def say(presenter: Presenter, at_s: float, *notices: Notice) -> list[Effect]:
    return presenter.present(notices, Instant(round(at_s * 1e9)))


def test_h15_an_alert_reads_as_a_pilot_can_use_it() -> None:
    """They read "PROP FAULT innovation 2.84>2.22", "2.221>2.217"."""
    assert text(finding("rotor_trim", None, 0.235, 0.05, (3, None, None))) == "PROP FAULT motor 3 lost 20% thrust"
    assert text(finding("unbalance", None, 21.06, 8.1, (1, None, None))) == "PROP FAULT motor 1 vibrates 2.6x"
    assert text(finding("unbalance", None, 21.06, 8.1, (1, "F2", 2))) == "PROP FAULT motor 1 vibrates 2.6x, F2/SV2"
    assert text(finding("unbalance", None, 21.06, 8.1)) == "PROP FAULT rotor unknown: vibrates 2.6x"
    assert text(finding("innovation", None, 3.12, 2.5)) == "PROP FAULT attitude unlike the model"
    assert text(finding()) == "PROP FAULT roll attitude unlike the model"
    assert text(finding("sensor_drift", None, 3.12, 2.5)) == "PROP SENSOR FAULT gyro and attitude disagree"
    assert text(finding("control_loss", None, 3.12, 2.5, (3, None, None))) == "PROP CONTROL LOST motor 3"
    assert text(finding("thrust_loss", None, 0.4, 0.3)) == "PROP THRUST LOST"
    for monitor in MONITORS:
        assert not set("<>") & set(text(finding(monitor.name, None, 2.1, 2.0)))


def kinds(*diagnoses: Diagnosis) -> list[Kind]:
    """What is said of one diagnosis after the other."""
    telling = Telling()
    return [notice.kind for diagnosis in diagnoses for notice in telling.step(diagnosis, 1)]


def test_h3_only_news_is_critical_and_the_same_fault_that_comes_back_warns() -> None:
    """The repair of a motor in flight was the same CRITICAL as its fault."""
    unnamed, named = finding("innovation"), finding("innovation", cause=(3, None, None))
    gone = replace(named, seen=False)
    back = replace(named, rotor=None)  # another episode, in which no rotor is named yet
    fourth = replace(named, rotor=4, rotors=(RotorSpan(3, 0, 1), RotorSpan(4, 2)))
    sensor = replace(named, kind=FaultKind.SENSOR, rotor=None, rotors=())
    landed = replace(gone, stage=Stage.INSPECT)
    assert kinds(unnamed, named, named, gone, back, named) == [*[Kind.FAULT] * 3, Kind.UNSEEN, *[Kind.AGAIN] * 2]
    assert kinds(named, gone, back, fourth, fourth) == [Kind.FAULT, Kind.UNSEEN, Kind.AGAIN, *[Kind.FAULT] * 2]
    assert kinds(named, sensor, landed, named) == [Kind.FAULT, Kind.SENSOR, Kind.INSPECT, Kind.FAULT]


@pytest.mark.parametrize("stage", [Stage.FAULT, Stage.SUSPECTED, Stage.INSPECT])
@pytest.mark.parametrize("cause", CAUSES)
def test_no_alert_is_cut_whatever_its_figures(stage: Stage, cause: tuple[int | None, str | None, int | None]) -> None:
    names = [monitor.name for monitor in MONITORS]
    for monitor, axis, found, limit in itertools.product(names, (None, *Axis), FIGURES, FIGURES):
        given = finding(monitor, axis, found, limit, cause, stage)
        said = text(given)
        assert len(said.encode()) <= TEXT_BYTES
        assert not said.endswith("..")
        if stage is Stage.FAULT:
            assert not text(given, replace(given, seen=False), given).endswith("..")


@given(words=st.lists(st.text(max_size=80), min_size=2, max_size=2), kind=st.sampled_from(Kind))
def test_whatever_the_words_a_text_has_1_to_50_bytes(words: list[str], kind: Kind) -> None:
    assert 0 < len(Notice(kind, tuple(words[: kind.value.template.count("{}")])).text.encode()) <= TEXT_BYTES


def test_l8_a_fault_that_lasts_is_repeated_after_5_15_60_s_and_then_every_minute() -> None:
    presenter, said = Presenter(), []
    for tick in range(2500):
        said += [tick / 10 for effect in say(presenter, tick / 10, FAULT) if isinstance(effect, SendText)]
    assert said == [0.0, 5.0, 15.0, 60.0, 120.0, 180.0, 240.0]


def test_repeats_of_a_kind_hold_up_no_graver_one() -> None:
    presenter, graver = Presenter(4), Notice(Kind.CONTROL, ("of motor 1",))
    said = [say(presenter, float(at_s), FAULT) for at_s in range(17)]
    assert [at_s for at_s, effects in enumerate(said) if FAULT.effect in effects] == [0, 5]  # the third waits
    assert say(presenter, 17.0, graver) == [graver.effect]


def test_a_suspicion_waits_a_second_and_is_dropped_for_a_fault() -> None:
    suspicion = Notice(Kind.SUSPECT, ("roll x",))
    said: list[Effect] = [suspicion.effect]
    presenter = Presenter()
    assert [say(presenter, at_s, suspicion) for at_s in (0.0, 0.5, 0.9)] == [[], [], []]
    assert [say(presenter, at_s, suspicion) for at_s in (1.0, 1.1)] == [said, []]
    presenter = Presenter()
    assert (say(presenter, 0.0, suspicion), say(presenter, 0.1, FAULT)) == ([], [FAULT.effect])
    assert say(presenter, 2.0) == []
    presenter = Presenter()  # what is over before, as at a landing, is said all the same
    assert (say(presenter, 0.0, suspicion), say(presenter, 0.1)) == ([], said)


@pytest.mark.parametrize(
    ("held", "words", "advice"),
    [
        (Diagnosis(), "", ""),
        (replace(PROPELLER, stage=Stage.QUIET), "", ""),
        (replace(CRACK, stage=Stage.FAULT), "motor 3 .*crack .*3.3 times its threshold", "Land, .*motor 3 first"),
        (SENSOR, "sensor fault .*does not mean that it is gone", "no propeller is blamed"),
        (Diagnosis(Stage.FAULT, kind=FaultKind.GROSS_LOSS, seen=True, rotor=2), "thrust at motor 2", "motors, contr"),
        (replace(PROPELLER, stage=Stage.SUSPECTED), "suspected, not declared, rotor unknown", "before the next flight"),
        (Diagnosis(Stage.INSPECT, rotor=3, rotors=(RotorSpan(3, 0),)), "earlier flight .motor 3", "motor 3 first"),
    ],
)
def test_what_is_held_and_what_to_do(held: Diagnosis, words: str, advice: str) -> None:
    for said, wanted in ((held_sentence(held), words), (held_advice(held), advice)):
        assert re.search(wanted, said)
        assert bool(said) == bool(wanted)


def test_answers_of_other_systems_and_to_others_do_not_count() -> None:
    ours = (MavCmd.NAV_LAND, MavResult.ACCEPTED, 0, 0)
    frames = list[Frame]()
    for sender, target in [((2, 1), (2, 191)), ((1, 190), (1, 191)), ((1, 1), (255, 190)), ((1, 1), (7, 191))]:
        frames += Decoder().feed(Encoder(*sender).encode(MessageId.COMMAND_ACK, *ours, *target), 0)
    # The frames of another system never reach a vehicle's session, see `LinkDecoder.received`.
    assert acks_in(frame for frame in frames if frame.sysid == 1) == ()
    [right] = Decoder().feed(Encoder(1, 1).encode(MessageId.COMMAND_ACK, *ours, 1, Component.ONBOARD_COMPUTER), 0)
    assert acks_in([right]) == (Ack(MavCmd.NAV_LAND, MavResult.ACCEPTED),)


def test_the_run_length_is_told_of_the_thesis_monitor_only_and_what_is_not_finite_is_null() -> None:
    found = json.loads(json.dumps(event_json(Event("fsd", Axis.ROLL, 60_000_000_000, None, 0.41, 0.12, 0.05))))
    assert (found["axis"], found["fsd_s"], found["fml_s"], found["end_s"]) == ("roll", 0.41, 0.12, None)
    other = event_json(Event("innovation", None, 1, 2, float("inf"), 0.12, 0.05, rotor=2, confidence=0.98765))
    assert (other["statistic"], other["fsd_s"], other["rotor"], other["confidence"]) == (None, None, 2, 0.988)
    silent = MonitorSummary("unbalance", Axis.ROLL, float("nan"), float("inf"), "g mm", 0)
    found = json.loads(json_line({"a": (1.5, float("-inf")), "b": [silent]}))
    assert found["a"] == [1.5, None]
    assert (found["b"][0]["maximum"], found["b"][0]["threshold"], found["b"][0]["axis"]) == (None, None, "roll")
