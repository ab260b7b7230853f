"""From several monitors to one verdict on the vehicle: quiet, suspected, declared.

A monitor's ratio is its statistic over its threshold, which was set for its own share of the alarm budget; so any one
of them may declare a fault, and the shares add up to the budget. Everything softer is a table:

    calm  < 0.7 <=  held  < 0.8 <=  raised  <= 1 <  over        the highest ratio of all monitors

A fault stays declared until all ratios have been calm for 2 s. What the rotors are told apart by is in
`mavdiag.decision.isolation`: the name may come with the declaration, later, or never.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, StrEnum

import numpy as np

from mavdiag.decision.events import Reading
from mavdiag.decision.isolation import Isolation, Witness, isolate
from mavdiag.errors import UsageError
from mavdiag.telemetry import NS_PER_S, IntArray

__all__ = ["NEXT", "Change", "Channel", "Finding", "FusionSpec", "FusionState", "Height", "Stage", "start", "step"]

CALM_BELOW, RAISED_FROM = 0.7, 0.8  # of the threshold (our choice); one emulated flight in 62 healthy h was suspected
CLEAR_S = 2.0  # our choice
LOOK_NS = NS_PER_S // 10  # unchanged readings are looked at that often
STALE_NS = NS_PER_S  # a monitor that has been silent for longer has no say
REASON_BYTES = 50  # STATUSTEXT


class Stage(StrEnum):
    """Where the vehicle stands."""

    QUIET = "quiet"
    SUSPECTED = "suspected"
    DECLARED = "declared"


class Height(Enum):
    """How high the highest ratio is. SETTLED: it has been calm for `CLEAR_S`."""

    SETTLED = 0
    CALM = 1
    HELD = 2
    RAISED = 3
    OVER = 4


class Change(Enum):
    """What a finding tells, as a sentence."""

    SUSPECTED = "a monitor comes near its threshold"
    DECLARED = "a monitor is above its threshold"
    LOCATED = "the rotor is named"
    CLEARED = "all monitors have been calm again"


NEXT: dict[tuple[Stage, Height], tuple[Stage, Change]] = {
    (Stage.QUIET, Height.RAISED): (Stage.SUSPECTED, Change.SUSPECTED),
    (Stage.QUIET, Height.OVER): (Stage.DECLARED, Change.DECLARED),
    (Stage.SUSPECTED, Height.OVER): (Stage.DECLARED, Change.DECLARED),
    (Stage.SUSPECTED, Height.SETTLED): (Stage.QUIET, Change.CLEARED),
    (Stage.DECLARED, Height.SETTLED): (Stage.QUIET, Change.CLEARED),
}
"""Every other pair leaves the stage as it is."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A monitor's place in the verdict. delay_s: how much later than its time stamp a reading is known."""

    monitor: str
    unit: str
    threshold: float
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.threshold > 0 or self.delay_s < 0:
            raise UsageError(f"{self.monitor}: the threshold must be positive and the delay not negative")


@dataclass(frozen=True, slots=True)
class FusionSpec:
    """The channels, in the order in which their readings are given."""

    channels: tuple[Channel, ...]
    clear_s: float = CLEAR_S


@dataclass(frozen=True, slots=True)
class Finding:
    """Something changed. t_ns: vehicle time at which it was known. monitor, statistic, threshold: of the highest ratio.

    rotor: None while unknown; confidence: of the likeliest rotor, 0..1.
    """

    change: Change
    t_ns: int
    monitor: str
    unit: str
    statistic: float
    threshold: float
    rotor: int | None
    confidence: float

    @property
    def reason(self) -> str:
        """Why, in at most 50 bytes.

        >>> Finding(Change.DECLARED, 0, "vibration", "g mm", 2.14, 0.5, 1, 0.99).reason
        'vibration 2.1 g mm > 0.5; rotor 1'
        """
        sign = ">" if self.statistic > self.threshold else "<="
        rotor = "?" if self.rotor is None else str(self.rotor)
        figures = f"{self.monitor} {self.statistic:.2g} {self.unit} {sign} {self.threshold:.2g}; rotor {rotor}"
        return figures.encode("ascii", "replace")[:REASON_BYTES].decode("ascii")


@dataclass(frozen=True, slots=True)
class _Word:
    """A channel's latest valid reading that was looked at, and when it was known."""

    t_ns: int
    statistic: float
    witness: Witness


@dataclass(frozen=True, slots=True)
class FusionState:
    """Stage, since when all is calm (None: it is not), the rotor told last, and each channel's word and class."""

    stage: Stage = Stage.QUIET
    calm_ns: int | None = None
    rotor: int | None = None
    words: tuple[_Word | None, ...] = ()
    seen: tuple[tuple[int, int], ...] = ()  # per channel: class and look number of its last row


