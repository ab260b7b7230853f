"""The diagnosis in words: what the pilot reads, how often, and the sentences and JSON of a finding."""

import itertools
import json
import math
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.alerts import TEXT_BYTES, Kind, Notice, Presenter, Telling
from detector.values import Effect, SendText
from mavdiag.as_json import event_json, json_line
from mavdiag.decision.alarm import Event
from mavdiag.decision.diagnosis import Diagnosis, RotorSpan, Stage
from mavdiag.decision.words import held_advice, held_sentence
from mavdiag.judging import MonitorSummary
from mavdiag.monitors import MONITORS, by_name
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Axis, Instant

FIGURES = (0.0, 0.118, 98.7, 1e9, float("inf"), float("nan"))
CAUSES = list(itertools.product((None, 1, 12), (None, "F3"), (None, 3)))
UNITS = {"fsd": "s", "unbalance": "g mm"}


def finding(
    monitor: str = "fsd",
    axis: Axis | None = Axis.ROLL,
    found: float = 0.41,
    limit: float = 0.12,
    cause: tuple[int | None, str | None, int | None] = (None, None, None),
    stage: Stage = Stage.FAULT,
    seen: bool = True,
) -> Diagnosis:
    rotor, fault_type, severity = cause
    return Diagnosis(
        stage=stage,
        reason="made",
        monitor=monitor,
        axis=axis,
        unit=UNITS.get(monitor, ""),
        statistic=found,
        threshold=limit,
        rotor=rotor,
        fault_type=fault_type,
        severity=severity,
        kind=by_name(monitor).kind,
        seen=seen,
        rotors=() if rotor is None else (RotorSpan(rotor, 0),),
    )


def text(*diagnoses: Diagnosis) -> str:
    telling = Telling()
    [notice] = [telling.step(diagnosis, 1) for diagnosis in diagnoses][-1]
    return notice.text


FAULT = Notice(Kind.FAULT, ("roll x",), "roll")


def say(presenter: Presenter, at_s: float, *notices: Notice) -> list[Effect]:
    return presenter.present(notices, Instant(round(at_s * 1e9)))


def test_h15_an_alert_reads_as_a_pilot_can_use_it() -> None:
    """They read "PROP FAULT innovation 2.84>2.22", "2.221>2.217"."""
    trim = finding("rotor_trim", None, 0.235, 0.05, (3, None, None))
    assert text(trim) == "PROP FAULT motor 3 lost 19% thrust"
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
    for monitor, axis, found, limit in itertools.product(
        [monitor.name for monitor in MONITORS], (None, *Axis), FIGURES, FIGURES
    ):
        given = finding(monitor, axis, found, limit, cause, stage)
        said = text(given)
        assert len(said.encode()) <= TEXT_BYTES
        assert not said.endswith("..")
        if stage is Stage.FAULT:
            assert not text(given, replace(given, seen=False), given).endswith("..")


@given(words=st.lists(st.text(max_size=80), min_size=2, max_size=2), kind=st.sampled_from(Kind))
def test_whatever_the_words_a_text_has_1_to_50_bytes(words: list[str], kind: Kind) -> None:
    count = kind.value.template.count("{}")
    assert 0 < len(Notice(kind, tuple(words[:count])).text.encode()) <= TEXT_BYTES


def test_l8_a_fault_that_lasts_is_repeated_after_5_15_60_s_and_then_every_minute() -> None:
    presenter, said = Presenter(), []
    for tick in range(2500):
        effects = say(presenter, tick / 10, FAULT)
        said += [tick / 10 for effect in effects if isinstance(effect, SendText)]
    assert said == [0.0, 5.0, 15.0, 60.0, 120.0, 180.0, 240.0]


def test_a_suspicion_waits_a_second_and_is_dropped_for_a_fault() -> None:
    suspicion = Notice(Kind.SUSPECT, ("roll x",))
    said: list[Effect] = [suspicion.effect]
    presenter = Presenter()
    assert [say(presenter, at_s, suspicion) for at_s in (0.0, 0.5, 0.9)] == [[], [], []]
    assert [say(presenter, at_s, suspicion) for at_s in (1.0, 1.1)] == [said, []]
    presenter = Presenter()
    assert say(presenter, 0.0, suspicion) == []
    assert say(presenter, 0.1, FAULT) == [FAULT.effect]
    assert say(presenter, 2.0) == []
    presenter = Presenter()  # what is over before, as at a landing, is said all the same
    assert say(presenter, 0.0, suspicion) == []
    assert say(presenter, 0.1) == said


PROPELLER = Diagnosis(monitor="rotor_trim", statistic=0.066, threshold=0.02, kind=FaultKind.PROPELLER)
CRACK = replace(PROPELLER, rotor=3, fault_type="F2", severity=2, seen=True, rotors=(RotorSpan(3, 0),))
SENSOR = Diagnosis(Stage.FAULT, kind=FaultKind.SENSOR, statistic=math.inf, threshold=1.0)


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


def test_the_run_length_and_its_limit_are_told_of_the_thesis_monitor_only() -> None:
    event = Event("fsd", Axis.ROLL, 60_000_000_000, None, 0.41, 0.12, 0.05)
    found = json.loads(json.dumps(event_json(60.0, None, event)))
    assert (found["axis"], found["fsd_s"], found["fml_s"], found["end_s"]) == ("roll", 0.41, 0.12, None)
    other = event_json(1.0, 2.0, Event("innovation", None, 1, 2, float("inf"), 0.12, 0.05, rotor=2, confidence=0.98765))
    assert (other["statistic"], other["fsd_s"], other["rotor"], other["confidence"]) == (None, None, 2, 0.988)


def test_what_is_not_finite_is_null_wherever_it_stands() -> None:
    silent = MonitorSummary("unbalance", Axis.ROLL, float("nan"), float("inf"), "g mm", 0)
    found = json.loads(json_line({"a": (1.5, float("-inf")), "b": [silent]}))
    assert found["a"] == [1.5, None]
    assert (found["b"][0]["maximum"], found["b"][0]["threshold"], found["b"][0]["axis"]) == (None, None, "roll")
