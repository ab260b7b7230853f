"""Evidence over flights: recorded flights of a cut propeller together, and drawn healthy airframes.

    python benchmarks/evidence.py recorded FOLDER      (of the CrazyPAD data)
    python benchmarks/evidence.py drawn --seed 5100 [--airframes 200] [--factor 1]

recorded: every choice of five, four, three and two of the healthy flights of E8 teaches. The three flights of each
folder are judged together, and so are all sets of up to three of the healthy flights that are left out. Their logs have
no clock.

drawn: airframes after the law of `mavdiag.thresholds.evidence`, whose standard deviations are drawn from the prior, and
taken --factor times. Each is taught by 3, 5, 10 and 30 flights in one or three sessions, and flies --flights more in
sessions of five. Its evidence is looked at after each flight until the twelfth and after each session then. Ville's
inequality allows a change to be told in one of 50. The same airframes with a rotor whose command rises by 0.05, 0.1 and
0.2 of hover from the first new flight on show what is found, and when.
"""

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from recorded_flights import BINS, CUT_ROTOR, STAMP, total_cut_mm
from scipy.stats import beta

from mavdiag.archive.figures import FlightRecord, record_of
from mavdiag.archive.together import Together, priors_of, reference_of, together
from mavdiag.judging import judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import read_log
from mavdiag.telemetry import Log
from mavdiag.thresholds.evidence import SURE, Flown, evidence_of
from mavdiag.thresholds.rule import DEGREES

SIGNS = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, -1.0, 1.0], [1.0, -1.0, 1.0, -1.0]]) / 4
FLIGHT_S, SESSION = 60.0, 5


def recorded(folder: Path) -> None:
    """Print the table of E8."""
    logs: dict[str, list[Log]] = {}
    for path in sorted(folder.glob("*/E8_log*")):
        logs.setdefault(path.parent.name, []).append(read_log(path))
    healthy = logs.pop("normal_flight")
    print("CrazyPAD E8, three flights together, told above 50 to 1; every choice of teaching flights")
    for flights in (5, 4, 3, 2):
        found = list[tuple[str, Together]]()
        worst = list[float]()
        for teaching in itertools.combinations(range(len(healthy)), flights):
            base = learn([healthy[i] for i in teaching], LearnOptions(monitors=("rotor_trim",)), created=STAMP)
            reference = reference_of(base)

            def flown(some: Sequence[Log], base=base) -> list[FlightRecord]:  # type: ignore[no-untyped-def]
                return [record_of(log, judge_in_full(log, base), base) for log in some]

            found += [(name, together(reference, flown(three))) for name, three in logs.items()]
            left = flown([log for i, log in enumerate(healthy) if i not in teaching])
            for count in range(1, min(len(left), 3) + 1):
                said = (together(reference, some) for some in itertools.combinations(left, count))
                worst += [one.evidence.odds for one in said if one.evidence is not None]
        cells = []
        for low, high in BINS:
            cut = [one for name, one in found if low < (total_cut_mm(name) or 0.0) <= high]
            told = [one for one in cut if one.changed]
            right = sum(CUT_ROTOR in one.rotors for one in told)
            cells.append(f"<={high:g} mm {len(told)}/{len(cut)} (M3 among the named {right})")
        others = [one for name, one in found if total_cut_mm(name) is None]
        cells.append(f"tape and weights {sum(one.changed for one in others)}/{len(others)}")
        most = f"{max(worst):.2g} to 1 at most" if worst else "none"
        print(f"taught by {flights}: {', '.join(cells)}; healthy left out {len(worst)} sets, {most}")


def drawn(seed: int, airframes: int, flights: int, factor: float) -> None:
    """Print how often a healthy airframe is told of, and how soon a damaged one."""
    rng = np.random.default_rng(seed)
    print(f"seed {seed}, {airframes} airframes a line, {flights} flights each, deviations {factor:g} x the prior's")
    for taught, sessions in itertools.product((3, 5, 10, 30), (1, 3)):
        told = list[int]()
        for _ in range(airframes):
            told.append(_first(_airframe(rng, taught, sessions, flights, factor), 0.0))
        share, upper = _share(sum(one > 0 for one in told), airframes)
        cells = []
        for rise in (0.05, 0.1, 0.2):
            some = [_first(_airframe(rng, taught, sessions, flights, factor), rise) for _ in range(airframes // 4)]
            after = [sum(0 < one <= count for one in some) / len(some) for count in (3, 5, flights)]
            cells.append(f"rise {rise:g} found after 3, 5, {flights}: " + ", ".join(f"{100 * x:.0f} %" for x in after))
        rate = f"{100 * share:.1f} % (95 % bound {100 * upper:.1f} %)"
        print(f"taught by {taught} in {sessions} sessions: healthy told {rate}; {'; '.join(cells)}", flush=True)


def _airframe(rng: np.random.Generator, taught: int, sessions: int, flights: int, factor: float) -> Flown:
    """A healthy airframe's flights."""
    whose = np.concatenate((np.arange(taught) * sessions // taught, sessions + np.arange(flights) // SESSION))
    trims = []
    for prior in priors_of(SIGNS):
        session, flight = (
            factor * sd * np.sqrt(DEGREES / rng.chisquare(DEGREES)) for sd in (prior.session, prior.flight)
        )
        trims.append(rng.normal(0.0, session, whose.max() + 1)[whose] + rng.normal(0.0, flight, len(whose)))
    return Flown(np.array(trims).T, whose, np.zeros_like(whose), np.full(len(whose), FLIGHT_S), taught)


def _first(flights: Flown, rise: float) -> int:
    """After how many new flights a change is told, at the looks; 0 for never. rise: of rotor 3 in all of them."""
    trims = flights.trims + rise * SIGNS[:, 2] * (np.arange(len(flights.trims)) >= flights.learnt)[:, None]
    for new in (k for k in range(1, len(trims) - flights.learnt + 1) if k <= 12 or k % SESSION == 0):
        n = flights.learnt + new
        part = Flown(trims[:n], flights.sessions[:n], flights.propellers[:n], flights.spans_s[:n], flights.learnt)
        if evidence_of(part, SIGNS, priors_of(SIGNS)).odds >= SURE:
            return new
    return 0


def _share(count: int, of: int) -> tuple[float, float]:
    """The share, and its upper limit at 95 % (Clopper and Pearson)."""
    return count / of, float(beta.ppf(0.95, count + 1, of - count)) if count < of else 1.0


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    kinds.add_parser("recorded").add_argument("folder", type=Path)
    made = kinds.add_parser("drawn")
    made.add_argument("--seed", type=int, required=True)
    made.add_argument("--airframes", type=int, default=200)
    made.add_argument("--flights", type=int, default=40)
    made.add_argument("--factor", type=float, default=1.0)
    arguments = parser.parse_args()
    if arguments.kind == "recorded":
        recorded(arguments.folder)
    else:
        drawn(arguments.seed, arguments.airframes, arguments.flights, arguments.factor)


if __name__ == "__main__":
    main()
