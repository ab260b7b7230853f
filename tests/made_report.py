"""Emulated flights of a QDrone 2 at 400 Hz, judged: what a report is drawn of. Flown once."""

from functools import cache

import numpy as np
from virtual_flight import healthy_flights, learnt

from mavdiag.baseline import Baseline
from mavdiag.judging import JudgedFlight, judge_in_full
from mavdiag.telemetry import Log
from sitl_plant.campaign.causes import injections_of

ROTOR, ONSET_S, FLIGHT_S, RATE_HZ = 1, 10.0, 20.0, 400.0


@cache
def emulated_baseline() -> Baseline:
    """Of three healthy flights."""
    return learnt(healthy_flights((1, 2, 3), FLIGHT_S, "qdrone2", RATE_HZ))


@cache
def cracked() -> tuple[Log, JudgedFlight]:
    """A flight in which propeller 1 cracks."""
    injections = injections_of("F2/SV2", ROTOR, ONSET_S, 1.0, np.random.default_rng(0))
    (log,) = healthy_flights((9,), FLIGHT_S, "qdrone2", RATE_HZ, injections=injections)
    return log, judge_in_full(log, emulated_baseline())
