"""Flight records from plain figures."""

from collections.abc import Sequence

import numpy as np

from mavdiag.archive.figures import FlightRecord, SlotFigures
from mavdiag.history.warn import Series
from mavdiag.judging import Verdict
from mavdiag.telemetry import Axis, FloatArray
from mavdiag.units import NS_PER_S

START_NS = 1_767_225_600 * NS_PER_S  # 2026-01-01
DAY_NS = 86_400 * NS_PER_S


def series(share: FloatArray, *, a_session: int = 2, name: str = "unbalance") -> Series:
    """A series with so many flights a session; its threshold is 1."""
    return Series(name, None, "", 1.0, np.arange(len(share)) // a_session, share)


def record(
    number: int, peak: float | None = 0.5, *, airframe: str = "one", baseline: str = "sha256:b", t_ns: int | None = None
) -> FlightRecord:
    """A flight on a day of its own."""
    slots = (
        SlotFigures("fsd", Axis.ROLL, "s", 0.2, 0.0, 0.1, 12.5),
        SlotFigures("fsd", Axis.PITCH, "s", 0.25, 0.0, 0.05, 12.5),
        SlotFigures("unbalance", None, "g mm", 1.0, None if peak is None else 0.8 * peak, peak, 12.0),
        SlotFigures("control_loss", None, "rad/s", 7.0, 0.1, 1.0, 12.0),
    )
    return FlightRecord(
        airframe=airframe,
        log=f"flight {number}.tlog",
        content=f"{airframe}-{number:04}",
        started_ns=START_NS + number * DAY_NS if t_ns is None else t_ns,
        added_ns=START_NS + number,
        baseline=baseline,
        verdict=Verdict.HEALTHY,
        reason="no alarm; judged by unbalance 12.0 s",
        judged_s=12.0,
        slots=slots,
        rotor_trim=(0.001, -0.002, 0.0, number * 1e-4),
    )


def records(peaks: Sequence[float | None], *, airframe: str = "one") -> tuple[FlightRecord, ...]:
    """Flights day by day, with these peaks of the unbalance."""
    return tuple(record(number, peak, airframe=airframe) for number, peak in enumerate(peaks, 1))
