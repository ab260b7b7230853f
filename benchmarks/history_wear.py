"""How early wear is warned of, and how often healthy airframes: `python benchmarks/history_wear.py [drawn|emulated]`.

**drawn**: histories of figures. Each airframe has seven statistics over 200 flights. Their levels and their scatter,
within a session and between sessions, are those measured on emulated airframes and on recorded flights (`SCATTER`;
`scatter` measures the emulated ones again), times a factor of the airframe (log-normal, 0.4), with Student's t of 3
degrees within sessions, flights that are odd (up to 8 %), drifts over a session's batteries, sessions of 1 to some 15
flights, and flights that were not judged (up to 15 %). One statistic wears by a law of `history_laws` and is at its
threshold, scatter apart, after flight 150; others may follow it part of the way.

**emulated**: airframes as in `history_emulated`: whole flights, judged by the product.

An airframe counts as warned of at the first flight after which any statistic is. Demanded: 5 to 40 flights before
flight 150 for 90 % of 200 airframes, and 1 % of healthy airframes at most, in 200 flights.
"""

import argparse
import math
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from history_emulated import HEALTHY_FIRST, KINDS, Worn, flown
from history_laws import HARSH, LAWS, TUNED, Law, growth
from rich.console import Console
from rich.table import Table
from scipy.stats import beta

from mavdiag.archive.figures import FlightRecord
from mavdiag.history.trend import changes_of, sessions_of
from mavdiag.history.warn import GROWN, HORIZON, PROGRESS, Series, Stretch, series_of, warned_at
from mavdiag.judging import Verdict
from mavdiag.telemetry import Axis, FloatArray

FLIGHTS, REACHED = 200, 150
EARLY, LATE = 40, 5

# level (uniform), scatter of a flight in its session, scatter of a session; shares of the threshold. Emulated: six
# airframes, 100 flights each. Recorded: five Crazyflie flights, each judged by the other four.
SCATTER: Mapping[tuple[str, Axis | None], tuple[float, float, float, float]] = {
    ("fsd", Axis.ROLL): (0.30, 0.60, 0.075, 0.040),
    ("fsd", Axis.PITCH): (0.30, 0.60, 0.060, 0.040),
    ("innovation", None): (0.27, 0.55, 0.020, 0.012),
    ("rotor_signature", None): (0.27, 0.42, 0.036, 0.020),
    ("unbalance", None): (0.40, 0.65, 0.025, 0.045),
    ("rotor_trim", None): (0.10, 0.33, 0.035, 0.035),
    ("thrust_loss", None): (0.06, 0.14, 0.010, 0.015),
}
NOT_WORN = ("thrust_loss",)
ODD_FULL = ("fsd", "innovation")  # of one recorded flight in five they were much higher, the others a little


@dataclass(frozen=True, slots=True)
class Drawn:
    """An airframe's statistics, and how it wears."""

    law: str
    series: tuple[Series, ...]


def drawn(seed: int, number: int, law: str = "") -> Drawn:
    """A history of figures. law: of `LAWS` or `HARSH`; empty for a healthy airframe."""
    rng = np.random.default_rng([seed, number])
    session, place = _sessions(rng)
    factor = math.exp(0.4 * rng.standard_normal())
    odd = rng.random(FLIGHTS) < rng.uniform(0.0, 0.08)
    missed, worn = rng.uniform(0.0, 0.15), int(rng.integers(len(SCATTER) - len(NOT_WORN)))
    found = []
    for at, ((monitor, axis), (low, high, within, between)) in enumerate(SCATTER.items()):
        level = rng.uniform(low, high)
        noise = within * rng.standard_t(3, FLIGHTS) / math.sqrt(3)
        noise += between * rng.standard_normal(int(session[-1]) + 1)[session]
        noise += rng.uniform(-0.04, 0.04) * (rng.random() < 0.5) * place / 5
        share = level + factor * noise
        share += odd * rng.exponential(0.3, FLIGHTS) * (1.0 if monitor in ODD_FULL else 0.2)
        if law:
            share[:REACHED] += (1.0 - level) * _grown(law, at == worn, rng)
            share[REACHED:] = math.nan
        share = np.maximum(share, 0.0)
        share[rng.random(FLIGHTS) < missed] = math.nan
        found.append(Series(monitor, axis, "", 1.0, session, share))
    return Drawn(law, tuple(found))


def _sessions(rng: np.random.Generator) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], FloatArray]:
    """Session of each flight, and its place in it."""
    mean, sizes = rng.uniform(1.3, 7.0), list[int]()
    while sum(sizes) < FLIGHTS:
        sizes.append(int(rng.geometric(1 / mean)))
    session = np.repeat(np.arange(len(sizes)), sizes)[:FLIGHTS]
    place = np.concatenate([np.arange(size, dtype=np.float64) for size in sizes])[:FLIGHTS]
    return session.astype(np.int64), place


