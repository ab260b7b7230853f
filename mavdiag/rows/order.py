"""Whether the samples of one vehicle come in the order of their times, across its signals: `calm_from_ns`.

A link is orderly while every sample comes before the gyro is `ORDER_NS` further than its time. Then nothing that a row
needs is on its way any more when the gyro is so much further than the row. Where the gyro or an interpolated signal
misses a sample, that is seen; that a held signal misses one is not, for it may have nothing to tell. So rows may leave
early only while the link is orderly. The first held sample that comes late on a link that was orderly counts in a log
from its own time on, and live from the next row on; then the link is not orderly for `CALM_NS`.
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
    for one in telemetry.series:
        if one.signal in signals and (one.t_ns <= newest[hosts.searchsorted(one.host_ns)] - ORDER_NS).any():
            return max(calm_ns, int(newest[-1]) + CALM_NS)
    return calm_ns
