"""Which flights count as new, of which session and set each is, and what is said of them together."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from made_history import DAY_NS, START_NS, record

from mavdiag.archive import together as module
from mavdiag.archive.figures import FlightRecord
from mavdiag.archive.together import Reference, Taught, together
from mavdiag.history.show import lines_of, overview_json
from mavdiag.history.warn import Mark, MarkKind, overview_of
from mavdiag.thresholds.evidence import Evidence, Flown, evidence_of

C = np.array([[-0.25, -0.25, 0.25, 0.25], [0.25, -0.25, -0.25, 0.25], [0.25, -0.25, 0.25, -0.25]])
HOUR_NS = DAY_NS // 24
TAUGHT = tuple(Taught("abcd"[i] * 64, START_NS + i // 2 * DAY_NS, i // 2, 0, 60.0, (0.0, 0.0, 0.1)) for i in range(4))
REFERENCE = Reference("sha256:b", tuple(map(tuple, C.tolist())), TAUGHT)


def flown(starts_ns: Sequence[int], rise: float = 0.0) -> list[FlightRecord]:
    """Flights that began then, with a rise of rotor 3."""
    trim = tuple((np.array([0.0, 0.0, 0.1]) + rise * C[:, 2]).tolist())
    return [replace(record(i, t_ns=t_ns), trim=trim) for i, t_ns in enumerate(starts_ns)]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Flown]:
    """What was asked of the law."""
    found: list[Flown] = []

    def ask(flights: Flown, *rest: object) -> Evidence:
        found.append(flights)
        return evidence_of(flights, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "evidence_of", ask)
    return found


def test_flights_within_an_hour_share_a_session_and_those_without_a_clock_may(asked: list[Flown]) -> None:
    day = START_NS + 9 * DAY_NS
    together(REFERENCE, flown([START_NS + HOUR_NS // 2, day, day + HOUR_NS // 2, 0, day + DAY_NS, day + 2 * DAY_NS]))
    assert [one.sessions.tolist()[4:] for one in asked] == [[0, 3, 3, 3, 3, 4], [0, 3, 3, 4, 5, 6]]
    asked.clear()
    together(REFERENCE, flown([START_NS, START_NS + 1]), new_propellers=True)
    assert [one.sessions.tolist()[4:] for one in asked] == [[2, 2]]
    assert asked[0].propellers.tolist() == [0, 0, 0, 0, 1, 1]


def test_without_clocks_the_lower_odds_of_both_readings_are_told(asked: list[Flown]) -> None:
    said = together(REFERENCE, flown([0, 0, 0], rise=0.1))
    odds = [evidence_of(one, C, module.priors_of(C)).odds for one in asked]
    assert said.evidence is not None
    assert len(odds) == 2
    assert said.evidence.odds == min(odds)


def test_flights_that_taught_and_those_without_a_trim_do_not_count(asked: list[Flown]) -> None:
    one, other, third = flown([START_NS + i * DAY_NS for i in (5, 6, 7)])
    said = together(REFERENCE, [replace(one, content="a" * 64 + ":1"), replace(other, trim=()), third])
    assert said.flights == 1
    assert said.since is third
    assert len(asked[0].trims) == 5
    assert together(REFERENCE, [replace(third, trim=())]).evidence is None
    assert "nothing can be said" in str(together(replace(REFERENCE, flights=()), [third]))


def test_a_change_is_told_with_its_rotor_odds_and_first_flight() -> None:
    days = [START_NS + i * DAY_NS for i in range(5, 13)]
    healthy, damaged = flown(days[:4]), flown(days[4:], rise=0.1)
    said = together(REFERENCE, [*healthy, *damaged])
    assert said.changed
    assert said.rotors == (3,)
    assert said.since == damaged[0]
    assert "8 flights together: rotor 3 has changed, " in str(said)
    assert str(said).endswith(" to 1, since flight 0.tlog")
    assert not together(REFERENCE, healthy).changed
    assert "no rotor is known to have changed" in str(together(REFERENCE, healthy))


def test_new_propellers_begin_anew_and_may_differ() -> None:
    flights = [*flown([START_NS + i * DAY_NS for i in range(5, 13)], rise=0.1)]
    found = overview_of("one", flights, (), (REFERENCE,))
    assert found.together is not None
    assert found.together.changed
    assert overview_json(found)["together"]["rotors"] == [3]
    assert any(line.loud and "rotor 3 has changed" in line.text for line in lines_of(found))
    mark = Mark("one", flights[3].started_ns + 1, MarkKind.NEW_PROPELLERS)
    fresh = overview_of("one", flown([one.started_ns for one in flights], rise=0.02), (mark,), (REFERENCE,))
    assert fresh.together is not None
    assert fresh.together.flights == 4
    assert not fresh.together.changed
    assert overview_of("one", flights, (), ()).together is None