def _grown(law: str, worn: bool, rng: np.random.Generator) -> FloatArray:
    """What wear adds; three in ten of the other statistics follow it in a line, up to 0.8 of the way."""
    if worn:
        return growth({**LAWS, **HARSH}[law], REACHED, rng)
    follows = rng.uniform(0.0, 0.8) * (rng.random() < 0.3)
    return follows * np.arange(1, REACHED + 1) / REACHED


def first_warned(series: Sequence[Series], last: int) -> int | None:
    """The first flight, of those up to `last`, after which any of them is warned of."""
    found = (warned_at(one) for one in series)
    return min((flight for flight in found if flight is not None and flight <= last), default=None)


def lead_drawn(number: int, seed: int, laws: Sequence[str]) -> tuple[str, int | None]:
    """Law, and flights from the warning to flight 150; None if there was none by then."""
    law = laws[number % len(laws)]
    found = first_warned(drawn(seed, number, law).series, REACHED - 1)
    return law, None if found is None else REACHED - found


def healthy_drawn(number: int, seed: int) -> tuple[bool, int, int]:
    """Whether a healthy airframe is warned of; series with a change point, and change points."""
    series = drawn(seed, number).series
    changes = [changes_of(sessions_of(one.session, one.share)) for one in series]
    return first_warned(series, FLIGHTS) is not None, sum(bool(one) for one in changes), sum(map(len, changes))


def in_time(lead: int | None) -> bool:
    """As demanded."""
    return lead is not None and LATE <= lead <= EARLY


def interval(count: int, total: int) -> str:
    """A share with its 95 % interval (Clopper-Pearson)."""
    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, total - count + 1))
    high = 1.0 if count == total else float(beta.ppf(0.975, count + 1, total - count))
    return f"{count}/{total}, {100 * count / total:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def table(title: str, found: Sequence[tuple[str, int | None]]) -> None:
    """Leads by law, and of all."""
    shown = Table(title=title)
    for heading in ("law", "5 to 40 before", "earlier", "later or never", "lead: 5, 25, 50, 75, 95 %"):
        shown.add_column(heading)
    for law in (*dict.fromkeys(law for law, _ in found), ""):
        leads = [lead for name, lead in found if not law or name == law]
        good = sum(in_time(lead) for lead in leads)
        early = sum(lead is not None and lead > EARLY for lead in leads)
        quantiles = np.percentile([lead or 0 for lead in leads], (5, 25, 50, 75, 95))
        spread = " ".join(f"{one:.0f}" for one in quantiles)
        shown.add_row(law or "all", interval(good, len(leads)), str(early), str(len(leads) - good - early), spread)
    Console(width=130, highlight=False).print(shown)


def run_drawn(arguments: argparse.Namespace) -> None:
    """The table of drawn histories."""
    seed, count = arguments.seed, arguments.airframes
    with pool(arguments.workers) as workers:
        for title, laws in (("", tuple(LAWS)), (", not demanded", tuple(HARSH))):
            number = count if laws == tuple(LAWS) else count // 4
            leads = workers.map(partial(lead_drawn, seed=seed, laws=laws), range(number), chunksize=10)
            table(f"Drawn histories, seed {seed}{title}", list(leads))
        healthy = list(workers.map(partial(healthy_drawn, seed=seed + 1), range(arguments.healthy), chunksize=10))
    warned, jumps = sum(one[0] for one in healthy), sum(one[1] for one in healthy)
    print(f"healthy airframes warned of in {FLIGHTS} flights: {interval(warned, len(healthy))}")
    print(f"healthy series of {FLIGHTS} flights with a change point: {interval(jumps, len(healthy) * len(SCATTER))}")


def fly(number: int, seed: int, worn: bool, keep: Path) -> Worn:
    """An emulated airframe, worn by the kinds and the tuned laws in turn, or healthy."""
    kind = list(KINDS)[number % len(KINDS)] if worn else ""
    grown = np.zeros(FLIGHTS)
    if worn:
        rng = np.random.default_rng([seed, 0x1A3, number])
        grown[HEALTHY_FIRST:] = growth(law_of(number), FLIGHTS - HEALTHY_FIRST, rng)
    return flown(seed, number, kind, grown, keep)


