"""Sweeps over model orders and filter windows, the thesis's way to choose both (T 5.3, 5.4, Fig 5.5)."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records
from mavdiag.identify.estimate import fit
from mavdiag.identify.model import ArxModel, Method, Order
from mavdiag.identify.validate import validate

Flights: TypeAlias = tuple[Records, Records]  # u and y
Candidate: TypeAlias = tuple[Order, int, Flights, Flights | None]  # window in samples; training, validation flights

#: T 5.4 tried 2 and 3 poles, numerators 0-4, delays 0-4.
ORDERS: tuple[Order, ...] = tuple(product(range(1, 4), range(1, 6), range(5)))


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One candidate."""

    order: Order
    window: int  # samples, 0 in an order sweep
    model: ArxModel | None  # None where identification refused
    r2t_validation: float  # R_T^2 on the validation flights, nan without them
    refused: str  # why

    @property
    def score(self) -> float:
        """R_T^2 on the validation flights, or on the training flights where there are none; -inf if refused."""
        if self.model is None:
            return -math.inf
        return self.model.r2t if math.isnan(self.r2t_validation) else self.r2t_validation


def sweep(candidates: Iterable[Candidate], *, dt: float, method: Method | str = Method.SRIV) -> tuple[SweepRow, ...]:
    """Fit each candidate on its training flights and judge it on its validation flights; a row for each.

    R_T^2 is taken against data filtered with the candidate's own window, as in the thesis (T Fig 5.5).
    """
    rows = []
    for order, window, train, validation in candidates:
        try:
            model = fit(*train, order, dt=dt, method=method)
        except IdentificationError as error:
            rows.append(SweepRow(order, window, None, math.nan, str(error)))
            continue
        r2t = validate(model, *validation).r2t if validation is not None else math.nan
        rows.append(SweepRow(order, window, model, r2t, ""))
    return tuple(rows)


def best_row(rows: Iterable[SweepRow], tolerance: float = 0.01) -> SweepRow:
    """The row with the lowest YIC among those whose R_T^2 is within `tolerance` (our choice) of the best."""
    usable = {row: row.model.yic for row in rows if row.model is not None}
    if not usable:
        raise IdentificationError("no candidate could be identified; record longer or more excited flight")
    limit = max(row.score for row in usable) - tolerance
    return min((row for row in usable if row.score >= limit), key=usable.__getitem__)
