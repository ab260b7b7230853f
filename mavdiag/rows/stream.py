"""The samples of one signal that may still be needed: brought into order, and read at the times of rows."""

import math
from dataclasses import dataclass, field

import numpy as np

from mavdiag.telemetry import FloatArray, IntArray

__all__ = ["NEVER_NS", "Stream"]

NEVER_NS = 2**62
TURN = 2 * math.pi
MISSING = 1.5  # usual steps: in a longer one a sample is missing
MANY, FEW = 1000, 4  # rows, and rows to a sample, from which on samples are looked up in the rows instead
SLOWER = 1.0625  # by how much the usual step may grow with each chunk, so that losses do not stretch it (our choice)


def _no_turns() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Samples of one signal in order of time.

    t: (n,) vehicle time [ns], strictly rising.
    v: (n, k) values as they came.
    newest: latest time seen [ns].
    floor_ns: earlier samples and this one are settled; a sample that comes for them is dropped.
    angle: the values are angles; they are read without jumps of 2 pi.
    turns: (3,) full turns that belong to the first sample of an angle.
    step_ns: usual step [ns], 0 while it is not known.
    """

    t: IntArray
    v: FloatArray
    newest: int = -NEVER_NS
    floor_ns: int = -NEVER_NS
    angle: bool = False
    turns: FloatArray = field(default_factory=_no_turns)
    step_ns: float = 0.0

    def merged(self, t: IntArray, v: FloatArray, reorder_ns: int) -> "Stream":
        """With new samples, (m,) and (m, k). One that is later than `reorder_ns`, or comes twice, is dropped."""
        if len(t) == 0:
            return self
        if t[0] > self.newest and _rising(t):  # the usual case: all new and in order
            if len(self.t):
                before = len(self.t)
                t, v = np.concatenate((self.t, t)), np.concatenate((self.v, v))
                step_ns = self._usual(t[before:] - t[before - 1 : -1])
            else:
                step_ns = self._usual(t[1:] - t[:-1])
            return Stream(t, v, int(t[-1]), self.floor_ns, self.angle, self.turns, step_ns)
        newest = np.maximum.accumulate(np.maximum(t, self.newest))
        on_time = (t >= newest - reorder_ns) & (t > self.floor_ns)
        t, v = t[on_time], v[on_time]
        if len(self.t):
            t, v = np.concatenate((self.t, t)), np.concatenate((self.v, v))
        if not _rising(t):
            order = np.argsort(t, kind="stable")
            t, v = t[order], v[order]
            keep = np.append(np.diff(t) > 0, True)  # of equal times the last to arrive counts
            t, v = t[keep], v[keep]
        return Stream(t, v, int(newest[-1]), self.floor_ns, self.angle, self.turns, self.step_ns)

    def since(self, before_ns: int) -> "Stream":
        """Without the samples older than `before_ns`, but with the one that a row at `before_ns` needs on its left."""
        first = int(self.t.searchsorted(before_ns, side="right")) - 1
        if first <= 0:
            return self
        turns = self.turns
        if self.angle:
            steps = self.v[1 : first + 1] - self.v[:first]
            if _jumps(steps):
                turns = turns - np.round(steps / TURN).sum(axis=0)
        t = self.t[first:]
        return Stream(t, self.v[first:], self.newest, int(t[0]), self.angle, turns, self.step_ns)

    def whole_ns(self, since_ns: int, most_ns: float = math.inf) -> int:
        """Up to where no sample is missing among those after `since_ns`; that time itself if that is not known.

        A sample is missing in a step above 1.5 of the usual one, or of `most_ns` if that is shorter.
        """
        usual_ns = min(self.step_ns, most_ns)
        first = int(self.t.searchsorted(since_ns, side="right"))
        if usual_ns == 0 or first == len(self.t):
            return since_ns
        last = max(first - 1, 0)
        missing = self.t[last + 1 :] - self.t[last:-1] > MISSING * usual_ns
        return int(self.t[last + int(missing.argmax())] if missing.any() else self.t[-1])

    def _usual(self, steps: IntArray) -> float:
        """The usual step after these new ones [ns]: their middle one, but hardly longer than before."""
        if len(steps) == 0:
            return self.step_ns
        middle = float(np.sort(steps)[(len(steps) - 1) // 2])
        return min(middle, SLOWER * self.step_ns) if self.step_ns else middle

    def interpolated(self, rows: IntArray, limit_ns: int) -> tuple[FloatArray, IntArray]:
        """Values (n, k) at the times of rows, and the time between the two samples around each row (n,) [ns].

        Linear between two samples within the limit, else the last sample; nan before the first. The time is 0 at a
        sample, and NEVER_NS where there is no sample on one side.
        """
        t, v = self.t, self._unwrapped() if self.angle else self.v
        first = int(t.searchsorted(rows[0], side="left"))
        if len(t) >= first + len(rows) and np.count_nonzero(t[first : first + len(rows)] == rows) == len(rows):
            return v[first : first + len(rows)], np.zeros(len(rows), dtype=np.int64)
        left = _behind(t, rows)
        inside = left[0] >= 0 and left[-1] < len(t) - 1
        right = left + 1 if inside else np.minimum(left + 1, len(t) - 1)
        before = t[left]
        span, since = t[right] - before, rows - before
        if not inside:
            span[(left < 0) | (right == left)] = NEVER_NS
        gap: IntArray = span * (since != 0)
        share = since / span
        share[gap > limit_ns] = 0.0
        columns = v.T  # so that the loops run over the rows
        first_v = columns.take(left, axis=1)
        values: FloatArray = (first_v + share * (columns.take(right, axis=1) - first_v)).T
        if left[0] < 0:
            values[left < 0] = np.nan
        return values, gap

    def held(self, rows: IntArray, limit_ns: int) -> FloatArray:
        """The last value at or before each row, (n, k); nan before the first, and where it is older than the limit."""
        t, v = self.t, self.v
        if t[0] <= rows[0] and rows[-1] - t[0] <= limit_ns and (len(t) == 1 or t[1] > rows[-1]):  # one for all rows
            return v[:1].T.repeat(len(rows), axis=1).T
        first, last = int(t.searchsorted(rows[0], side="right")), int(t.searchsorted(rows[-1], side="right"))
        if len(rows) >= MANY and first > 0 and last - first <= len(rows) // FEW:  # few samples come within the rows
            starts = rows.searchsorted(t[first:last])  # where they take over
            values = v[first - 1 : last].T.repeat(np.diff(starts, prepend=0, append=len(rows)), axis=1).T
            if np.maximum.reduce(np.diff(t[first - 1 : last], append=rows[-1])) <= limit_ns:
                return values
            at = np.repeat(np.arange(first - 1, last), np.diff(starts, prepend=0, append=len(rows)))
        else:
            at = t.searchsorted(rows, side="right") - 1
            values = v.T.take(np.maximum(at, 0), axis=1).T
            if at[0] >= 0 and rows[-1] - t[at[0]] <= limit_ns:  # no sample is older than that
                return values
        values[(at < 0) | (rows - t[at] > limit_ns)] = np.nan
        return values

    def unwrapped(self) -> "Stream":
        """The same samples; angles once and for all without jumps of 2 pi."""
        return Stream(self.t, self._unwrapped(), self.newest, self.floor_ns) if self.angle else self

    def _unwrapped(self) -> FloatArray:
        """The angles without jumps. Whole turns are added to what came, so that any cut gives the same bits."""
        steps = self.v[1:] - self.v[:-1]
        if not (np.count_nonzero(self.turns) or _jumps(steps)):
            return self.v
        turns = np.cumsum(np.concatenate((self.turns[None], -np.round(steps / TURN))), axis=0)
        return self.v + TURN * turns


def _behind(t: IntArray, rows: IntArray) -> IntArray:
    """The last sample at or before each row, (n,), -1 where there is none. Both rise."""
    if len(rows) < MANY:
        return t.searchsorted(rows, side="right") - 1
    first, last = int(t.searchsorted(rows[0], side="right")), int(t.searchsorted(rows[-1], side="right"))
    if last - first > len(rows) // FEW:
        return t.searchsorted(rows, side="right") - 1
    starts = rows.searchsorted(t[first:last])  # where the few samples within the rows take over
    return np.repeat(np.arange(first - 1, last), np.diff(starts, prepend=0, append=len(rows)))


def _rising(t: IntArray) -> bool:
    return bool(np.count_nonzero(t[1:] > t[:-1]) == len(t) - 1)


def _jumps(steps: FloatArray) -> bool:
    """Whether some step of the angles may be one over a full turn."""
    return len(steps) > 0 and not np.maximum.reduce(np.abs(steps), axis=None) <= math.pi