def law_of(number: int) -> Law:
    """Each kind of wear meets each law."""
    return tuple(TUNED.values())[number // len(KINDS) % len(TUNED)]


def lead_emulated(worn: Worn) -> tuple[str, int | None]:
    """Kind, and flights from the warning to the last flight."""
    found = first_warned(_series(worn.records), FLIGHTS - 1)
    return worn.kind, None if found is None else FLIGHTS - found


def _series(records: Sequence[FlightRecord]) -> tuple[Series, ...]:
    return series_of(Stretch(1, "", tuple(records)))


def run_emulated(arguments: argparse.Namespace) -> None:
    """The table of emulated airframes."""
    seed, keep = arguments.seed, Path(arguments.keep)
    keep.mkdir(parents=True, exist_ok=True)
    with pool(arguments.workers) as workers:
        worn = list(_each(workers, partial(fly, seed=seed, worn=True, keep=keep), arguments.wearing))
        healthy = list(_each(workers, partial(fly, seed=seed + 1, worn=False, keep=keep), arguments.flown_healthy))
    if worn:
        leads = [lead_emulated(one) for one in worn]
        table(f"Emulated airframes, seed {seed}", leads)
        faults = [FLIGHTS - (_first_fault(one.records) or FLIGHTS) for one in worn]
        ahead = [(lead or 0) - fault for (_, lead), fault in zip(leads, faults, strict=True) if fault]
        print(
            f"judged as a fault before the last flight: {len(ahead)} airframes, warned of so many before that: {ahead}"
        )
    warned = [one.number for one in healthy if first_warned(_series(one.records), FLIGHTS)]
    wrong = sum(record.verdict is Verdict.FAULT for one in healthy for record in one.records)
    if healthy:
        print(f"healthy airframes warned of in {FLIGHTS} flights: {interval(len(warned), len(healthy))} {warned}")
        print(f"healthy flights judged as faults: {wrong} of {len(healthy) * FLIGHTS}")
        scatter(healthy)


def _each(workers: ProcessPoolExecutor, task: "partial[Worn]", count: int) -> Iterator[Worn]:
    """As they are flown, each said."""
    for done in as_completed([workers.submit(task, number) for number in range(count)]):
        one = done.result()
        print(f"airframe {one.number}: {one.kind or 'healthy'}, size {one.size:.3g}", flush=True)
        yield one


def _first_fault(records: Sequence[FlightRecord]) -> int | None:
    return next((number for number, one in enumerate(records, 1) if one.verdict is Verdict.FAULT), None)


def scatter(healthy: Sequence[Worn]) -> None:
    """What the drawn histories rest on, measured again."""
    shown = Table(title=f"Healthy emulated flights: {len(healthy)} airframes")
    for heading in ("statistic", "level, lowest and highest airframe", "within a session", "between sessions"):
        shown.add_column(heading)
    found: dict[str, list[tuple[float, float, float]]] = {}
    for one in healthy:
        for series in _series(one.records):
            found.setdefault(series.name, []).append(_spread(series))
    for name, figures in found.items():
        level, within, between = np.array(figures).T
        shares = (f"{one.mean():.3f}, highest {one.max():.3f}" for one in (within, between))
        shown.add_row(name, f"{level.min():.2f} to {level.max():.2f}", *shares)
    Console(width=130, highlight=False).print(shown)


def _spread(series: Series) -> tuple[float, float, float]:
    """Level, standard deviation within sessions and between them (analysis of variance)."""
    known = np.isfinite(series.share)
    share, session = series.share[known], series.session[known]
    groups = [share[session == number] for number in np.unique(session)]
    inside = sum(((one - one.mean()) ** 2).sum() for one in groups) / max(len(share) - len(groups), 1)
    means, sizes = np.array([one.mean() for one in groups]), np.array([len(one) for one in groups])
    between = max(float(means.var(ddof=1)) - inside * float(np.mean(1 / sizes)), 0.0)
    return float(share.mean()), math.sqrt(inside), math.sqrt(between)


def pool(workers: int) -> ProcessPoolExecutor:
    """Processes of low priority."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=os.nice, initargs=(10,))


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("drawn", "emulated"), default="drawn")
    parser.add_argument("--seed", type=int, default=9100)
    parser.add_argument("--airframes", type=int, default=200, help="drawn, wearing")
    parser.add_argument("--healthy", type=int, default=400, help="drawn, healthy")
    parser.add_argument("--wearing", type=int, default=20, help="emulated, wearing")
    parser.add_argument("--flown-healthy", type=int, default=10, help="emulated, healthy")
    parser.add_argument("--keep", default="/tmp/mavdiag-history", help="folder of flights that were flown already")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    start_s = time.monotonic()
    print(f"horizon {HORIZON:g}, progress {PROGRESS:g}, grown {GROWN:g}; {platform.machine()}, {os.cpu_count()} cores")
    (run_drawn if arguments.what == "drawn" else run_emulated)(arguments)
    print(f"{time.monotonic() - start_s:.0f} s")


if __name__ == "__main__":
    main()
