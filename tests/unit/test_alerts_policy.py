"""What is said, how loudly, how often: every text within 50 bytes, every budget kept."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.alerts import (
    GAP_S,
    POLICY,
    TEXT_BYTES,
    Kind,
    Notice,
    Presenter,
    alert_notice,
    figure,
    label_of,
    present,
)
from detector.streams import Reason
from detector.values import Effect, SendText, TextSuppressed
from mavdiag.decision.alarm import Change, Stage
from mavdiag.link.messages import Severity
from mavdiag.monitors import MONITORS
from mavdiag.telemetry import Axis, Instant

FIGURES = (0.0, 0.09, 0.118, 0.41, 9.99, 12.34, 98.7, 1234.5, 1e9, float("inf"), float("nan"))
CAUSES = list(itertools.product((None, 1, 4, 12), (None, "F1", "F2", "F3"), (None, 1, 3)))
UNITS = {"fsd": "s", "unbalance": "g mm"}


def finding(
    monitor: str = "fsd",
    axis: Axis | None = Axis.ROLL,
    found: float = 0.41,
    limit: float = 0.12,
    cause: tuple[int | None, str | None, int | None] = (None, None, None),
    stage: Stage = Stage.FAULT,
) -> Change:
    rotor, fault_type, severity = cause
    return Change(
        stage=stage,
        t_ns=0,
        reason="made",
        monitor=monitor,
        axis=axis,
        unit=UNITS.get(monitor, ""),
        statistic=found,
        threshold=limit,
        rotor=rotor,
        confidence=None,
        fault_type=fault_type,
        severity=severity,
    )


def text(change: Change) -> str:
    return alert_notice(change, fault=change.stage is Stage.FAULT, key="").text


FAULT = Notice(Kind.FAULT, ("roll x",), "roll")


def say(presenter: Presenter, at_s: float, *notices: Notice) -> tuple[Presenter, list[Effect]]:
    presenter, effects = present(presenter, notices, Instant(round(at_s * 1e9)))
    return presenter, list(effects)


def test_the_alert_reads_as_the_contract_says() -> None:
    assert text(finding(cause=(1, "F2", 2))) == "PROP FAULT r1 F2/SV2 FSD 0.41s>FML 0.12s"
    assert text(finding()) == "PROP FAULT roll FSD 0.41s>FML 0.12s"


def test_l8_a_weak_motor_reads_as_a_pilot_can_use_it() -> None:
    assert text(finding("rotor_trim", None, 0.112, 0.05, (2, None, None))) == "PROP FAULT motor 2 weak 11%"
    assert text(finding("unbalance", None, 12.34, 8.1, (3, "F2", 2))) == "PROP FAULT motor 3 F2/SV2 unbalance 12.3>8.10"


def test_l8_an_unknown_rotor_is_left_out() -> None:
    """It was called "vehicle"."""
    assert text(finding("rotor_trim", None, 0.112, 0.05)) == f"PROP FAULT {label_of('rotor_trim')} 0.11>0.05"


def test_b21_monitors_go_by_their_labels_in_full() -> None:
    """The operator read `innovatio 3.12>2.50`."""
    assert text(finding("innovation", None, 3.12, 2.5)) == "PROP FAULT innovation 3.12>2.50"
    for monitor in MONITORS:
        assert label_of(monitor.name) == monitor.label
        assert len(monitor.label) <= 10


@pytest.mark.parametrize("stage", [Stage.FAULT, Stage.SUSPECTED])
@pytest.mark.parametrize("cause", CAUSES)
def test_an_alert_is_never_cut_whatever_its_figures(
    stage: Stage, cause: tuple[int | None, str | None, int | None]
) -> None:
    for monitor, axis, found, limit in itertools.product(
        [monitor.name for monitor in MONITORS], (None, *Axis), FIGURES, FIGURES
    ):
        said = text(finding(monitor, axis, found, limit, cause, stage))
        assert len(said.encode()) <= TEXT_BYTES
        assert not said.endswith("..")


def test_the_end_of_an_alert_is_never_cut_either() -> None:
    for span in FIGURES:
        assert not Notice(Kind.CLEARED, (figure(span, 1),)).text.endswith("..")
    for reason in Reason:
        assert not Notice(Kind.UNSETTLED, (f"{reason} (1000 Hz)",)).text.endswith("..")


@pytest.mark.parametrize("reason", Reason)
def test_a_reason_is_never_cut(reason: Reason) -> None:
    """With its figure, or after the longest progress that it can follow."""
    words = {
        Kind.WAITING: (f"{reason} (1000 Hz)",),
        Kind.LEARNING: ("75", f": {reason}"),
    }
    if reason in (Reason.NOT_ARMED, Reason.NOT_AIRBORNE, Reason.GAPS):
        words[Kind.MONITORING] = (f": {reason}",)
    for kind, parts in words.items():
        assert not Notice(kind, parts).text.endswith(".."), kind


@given(words=st.lists(st.text(max_size=80), min_size=2, max_size=2), kind=st.sampled_from(Kind))
def test_whatever_the_words_a_text_has_1_to_50_bytes(words: list[str], kind: Kind) -> None:
    count = POLICY[kind].template.count("{}")
    assert 0 < len(Notice(kind, tuple(words[:count])).text.encode()) <= TEXT_BYTES


def test_figures_that_round_alike_get_another_decimal() -> None:
    assert text(finding(found=0.124, limit=0.121)) == "PROP FAULT roll FSD 0.124s>FML 0.121s"


def test_a_figure_below_its_threshold_is_not_said_to_be_above_it() -> None:
    """A suspicion begins at 0.8 of the threshold."""
    assert text(finding("innovation", None, 2.1, 2.5, stage=Stage.SUSPECTED)) == "PROP suspect innovation 2.10<2.50"


def test_only_declared_faults_are_critical_and_nothing_is_louder() -> None:
    critical = {kind for kind, policy in POLICY.items() if policy.severity <= Severity.CRITICAL}
    assert critical == {Kind.FAULT, Kind.SENSOR, Kind.CONTROL, Kind.THRUST}
    assert {kind for kind, policy in POLICY.items() if policy.severity is Severity.WARNING} == {
        Kind.SUSPECT,
        Kind.OFF,
        Kind.NOT_LEARNED,
        Kind.NO_LAYOUT,
        Kind.OTHER_LAYOUT,
        Kind.OTHER_VEHICLE,
    }
    assert {policy.severity for policy in POLICY.values()} == {Severity.CRITICAL, Severity.WARNING, Severity.INFO}


def test_l8_a_fault_that_lasts_is_repeated_after_5_15_60_s_and_then_every_minute() -> None:
    presenter, said = Presenter(), []
    for tick in range(2500):
        presenter, effects = say(presenter, tick / 10, FAULT)
        said += [tick / 10 for effect in effects if isinstance(effect, SendText)]
    assert said == [0.0, 5.0, 15.0, 60.0, 120.0, 180.0, 240.0]


def test_a_matter_that_lasts_in_silence_goes_on_where_it_was() -> None:
    presenter, said = Presenter(), []
    for tick in range(200):
        silent = 20 <= tick < 100
        presenter, effects = say(presenter, tick / 10, Notice(Kind.FAULT, ("roll x",), "roll", silent))
        said += [tick / 10 for effect in effects if isinstance(effect, SendText)]
    assert said == [0.0, 10.0, 15.0]  # the one that came due in silence is said at its end


def test_news_about_a_lasting_matter_waits_two_seconds_and_is_not_lost() -> None:
    presenter, _ = say(Presenter(), 0.0, FAULT)
    pitch, said = Notice(Kind.FAULT, ("pitch x",), "pitch"), []
    for tick in range(1, 40):
        presenter, effects = say(presenter, tick / 10, pitch)
        said += [tick / 10 for effect in effects if isinstance(effect, SendText)]
    assert said == [2.0]


def test_the_same_text_within_two_seconds_is_held_back_and_counted() -> None:
    lost = Notice(Kind.LINK_LOST)
    presenter, first = say(Presenter(), 0.0, lost)
    presenter, second = say(presenter, 1.0, lost)
    presenter, third = say(presenter, GAP_S, lost)
    assert [type(effects[0]) for effects in (first, second, third)] == [SendText, TextSuppressed, SendText]
    assert presenter.suppressed == 1


def test_chatter_cannot_use_up_the_budget_of_faults() -> None:
    presenter, said = Presenter(per_minute=10), 0
    for second in range(40):
        presenter, effects = say(presenter, 2.0 * second % 59, Notice(Kind.RATES, (str(second),)))
        said += sum(isinstance(effect, SendText) for effect in effects)
    assert said == 5
    _, effects = say(presenter, 59.0, FAULT)
    assert isinstance(effects[0], SendText)


def test_a_lasting_matter_that_the_budget_holds_back_is_counted_once_and_said_later() -> None:
    presenter = Presenter(per_minute=4)
    for at in (0.0, 3.0):
        presenter, _ = say(presenter, at, Notice(Kind.REBOOT))
    waiting, out = Notice(Kind.WAITING, ("no gyro",), "no gyro"), []
    for second in range(6, 70):
        presenter, effects = say(presenter, second, waiting)
        out += [(second, type(effect)) for effect in effects]
    assert out == [(6, TextSuppressed), (60, SendText)]


def test_a_matter_that_comes_back_after_a_while_is_news() -> None:
    presenter, _ = say(Presenter(), 0.0, FAULT)
    for tick in range(1, 30):
        presenter, _ = say(presenter, tick / 10)
    _, effects = say(presenter, 3.0, FAULT)
    assert [type(effect) for effect in effects] == [SendText]


def test_the_loudest_comes_first() -> None:
    _, effects = say(Presenter(), 0.0, Notice(Kind.REBOOT), FAULT)
    assert [effect.severity for effect in effects if isinstance(effect, SendText)] == [Severity.CRITICAL, Severity.INFO]
