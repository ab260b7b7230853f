"""The session's life as a table, state x trigger -> state. Nothing else changes a session's state."""

from collections.abc import Mapping
from enum import StrEnum


class State(StrEnum):
    """Where a session stands. The value is its name in texts, journal and metrics."""

    WAITING = "waiting"  # for the streams that are needed, at a rate that will do
    LEARNING = "learning"  # collecting healthy flight
    FITTING = "fitting"  # making the baseline from it
    MONITORING = "monitoring"  # judging; what is found stands in the diagnosis
    LOST = "lost"  # nothing comes from the vehicle
    FAULTED = "faulted"  # cannot do its work: no heartbeat in this state


class Trigger(StrEnum):
    """What moves a session."""

    READY_TO_LEARN = "streams are there, no baseline yet"
    READY_TO_JUDGE = "streams are there, the baseline fits"
    REFUSED = "the baseline is of another profile, schema or vehicle"
    STREAMS_LOST = "a stream stopped or changed its rate"
    COLLECTED = "enough healthy flight"
    FITTED = "a baseline was made"
    NOT_FITTED = "more flight is needed"
    GIVEN_UP = "no baseline can be made"
    LINK_LOST = "nothing comes"
    LINK_BACK = "something comes"
    REBOOT = "the vehicle started anew"
    BROKEN = "an error of the program"


_ON_A_LINK = {Trigger.LINK_LOST: State.LOST, Trigger.REBOOT: State.WAITING, Trigger.BROKEN: State.FAULTED}

TABLE: Mapping[State, Mapping[Trigger, State]] = {
    State.WAITING: {
        Trigger.READY_TO_LEARN: State.LEARNING,
        Trigger.READY_TO_JUDGE: State.MONITORING,
        Trigger.REFUSED: State.FAULTED,
        **_ON_A_LINK,
    },
    State.LEARNING: {Trigger.COLLECTED: State.FITTING, Trigger.STREAMS_LOST: State.WAITING, **_ON_A_LINK},
    # The fit ends within its time limit, one way or the other; what the link does meanwhile is seen to afterwards.
    State.FITTING: {
        Trigger.FITTED: State.WAITING,
        Trigger.NOT_FITTED: State.LEARNING,
        Trigger.GIVEN_UP: State.FAULTED,
        Trigger.BROKEN: State.FAULTED,
    },
    State.MONITORING: {Trigger.STREAMS_LOST: State.WAITING, Trigger.REFUSED: State.FAULTED, **_ON_A_LINK},
    State.LOST: {Trigger.LINK_BACK: State.WAITING, Trigger.BROKEN: State.FAULTED},
    # Another flight may do what this one could not; a vehicle that was swapped starts anew as well.
    State.FAULTED: {Trigger.REBOOT: State.WAITING},
}
