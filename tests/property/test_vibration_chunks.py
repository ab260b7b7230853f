"""At 1 kHz, where rows wait for their tick and their stride: any chunking gives the same readings."""

import itertools
from functools import cache
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavdiag.airframe.layout import layout_named
from mavdiag.decision.events import Reading
from mavdiag.monitors import rotor_signature, unbalance
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec, rates, start

N, DT_S, SPEC = 7000, 0.001, RateSpec.of(0.001, 101)
FIELDS = ("t_ns", "statistic", "level", "signal", "valid", "rotors")


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
    return Block(
        segment, DT_S, t_ns, walk, rate, force, absent, absent, thrust, thrust, np.ones(N), absent, absent, valid
    )  # fmt: skip


def cut(blocks: list[Block], edges: list[int]) -> list[Rows]:
    """The blocks in pieces, with the rates that each piece completes."""
    state, out = start(SPEC), []
    for one in blocks:
        bounds = sorted({0, N, *edges})
        for low, high in itertools.pairwise(bounds):
            piece = one.rows(low, high)
            state, known = rates(SPEC, state, piece)
            out.append(Rows(piece, known))
    return out


@cache
def monitors() -> tuple[Monitor[Any], ...]:
    flights = [cut([block(9, 0)], [])]
    frame = layout_named("qdrone2")
    return unbalance.Unbalance(unbalance.fit(flights, frame)), rotor_signature.RotorSignature(
        rotor_signature.fit(flights, frame)
    )


def run(monitor: Monitor[Any], rows: list[Rows]) -> Reading:
    state, readings = monitor.start(), []
    for one in rows:
        state, reading = monitor.step(state, one)
        readings.append(reading)
    return Reading(*(np.concatenate([getattr(reading, name) for reading in readings]) for name in FIELDS))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 3), edges=st.lists(st.integers(1, N - 1), max_size=80))
def test_any_chunking_gives_the_same_readings_at_a_kilohertz(seed: int, edges: list[int]) -> None:
    blocks = [block(seed, 0), block(seed, 1)]
    for monitor in monitors():
        expected, found = run(monitor, cut(blocks, [])), run(monitor, cut(blocks, edges))
        np.testing.assert_array_equal(found.t_ns, expected.t_ns)
        np.testing.assert_array_equal(found.valid, expected.valid)
        assert expected.valid.any()
        assert not expected.valid.all()
        for name in ("statistic", "level", "signal", "rotors"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), rtol=1e-10, atol=1e-12, err_msg=monitor.name
            )