def start(spec: FusionSpec) -> FusionState:
    """Nothing seen yet."""
    n = len(spec.channels)
    return FusionState(words=(None,) * n, seen=((-1, -1),) * n)


def step(spec: FusionSpec, state: FusionState, readings: Sequence[Reading]) -> tuple[FusionState, tuple[Finding, ...]]:
    """Take the next readings, one a channel (with no rows where nothing is new); return what changed, in order of time.

    Any chunking gives the same findings, as long as each channel's readings come when they are known.
    Raises UsageError if there is not one reading a channel.
    """
    if len(readings) != len(spec.channels):
        raise UsageError(f"{len(readings)} readings for {len(spec.channels)} channels")
    looks: list[tuple[int, int, int]] = []
    seen = list(state.seen)
    for i, (channel, reading) in enumerate(zip(spec.channels, readings, strict=True)):
        if len(reading.t_ns):
            known_ns = reading.t_ns + round(channel.delay_s * NS_PER_S)
            rows, seen[i] = _worth_a_look(channel, reading, known_ns, state.seen[i])
            looks += [(int(known_ns[row]), i, row) for row in rows]
    state = replace(state, seen=tuple(seen))
    found: list[Finding] = []
    for t_ns, i, row in sorted(looks):
        state = _hear(spec, state, i, t_ns, readings[i], row)
        state, more = _judge(spec, state, t_ns)
        found += more
    return state, tuple(found)


def _worth_a_look(
    channel: Channel, reading: Reading, known_ns: IntArray, last: tuple[int, int]
) -> tuple[list[int], tuple[int, int]]:
    """Rows at which the class of the ratio changes, and one every 100 ms in between; the class and look of the last."""
    ratio = np.where(reading.valid, reading.statistic, 0.0) / channel.threshold
    edges = np.array([CALM_BELOW, RAISED_FROM, np.nextafter(1.0, 2.0)])
    classes = np.where(reading.valid, np.searchsorted(edges, ratio, side="right"), -1)
    looks = known_ns // LOOK_NS
    new = (np.diff(classes, prepend=last[0]) != 0) | (np.diff(looks, prepend=last[1]) != 0)
    return np.flatnonzero(new).tolist(), (int(classes[-1]), int(looks[-1]))


def _hear(spec: FusionSpec, state: FusionState, i: int, t_ns: int, reading: Reading, row: int) -> FusionState:
    """The state with channel i's word replaced; an invalid reading takes the word back."""
    word: _Word | None = None
    if reading.valid[row]:
        channel, statistic = spec.channels[i], float(reading.statistic[row])
        rotors = tuple(reading.rotors[row].tolist()) if len(reading.rotors) else ()
        word = _Word(
            t_ns, statistic, Witness(channel.monitor, statistic / channel.threshold, channel.threshold, rotors)
        )
    return replace(state, words=(*state.words[:i], word, *state.words[i + 1 :]))


def _judge(spec: FusionSpec, state: FusionState, t_ns: int) -> tuple[FusionState, list[Finding]]:
    """Look the transition up, and see whether the rotor can be named."""
    fresh = [
        (word, channel)
        for word, channel in zip(state.words, spec.channels, strict=True)
        if word is not None and t_ns - word.t_ns <= STALE_NS
    ]
    if not fresh:
        return replace(state, calm_ns=None), []
    word, channel = max(fresh, key=lambda pair: pair[0].witness.ratio)
    height = _height(word.witness.ratio)
    calm_ns = None if height is not Height.CALM else t_ns if state.calm_ns is None else state.calm_ns
    if calm_ns is not None and t_ns - calm_ns >= spec.clear_s * NS_PER_S:
        height = Height.SETTLED
    state = replace(state, calm_ns=calm_ns)
    stage, change = NEXT.get((state.stage, height), (state.stage, None))
    if stage is Stage.QUIET and change is None:
        return state, []
    place = isolate([one.witness for one, _ in fresh])
    if change is None:
        change = _located(state, place)
    if change is None:
        return state, []
    rotor = _rotor(state, change, place)
    finding = Finding(
        change, t_ns, channel.monitor, channel.unit, word.statistic, channel.threshold, rotor, place.confidence
    )
    kept = rotor if stage is Stage.DECLARED else None
    return replace(state, stage=stage, rotor=kept), [finding]


def _located(state: FusionState, place: Isolation) -> Change | None:
    """A declared fault whose rotor was unknown, or another one, is named now."""
    named = state.stage is Stage.DECLARED and place.rotor is not None and place.rotor != state.rotor
    return Change.LOCATED if named else None


def _rotor(state: FusionState, change: Change, place: Isolation) -> int | None:
    return state.rotor if change is Change.CLEARED else place.rotor


def _height(ratio: float) -> Height:
    if ratio > 1.0:
        return Height.OVER
    if ratio >= RAISED_FROM:
        return Height.RAISED
    return Height.HELD if ratio >= CALM_BELOW else Height.CALM
