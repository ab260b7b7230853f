"""The plant under an autopilot outside: at rest on the ground until the autopilot turns its rotors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.faults import Injection
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.plant import Change, Plant, PlantConfig, PlantSamples

FLYING_M = 0.1  # height above the start at which a take-off counts (our choice)
Watch = Callable[[PlantSamples, Sequence[Change]], None]


@dataclass(frozen=True, slots=True)
class HilPlan:
    """What is to happen."""

    config: PlantConfig  # vehicle, wind, payload, seed; it is flown from the ground, and its path is not used
    after_takeoff: tuple[Injection, ...] = ()  # causes whose onset counts from the take-off


class Simulation:
    """One plant, driven for spans of any length; what is left of a step is carried over.

    watch: is shown the samples of every span, and what was changed before it.
    """

    def __init__(self, plan: HilPlan, watch: Watch = lambda samples, changes: None) -> None:
        self._plan = plan
        self._watch = watch
        self.config = replace(plan.config, start="ground", trajectory="hover", landed_s=None)
        self.restart()

    def restart(self) -> None:
        """A new flight, at rest on the ground, with the same seed."""
        self.plant = Plant(self.config)
        self.rotors = self.plant.rotors
        self.takeoff_s: float | None = None
        self._left = 0.0
        self._last = self.plant.drive(np.zeros(self.rotors), 1)  # the sensors are read once, with motors off
        self._show(self._last)

    @property
    def now(self) -> PlantSamples:
        """The latest row, in samples of length 1."""
        return self._last

    @property
    def t_s(self) -> float:
        """Flight time so far: of the row after the latest."""
        return self.plant.t_ns * 1e-9

    def step(self, duties: FloatArray, span_s: float) -> PlantSamples:
        """Fly for `span_s` with these duties (n,) and return the latest row, the old one if no whole step was due."""
        due = self._left + span_s / STEP_S
        steps = math.floor(due + 1e-6)
        self._left = due - steps
        if steps > 0:
            samples = self.plant.drive(duties, steps)
            self._last = samples if steps == 1 else samples.rows(steps - 1, steps)
            self._show(samples)
            self._note_takeoff()
        return self._last

    def _show(self, samples: PlantSamples) -> None:
        self._watch(samples, self.plant.take_changes())

    def _note_takeoff(self) -> None:
        if self.takeoff_s is None and self._last.position[0, 2] < -FLYING_M:
            self.takeoff_s = self.t_s
            for one in self._plan.after_takeoff:
                self.plant.inject(replace(one, onset_s=one.onset_s + self.t_s, end_s=one.end_s + self.t_s))
