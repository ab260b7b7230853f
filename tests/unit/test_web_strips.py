"""The strips of the live page: the same points however the flight is cut, and no peak is lost."""

from dataclasses import replace

import numpy as np
import pytest
from made_baselines import thesis
from made_telemetry import cut, flight

from detector.web.strips import BIN_NS, Strip, strips_of
from mavdiag.chain import Chain, chain_of
from mavdiag.kernel import Piece
from mavdiag.monitors.columns import SIGNAL
from mavdiag.telemetry import Axis, Signal


@pytest.fixture(scope="module")
def judged() -> tuple[Chain, list[Piece]]:
    chain, telemetry = chain_of(thesis()), flight(6000, 5)
    state, pieces = chain.start(), list[Piece]()
    began_ns = int(telemetry[Signal.BODY_RATE].host_ns[0])
    for chunk in cut(telemetry, [began_ns + k * 130_000_000 for k in range(1, 46)]):
        state, output = chain.step(state, chunk)
        pieces += output.pieces
    return chain, pieces


def merged(strips: list[Strip]) -> dict[int, tuple[float, float, float, bool]]:
    """As the page puts them together: points of one bin become one."""
    found: dict[int, tuple[float, float, float, bool]] = {}
    for strip in strips:
        for i, number in enumerate(strip.bins):
            low, high, fsd_s, valid = found.get(number, (np.inf, -np.inf, 0.0, False))
            longest, judged = max(fsd_s, strip.fsd_s[i]), valid or strip.judged[i]
            found[number] = min(low, strip.low[i]), max(high, strip.high[i]), longest, judged
    return found


@pytest.mark.parametrize("size", [1, 2, 7])
def test_any_cut_gives_the_same_points(judged: tuple[Chain, list[Piece]], size: int) -> None:
    chain, pieces = judged
    whole = strips_of(chain, pieces)
    parts = [strips_of(chain, pieces[i : i + size]) for i in range(0, len(pieces), size)]
    assert [one.axis for one in whole] == [Axis.ROLL, Axis.PITCH]
    for number, one in enumerate(whole):
        assert merged([part[number] for part in parts]) == merged([one])


def test_no_peak_is_lost_and_there_are_few_points(judged: tuple[Chain, list[Piece]]) -> None:
    chain, pieces = judged
    rows = sum(len(piece.rows.rates) for piece in pieces)
    for number, strip in enumerate(strips_of(chain, pieces)):
        signal = np.concatenate([piece.found[number].signal for piece in pieces])
        t_ns = np.concatenate([piece.found[number].t_ns for piece in pieces])
        assert max(strip.high) == pytest.approx(float(signal.max()), abs=1e-5)
        assert min(strip.low) == pytest.approx(float(signal.min()), abs=1e-5)
        assert strip.bins == tuple(sorted(set((t_ns // BIN_NS).tolist())))
        assert len(strip.bins) <= rows / 4


def test_without_rows_there_are_no_points(judged: tuple[Chain, list[Piece]]) -> None:
    chain, _ = judged
    assert [one.bins for one in strips_of(chain, [])] == [(), ()]


def test_a_model_that_runs_away_gives_figures_all_the_same(judged: tuple[Chain, list[Piece]]) -> None:
    chain, pieces = judged
    out = pieces[0].out.copy()
    out[:, SIGNAL] = np.where(out[:, SIGNAL] > 0, np.inf, np.nan)
    for strip in strips_of(chain, [replace(pieces[0], out=out)]):
        assert np.isfinite([*strip.low, *strip.high]).all()
