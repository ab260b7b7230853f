"""What is said, how loudly, how often: every text within 50 bytes, every budget kept."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.alerts import GAP_S, POLICY, TEXT_BYTES, Cause, Kind, Notice, Speaker, evidence, figure, speak
from detector.effects import Effect, SendText, TextSuppressed
from detector.streams import Reason
from mavdiag.decision.events import Event
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Axis, Instant

FIGURES = (0.0, 0.09, 0.118, 0.41, 9.99, 12.34, 98.7, 1234.5, 1e9, float("inf"), float("nan"))
CAUSES = [
    Cause(rotor, fault, severity)
    for rotor, fault, severity in itertools.product((None, 1, 4, 12), (None, "F1", "F2", "F3"), (None, 1, 3))
]


def event(monitor: str = "latency", axis: Axis | None = Axis.ROLL, found: float = 0.41, limit: float = 0.12) -> Event:
    return Event(monitor, axis, 0, None, found, limit, 0.0)


def say(speaker: Speaker, at_s: float, *notices: Notice) -> tuple[Speaker, list[Effect]]:
    speaker, effects = speak(speaker, notices, Instant(round(at_s * 1e9)))
    return speaker, list(effects)


def test_the_alert_reads_as_the_contract_says() -> None:
    cause = Cause(1, "F2", 2)
    assert Notice(Kind.FAULT, (cause.who(event()), evidence(event()))).text == (
        "PROP FAULT r1 F2/SV2 FSD 0.41s>FML 0.12s"
    )
    assert Notice(Kind.FAULT, (Cause().who(event()), evidence(event()))).text == "PROP FAULT roll FSD 0.41s>FML 0.12s"


@pytest.mark.parametrize("kind", [Kind.FAULT, Kind.SUSPECT])
@pytest.mark.parametrize("cause", CAUSES)
def test_an_alert_is_never_cut_whatever_its_figures(kind: Kind, cause: Cause) -> None:
    for monitor, axis, found, limit in itertools.product(
        ("latency", "vibration", "a very long monitor's name"), (None, *Axis), FIGURES, FIGURES
    ):
        one = event(monitor, axis, found, limit)
        text = Notice(kind, (cause.who(one), evidence(one))).text
        assert len(text.encode()) <= TEXT_BYTES
        assert not text.endswith("..")


def test_the_end_of_an_alert_is_never_cut_either() -> None:
    for found, limit, span in itertools.product(FIGURES, FIGURES, FIGURES[:-1]):
        one = evidence(event(found=found, limit=limit))
        for notice in (Notice(Kind.CLEARED, (figure(span, 1), one)), Notice(Kind.UNSETTLED, (one,))):
            assert len(notice.text.encode()) <= TEXT_BYTES
            if span < 1e4:
                assert not notice.text.endswith("..")


@pytest.mark.parametrize("reason", Reason)
def test_a_reason_is_never_cut(reason: Reason) -> None:
    """With its figure, or after the longest progress or axes that it can follow."""
    words = {
        Kind.WAITING: (f"{reason} (1000 Hz)",),
        Kind.LEARNING: ("75", f": {reason}"),
    }
    if reason in (Reason.NOT_ARMED, Reason.NOT_AIRBORNE, Reason.GAPS):
        words[Kind.MONITORING] = ("roll, pitch, yaw", f": {reason}")
    for kind, parts in words.items():
        assert not Notice(kind, parts).text.endswith(".."), kind


@given(words=st.lists(st.text(max_size=80), min_size=2, max_size=2), kind=st.sampled_from(Kind))
def test_whatever_the_words_a_text_has_1_to_50_bytes(words: list[str], kind: Kind) -> None:
    count = POLICY[kind].template.count("{}")
    assert 0 < len(Notice(kind, tuple(words[:count])).text.encode()) <= TEXT_BYTES


def test_figures_that_round_alike_get_another_decimal() -> None:
    assert evidence(event(found=0.124, limit=0.121)) == "FSD 0.124s>FML 0.121s"


def test_only_declared_faults_are_critical_and_nothing_is_louder() -> None:
    critical = {kind for kind, policy in POLICY.items() if policy.severity <= Severity.CRITICAL}
    assert critical == {Kind.FAULT}
    assert {kind for kind, policy in POLICY.items() if policy.severity is Severity.WARNING} == {Kind.SUSPECT, Kind.OFF}
    assert {policy.severity for policy in POLICY.values()} == {Severity.CRITICAL, Severity.WARNING, Severity.INFO}


def test_a_lasting_matter_is_repeated_only_when_it_is_due() -> None:
    speaker, fault, said = Speaker(), Notice(Kind.FAULT, ("roll", "x"), "roll"), []
    for tick in range(300):
        speaker, effects = say(speaker, tick / 10, fault)
        said += [tick / 10 for effect in effects if isinstance(effect, SendText)]
    assert said == [0.0, 5.0, 10.0, 15.0, 20.0, 25.0]


def test_news_about_a_lasting_matter_waits_two_seconds_and_is_not_lost() -> None:
    speaker, _ = say(Speaker(), 0.0, Notice(Kind.FAULT, ("roll", "x"), "roll"))
    pitch, said = Notice(Kind.FAULT, ("pitch", "x"), "pitch"), []
    for tick in range(1, 40):
        speaker, effects = say(speaker, tick / 10, pitch)
        said += [tick / 10 for effect in effects if isinstance(effect, SendText)]
    assert said == [2.0]


def test_the_same_text_within_two_seconds_is_held_back_and_counted() -> None:
    lost = Notice(Kind.LINK_LOST)
    speaker, first = say(Speaker(), 0.0, lost)
    speaker, second = say(speaker, 1.0, lost)
    speaker, third = say(speaker, GAP_S, lost)
    assert [type(effects[0]) for effects in (first, second, third)] == [SendText, TextSuppressed, SendText]
    assert speaker.suppressed == 1


def test_chatter_cannot_use_up_the_budget_of_faults() -> None:
    speaker, said = Speaker(per_minute=10), 0
    for second in range(40):
        speaker, effects = say(speaker, 2.0 * second % 59, Notice(Kind.RATES, (str(second),)))
        said += sum(isinstance(effect, SendText) for effect in effects)
    assert said == 5
    _, effects = say(speaker, 59.0, Notice(Kind.FAULT, ("roll", "x"), "roll"))
    assert isinstance(effects[0], SendText)


def test_a_lasting_matter_that_the_budget_holds_back_is_counted_once_and_said_later() -> None:
    speaker = Speaker(per_minute=4)
    for at in (0.0, 3.0):
        speaker, _ = say(speaker, at, Notice(Kind.REBOOT))
    waiting, out = Notice(Kind.WAITING, ("no gyro",), "no gyro"), []
    for second in range(6, 70):
        speaker, effects = say(speaker, second, waiting)
        out += [(second, type(effect)) for effect in effects]
    assert out == [(6, TextSuppressed), (60, SendText)]


def test_a_matter_that_comes_back_after_a_while_is_news() -> None:
    fault = Notice(Kind.FAULT, ("roll", "x"), "roll")
    speaker, _ = say(Speaker(), 0.0, fault)
    for tick in range(1, 30):
        speaker, _ = say(speaker, tick / 10)
    _, effects = say(speaker, 3.0, fault)
    assert [type(effect) for effect in effects] == [SendText]


def test_the_loudest_comes_first() -> None:
    _, effects = say(Speaker(), 0.0, Notice(Kind.REBOOT), Notice(Kind.FAULT, ("roll", "x"), "roll"))
    assert [effect.severity for effect in effects if isinstance(effect, SendText)] == [Severity.CRITICAL, Severity.INFO]
