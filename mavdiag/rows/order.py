"""Whether the samples of one vehicle come in the order of their times, across its signals: `calm_from_ns`.

A link is orderly while every sample comes before the gyro is `ORDER_NS` further than its time. Then nothing that a row
needs is on its way any more when the gyro is so much further than the row. On a link that stops being orderly the
aligner sees where the gyro or an interpolated signal misses a sample, and waits for it. It cannot see that a held
signal misses one, or that a stopped signal has begun again. So the first such sample that comes late counts in a log
from its own time on, and live from the next row on; then the link is not orderly for `CALM_NS`, and rows wait for all.
"""

from collections.abc import Set

import numpy as np

from mavdiag.rows.stream import NEVER_NS, Stream
from mavdiag.telemetry import Signal, Telemetry
from mavdiag.units import NS_PER_MS, NS_PER_S

__all__ = ["CALM_NS", "ORDER_NS", "calm_from_ns"]

ORDER_NS = 5 * NS_PER_MS  # our choice
CALM_NS = 10 * NS_PER_S  # after a late sample, until the link counts as orderly again (our choice)
BEGIN_NS = NS_PER_S  # after the first gyro sample, likewise; nothing is judged so early (our choice)


def calm_from_ns(calm_ns: int, gyro: Stream | None, telemetry: Telemetry, signals: Set[Signal]) -> int:
    """From what vehicle time on the link is orderly [ns]; NEVER_NS before the first gyro sample.

    calm_ns: the answer before this chunk. gyro: its stream before it. signals: those that matter.
    """
    fresh = telemetry.get(Signal.BODY_RATE)
    newest, hosts = np.array([-NEVER_NS if gyro is None else gyro.newest]), np.empty(0, dtype=np.int64)
    if fresh is not None and len(fresh):
        newest, hosts = np.maximum.accumulate(np.concatenate((newest, fresh.t_ns))), fresh.host_ns
        if calm_ns == NEVER_NS:
            calm_ns = int(fresh.t_ns[0]) + BEGIN_NS
    used = [one for one in telemetry.series if one.signal in signals]
    if not used:
        return calm_ns
    t_ns = np.concatenate([one.t_ns for one in used])
    before = newest.take(hosts.searchsorted(np.concatenate([one.host_ns for one in used])))  # what the gyro had reached
    late = (t_ns <= before - ORDER_NS).any()
    return max(calm_ns, int(newest[-1]) + CALM_NS) if late else calm_ns
