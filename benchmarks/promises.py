"""Does the law of thresholds keep its promise for airframes as the prior believes them? By simulation, without a plant.

    python benchmarks/promises.py [--airframes 400] [--seed 34]

Of each airframe the three components of variance are drawn from the prior. It is taught by flights of six blocks of
10 s; the chance of an alarm in an hour follows by quadrature from what was drawn. Promised are 0.05 alarms an hour, a
chance of 0.0488, in a session of its own and in the highest of those that taught. `tail` is a prior that no monitor
has, with most of its variance within a flight. Printed: means over airframes, and their standard errors.
"""

import argparse
import math

import numpy as np

from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.heldout import BLOCK_S, Scores
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, DEGREES, GUMBEL_SCALE, Prior, law_of

BLOCKS = 6
PRIORS = {
    "innovation": Prior(0.15, 0.1, 0.08, shares=False),
    "rotor_trim": Prior(0.013, 0.004, 0.001, shares=False),
    "sensor_noise": Prior(0.35, 0.12, 0.1, shares=False),
    "tail": Prior(0.01, 0.01, 0.1, shares=False),
}
TAUGHT = ((1, 1), (3, 1), (5, 1), (10, 1), (30, 1), (3, 3), (10, 3))  # flights, sessions
Z, WEIGHTS = np.polynomial.hermite_e.hermegauss(61)


def alarms(prior: Prior, flights: int, sessions: int, rng: np.random.Generator) -> tuple[float, float]:
    """Chance of an alarm in an hour of one airframe, in another session and in the highest that taught."""
    session, flight, block = (
        sd * math.sqrt(DEGREES / rng.chisquare(DEGREES)) for sd in (prior.session, prior.flight, prior.block)
    )
    beta, of, numbers = GUMBEL_SCALE * block, np.arange(flights) % sessions, np.repeat(np.arange(flights), BLOCKS)
    offsets = rng.normal(0.0, session, sessions)
    levels = 1.0 + offsets[of] + rng.normal(0.0, flight, flights)
    x = levels[numbers] + rng.gumbel(-np.euler_gamma * beta, beta, len(numbers))
    law = law_of(Scores(x, np.full(len(x), BLOCK_S), numbers), tuple(of.tolist()), prior)
    new, same = (law.level(BUDGET_PER_HOUR, law.per_hour, here) for here in (False, True))

    def silent(above: FloatArray) -> FloatArray:
        """Chance of an hour without an alarm, for a threshold so far above the session."""
        u = (above[:, None] - flight * Z) / beta + np.euler_gamma - math.log(BLOCKS)
        return np.asarray((np.exp(-np.exp(np.minimum(-u, 700.0))) @ WEIGHTS / WEIGHTS.sum()) ** law.per_hour)

    other = 1.0 - float(WEIGHTS @ silent(new - 1.0 - session * Z) / WEIGHTS.sum())
    return other, 1.0 - float(silent(np.array([same - 1.0 - offsets.max()]))[0])


def main() -> None:
    """Print a line for each prior and way of teaching."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--airframes", type=int, default=400)
    parser.add_argument("--seed", type=int, default=34)
    arguments = parser.parse_args()
    for name, prior in PRIORS.items():
        for flights, sessions in TAUGHT:
            rng = np.random.default_rng([arguments.seed, flights, sessions])
            chances = np.array([alarms(prior, flights, sessions, rng) for _ in range(arguments.airframes)])
            means, errors = chances.mean(axis=0), chances.std(axis=0) / math.sqrt(len(chances))
            figures = [f"{m:.3f} +- {e:.3f}" for m, e in zip(means, errors, strict=True)]
            print(f"{name:12s} {flights:2d} flights in {sessions}: another session {figures[0]}, the same {figures[1]}")


if __name__ == "__main__":
    main()
