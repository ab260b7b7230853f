"""At 1 kHz, where rows wait for their tick and their stride: any chunking gives the same values."""

import itertools
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavdiag.monitors.base import Monitor
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.testing import example_context

N, DT_S, SPEC = 7000, 0.001, RateSpec.of(0.001, 101)
FIELDS = ("t_ns", "value", "level", "signal", "valid", "rotors")


def block(seed: int, segment: int) -> Block:
    """Seven seconds of a made flight, with a bad row in the middle."""
    rng = np.random.default_rng([seed, segment])
    walk = np.cumsum(rng.normal(0, 0.003, (N, 3)), axis=0)
    absent = np.full((N, 3), np.nan)
    valid = np.ones(N, dtype=np.bool_)
    valid[6000:6010] = False
    t_ns = (segment * 100_000 + np.arange(N, dtype=np.int64)) * 1_000_000
    rate = np.gradient(walk, DT_S, axis=0) * 0.1 + rng.normal(0, 0.02, (N, 3))
    force = rng.normal((0, 0, -9.81), 0.3, (N, 3))
    thrust = 0.3 + 0.01 * rng.normal(size=N)
    always = np.ones(N, dtype=np.bool_)
    others = (absent, absent, thrust, walk, thrust, thrust, np.ones(N), absent, absent)
    return Block(segment, DT_S, t_ns, walk, rate, force, *others, valid, always, np.zeros(N))


def cut(blocks: list[Block], edges: list[int]) -> list[Rows]:
    """The blocks in pieces, with the rates that each piece completes."""
    out = []
    for one in blocks:
        state = SPEC.start()
        bounds = sorted({0, N, *edges})
        for low, high in itertools.pairwise(bounds):
            piece = one.rows(low, high)
            out.append(Rows(piece, SPEC.step(state, piece)))
    return out


@cache
def monitors() -> tuple[Monitor[Any], ...]:
    flights = [cut([block(9, 0)], [])]
    context = replace(example_context("qdrone2", DT_S), window=SPEC.window)
    return tuple(kind(*kind.fit(flights, context)) for kind in (Unbalance, RotorSignature))


def run(monitor: Monitor[Any], rows: list[Rows]) -> Statistic:
    parts = list(monitor.over(rows))
    joined = {name: np.concatenate([getattr(one, name) for one in parts]) for name in FIELDS}
    return Statistic(period_s=parts[0].period_s, **joined)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 3), edges=st.lists(st.integers(1, N - 1), max_size=80))
def test_any_chunking_gives_the_same_values_at_a_kilohertz(seed: int, edges: list[int]) -> None:
    blocks = [block(seed, 0), block(seed, 1)]
    for monitor in monitors():
        expected, found = run(monitor, cut(blocks, [])), run(monitor, cut(blocks, edges))
        np.testing.assert_array_equal(found.t_ns, expected.t_ns)
        np.testing.assert_array_equal(found.valid, expected.valid)
        assert expected.valid.any()
        assert not expected.valid.all()
        for name in ("value", "level", "signal", "rotors"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), rtol=1e-10, atol=1e-12, err_msg=monitor.name
            )
