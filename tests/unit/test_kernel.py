"""The compiled pass against its definition: looks, alarms, what was judged; and that no cut of rows changes a bit."""

import itertools
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_baselines import thesis, whole
from made_flights import hard_flight
from made_statistics import alarms_of, looked_of
from made_telemetry import flight

from mavdiag.chain import Chain, chain_of
from mavdiag.kernel import Account, Alarm, Looked, Piece, Stretch
from mavdiag.rows.front import Rows
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_S

Told = tuple[tuple[Alarm, ...], tuple[Account, ...], int, int, tuple[Stretch, ...]]


@cache
def segment(name: str) -> tuple[Chain, Rows]:
    """A chain, and the longest segment of a flight with faults and losses."""
    made = chain_of(whole() if name == "whole" else thesis())
    push = np.where(np.arange(9000) // 700 % 3 == 1, 0.2, 0.0)
    telemetry = hard_flight(1) if name == "whole" else flight(9000, 1, push=push)
    parts = [part for part in made.front.pieces([telemetry]) if isinstance(part, Rows)]
    return made, max(parts, key=lambda part: len(part.block))


def judged(name: str, edges: list[int]) -> tuple[list[Looked], list[Piece], Told]:
    made, rows = segment(name)
    memory, looked, pieces = made.kernel.start(), list[Looked](), list[Piece]()
    for cut in itertools.pairwise(sorted({0, len(rows.block), *edges})):
        more, piece = made.kernel.step(memory, rows.part(*cut))
        looked.append(more)
        pieces.append(piece)
    looked.append(made.kernel.close(memory, int(rows.block.t_ns[-1])))
    told = (made.kernel.open_alarms(memory), made.kernel.accounts(memory), memory.flown, memory.judged)
    made.kernel.restart(memory)
    return looked, pieces, (*told, memory.unjudged)


def joined(looked: list[Looked]) -> tuple[object, ...]:
    arrays = [np.concatenate([getattr(one, name)[: len(one.heights)] for one in looked if len(one.heights)]).tobytes()
              for name in ("readings", "sums")]  # fmt: skip
    flat = [[x for one in looked for x in getattr(one, name)] for name in ("heights", "leads", "alarms")]
    return (*arrays, *flat)


@pytest.mark.parametrize("name", ["whole", "thesis"])
def test_looks_and_alarms_are_what_their_definition_says(name: str) -> None:
    made, rows = segment(name)
    looked, (piece,), (lasting, *_) = judged(name, [])
    lag = len(rows.block) - len(rows.rates)
    arrived: list[IntArray] = []
    for slot, at, count in zip(made.slots, piece.at, piece.counts, strict=True):
        arrived.append(rows.block.t_ns[at[:count] + (lag if slot.monitor.by_rates else 0)])
    expected = looked_of(made.slots, piece.found, int(rows.block.t_ns[-1]), arrived)
    for found, wanted in zip(looked, expected, strict=True):
        skipped = wanted.first - found.first  # looks before the first value
        assert skipped >= 0
        assert set(found.heights[:skipped]) <= {-1}
        assert list(found.heights[skipped:]) == list(wanted.heights)
        assert list(found.leads[skipped:]) == list(wanted.leads)
        count = len(wanted.heights)
        np.testing.assert_allclose(found.readings[skipped : skipped + count], wanted.readings[:count], rtol=1e-12)
        np.testing.assert_allclose(found.sums[skipped : skipped + count], wanted.sums[:count], rtol=1e-9, atol=1e-12)
        assert sorted(found.alarms, key=repr) == sorted(wanted.alarms, key=repr)
    assert any(one.alarms for one in looked)
    for alarm in lasting:
        started = alarms_of(alarm.slot, made.slots[alarm.slot], piece.found[alarm.slot], [0] * int(piece.counts.max()))
        assert alarm.start_ns == started[-1].start_ns
        assert started[-1].end_ns == -1


@settings(max_examples=12, deadline=None)
@given(name=st.sampled_from(["whole", "thesis"]), edges=st.lists(st.integers(1, 1000), max_size=40))
def test_no_cut_of_the_rows_changes_a_bit(name: str, edges: list[int]) -> None:
    (looked, pieces, told), (whole_looked, (one,), whole_told) = judged(name, edges), judged(name, [])
    assert joined(looked) == joined(whole_looked)
    assert told == whole_told
    for number, expected in enumerate(one.found):
        for field in ("t_ns", "value", "valid", "level", "signal"):
            values = np.concatenate([getattr(piece.found[number], field) for piece in pieces])
            assert values.tobytes() == getattr(expected, field).tobytes()


@pytest.mark.parametrize("name", ["whole", "thesis"])
def test_accounts_add_up(name: str) -> None:
    made, rows = segment(name)
    _, (piece,), (_, accounts, flown, covered, unjudged) = judged(name, [])
    for account, found in zip(accounts, piece.found, strict=True):
        assert account.flight_s == pytest.approx(len(rows.block) * rows.block.dt_s)
        assert account.judged_s == pytest.approx(found.judged_s)
        assert account.peak == (found.value[found.valid].max() if found.valid.any() else None)
        spans = account.judged_s + account.outside_s + sum(account.not_judged.values())
        assert spans == pytest.approx(account.flight_s, abs=max(made.kernel.periods_s))
    assert 0 < covered <= flown <= len(rows.block)
    lost = sum((stop - first) / NS_PER_S + rows.block.dt_s for first, stop in unjudged)
    assert lost == pytest.approx((flown - covered) * rows.block.dt_s)
