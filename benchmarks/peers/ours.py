"""This project's own detectors, as contenders."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from thesis_runs import exceedances

from mavdiag.airframe.load import airframe_named
from mavdiag.decision.alarm import Stage
from mavdiag.identify import ArxModel, fit
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S
from peers.contender import Learner, Scored, Scorer
from peers.flights import Flown

__all__ = ["product", "thesis_rule"]

CREATED = "2025-01-01T00:00:00Z"
OPTIONS = LearnOptions(airframe=airframe_named("qdrone2"))
AXES = (0, 1)  # roll and pitch
SETTLE_S = 2.0  # the free run begins in motion
TRAIN_FLIGHTS = 2  # more than a minute at 1 kHz is not needed for four parameters, as in `mavdiag.learning`
MARGIN_PERCENT = 90.0


def thesis_rule(_others: Sequence[Flown]) -> Learner:
    """The thesis's statistic (T 5.5): how long |r| has been above its healthy 90th percentile, roll or pitch [s].

    r is the free-run residual of a (2, 2, 1) model by SRIV. With the maximum rule its threshold is the FML.
    """
    return lambda healthy: _thesis(tuple(healthy))


def product(_others: Sequence[Flown]) -> Learner:
    """`mavdiag.learning.learn` and `mavdiag.judging.judge` as they stand, with their own thresholds and budget."""

    def learner(healthy: Sequence[Flown]) -> Scorer:
        baseline = learn([one.flight for one in healthy], OPTIONS, created=CREATED)

        def score(one: Flown) -> Scored:
            found = judge(one.flight, baseline)
            if found.verdict not in (Verdict.HEALTHY, Verdict.FAULT):
                raise RuntimeError(f"an emulated flight cannot be judged: {found.reason}")
            raised, rotor = np.zeros(len(one)), np.zeros(len(one), dtype=np.int64)
            for change in found.changes:  # each holds until the next
                since = one.t_s >= change.t_ns / NS_PER_S
                raised[since] = (change.stage is Stage.FAULT) * (1.0 + (change.confidence or 0.0))
                rotor[since] = change.rotor or 0
            return Scored(one.t_s, raised, rotor)

        return score

    return learner


@lru_cache(maxsize=4)  # one model for the thesis's statistic under either rule
def _thesis(healthy: tuple[Flown, ...]) -> Scorer:
    dt_s = healthy[0].dt_s
    chosen = healthy[:TRAIN_FLIGHTS]
    models = [fit([one.u[:, axis] for one in chosen], [one.y[:, axis] for one in chosen], dt=dt_s) for axis in AXES]
    residuals = np.abs(np.concatenate([_residuals(models, one) for one in healthy]))
    margins = np.percentile(residuals, MARGIN_PERCENT, axis=0, method="hazen").tolist()

    def score(one: Flown) -> Scored:
        r = _residuals(models, one)
        valid = np.ones(len(r), dtype=np.bool_)
        fsd_s = [exceedances(r[:, i], valid, m, dt_s)[0] for i, m in enumerate(margins)]
        return Scored.anonymous(one.t_s[-len(r) :] + one.delay_s, np.max(fsd_s, axis=0))

    return score


def _residuals(models: Sequence[ArxModel], one: Flown) -> FloatArray:
    """Free-run residuals of the settled rows, (n, 2) [rad/s]."""
    simulated = [model.simulate(one.u[:, axis]) for axis, model in zip(AXES, models, strict=True)]
    return one.y[round(SETTLE_S / one.dt_s) :, AXES] - np.column_stack(simulated)[round(SETTLE_S / one.dt_s) :]
