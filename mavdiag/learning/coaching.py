"""What a pilot is told to fly next, by what the flown rows cover so far.

Each second of flight counts as turning, if the nose turned as fast as the envelope calls covered, and as moving, if
roll or pitch were commanded to turn so fast; with neither it is hovering. The tasks are asked for in rounds, a share
of each in turn: flights, and parts of one, that are each of one kind would look like different vehicles to the guards.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from mavdiag.monitors.conditions import measure
from mavdiag.rows.conditions import BIN_S, Condition
from mavdiag.rows.front import Rows
from mavdiag.thresholds.envelope import ORDER, RULES
from mavdiag.units import NS_PER_S

ROUNDS = 3  # in which the tasks are asked for (our choice: several of each, so that no part of a flight is odd)


class Task(Enum):
    """What to fly: title, words for the pilot, seconds in all rounds (our choices: grade A in the emulator)."""

    HOVER = "hover", "hold it still, hands off", 90
    MOVE = "square", "fly a square of a few metres, as briskly as it will be flown", 60
    TURN = "nose", "turn the nose left and right by a right angle, again and again", 30

    def __init__(self, title: str, words: str, wanted_s: int) -> None:
        self.title, self.words, self.wanted_s = title, words, wanted_s


@dataclass(frozen=True, slots=True)
class Step:
    """The task to fly now. round: from 1. left_s: how much of it is missing in this round."""

    task: Task
    round: int
    left_s: int


class Coverage:
    """What healthy flights cover so far. flown_s: seconds of each task."""

    def __init__(self) -> None:
        self.flown_s = dict.fromkeys(Task, 0)

    def take(self, rows: Iterable[Rows]) -> bool:
        """Take in rows that follow each other, some seconds of them at a time; return whether that covers more."""
        parts = [part for part in measure(tuple(rows)) if len(part.end_ns)]
        if not parts:
            return False
        end_ns, values = (np.concatenate([getattr(part, name) for part in parts]) for name in ("end_ns", "values"))
        starts = np.unique((end_ns - 1) // NS_PER_S, return_index=True)[1]
        most = np.fmax.reduceat(values, starts, axis=0)
        both = Condition.YAW_RATE, Condition.COMMANDED_RATE
        turns, moves = (most[:, ORDER.index(one)] > RULES[one].least for one in both)
        # of a second that two looks share, one has the most
        known = np.diff(starts, append=len(end_ns)) * BIN_S > 0.5
        counts = [int(np.count_nonzero(known & one)) for one in (~turns & ~moves, moves, turns)]
        for task, count in zip(Task, counts, strict=True):
            self.flown_s[task] += count
        return any(counts)

    @property
    def step(self) -> Step | None:
        """What to fly next; None if all is covered."""
        for number in range(1, ROUNDS + 1):
            for task in Task:
                left_s = -(-task.wanted_s * number // ROUNDS) - self.flown_s[task]
                if left_s > 0:
                    return Step(task, number, left_s)
        return None

    def __str__(self) -> str:
        return ", ".join(f"{task.title} {self.flown_s[task]} of {task.wanted_s} s" for task in Task)
