"""The models of the thesis's monitor: which stretches of flight train them, and how (T 5.4)."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, Order, fit
from mavdiag.monitors.base import Flights
from mavdiag.monitors.healthy import cut_to_share
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray

__all__ = ["MIN_PIECE_S", "SETTLE_S", "train", "trained", "training_pieces", "training_spans"]

TRAIN_ROWS = 60_000  # one minute at 1 kHz: beyond it a model's standard errors no longer matter (our choice)
SETTLE_S = 1.0  # of each stretch that does not count in the figures of fit: it may begin in motion (our choice)
MIN_PIECE_S = 2.0  # shorter valid stretches do not train a model (our choice)


def training_pieces(flight: Sequence[Rows], axis: Axis) -> list[tuple[FloatArray, FloatArray]]:
    """Unbroken valid stretches of u and y of one axis, long enough to train on."""
    return [
        (rows.rates.u[first:stop, axis.column], rows.rates.y[first:stop, axis.column])
        for rows in flight
        for first, stop in _long_spans(rows.rates.commanded, rows.rates.dt_s)
    ]


def _long_spans(commanded: BoolArray, dt_s: float) -> list[tuple[int, int]]:
    """Spans of rows that are long enough to train on."""
    return [(first, stop) for first, stop in spans(commanded) if (stop - first) * dt_s >= MIN_PIECE_S]


def train(
    flights: Flights, axis: Axis, dt_s: float, order: Order = (2, 2, 1), method: Method = Method.SRIV
) -> ArxModel:
    """A model of one axis from a like share of every flight. Raises IdentificationError."""
    pieces = [piece for flight in flights for piece in training_pieces(flight, axis)]
    return trained(pieces, axis, dt_s, order, method)


def trained(
    pieces: Sequence[tuple[FloatArray, FloatArray]],
    axis: Axis,
    dt_s: float,
    order: Order,
    method: Method,
    figures: bool = True,
    near: ArxModel | None = None,
) -> ArxModel:
    """As `train`, from all pieces. figures, near: as in `identify.fit`."""
    if not pieces:
        raise IdentificationError(f"{axis}: no unbroken stretch of {MIN_PIECE_S:.0f} s to identify from; fly longer")
    taken = cut_to_share([len(u) for u, _ in pieces], TRAIN_ROWS, round(MIN_PIECE_S / dt_s))
    u = [piece[0][:count] for piece, count in zip(pieces, taken, strict=True)]
    y = [piece[1][:count] for piece, count in zip(pieces, taken, strict=True)]
    try:
        model = fit(u, y, order, dt=dt_s, method=method, settle_s=SETTLE_S, figures=figures, near=near)
    except IdentificationError as error:
        raise IdentificationError(f"{axis}: {error}") from error
    # The gain of a model with a pole at 1 that a zero cancels says nothing of the sign; the slope of y on u does.
    slope = sum(float(one @ other) for one, other in zip(u, y, strict=True)) / sum(float(one @ one) for one in u)
    gain = min(model.dc_gain, slope)
    if gain < 0:
        raise IdentificationError(
            f"{axis}: the gyro turns against its set-point (gain {gain:.2f}); check the sign conventions"
        )
    return model


def training_spans(stretches: IntArray, commanded: BoolArray, dt_s: float) -> Iterator[tuple[int, int]]:
    """Rows of a flight that are long enough to train on; none reaches from one stretch into the next."""
    for begin, end in itertools.pairwise(np.append(0, np.cumsum(stretches[:, 1])).tolist()):
        yield from ((begin + first, begin + stop) for first, stop in _long_spans(commanded[begin:end], dt_s))
