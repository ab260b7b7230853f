"""What `import mavdiag as md` offers beside its values: short ways for a notebook (edge: files and the clock)."""

import datetime
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeAlias

from mavdiag import judging, learning
from mavdiag import logs as log_files
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_from, with_layout
from mavdiag.archive.paths import logs_named
from mavdiag.archive.scan import Options, Question
from mavdiag.archive.scan import scan as archive
from mavdiag.baseline import Baseline, check_link
from mavdiag.chain import ChainOutput, chain_of
from mavdiag.decision.diagnosis import Change, Diagnosis, Event
from mavdiag.errors import BaselineError, InputError, UsageError
from mavdiag.judging import LogVerdict
from mavdiag.learning import LearnOptions
from mavdiag.learning.flights import front_for, rows_of
from mavdiag.monitors.run_length import MIN_PIECE_S, training_pieces
from mavdiag.printable import printable
from mavdiag.telemetry import Axis, FloatArray, Log, Telemetry, axis_named

Source: TypeAlias = Log | str | Path  # a log, or where it is


class FlightRates(NamedTuple):
    """Commanded (u) and measured (y) rate of one axis, an array for each stretch without a break [rad/s]."""

    u: list[FloatArray]
    y: list[FloatArray]
    dt_s: float


def read_log(path: str | Path, *, vehicle: int | None = None, profile: str | None = None) -> Log:
    """A flight from a .tlog, DataFlash .bin, .ulg, Crazyflie or DronePropA log; its kind is found from its content.

    vehicle: MAVLink system id, where a file holds several. profile: link profile of a .tlog that does not show it.
    Raises InputError, in one line, if it cannot be read.
    """
    return log_files.read_log(_path(path), vehicle, profile)


def learn(
    flights: Source | Iterable[Source],
    airframe: Airframe | str | Path | None = None,
    *,
    name: str | None = None,
    options: LearnOptions | None = None,
    vehicle: int | None = None,
    created: str | None = None,
    robust: bool = False,
) -> Baseline:
    """A baseline from healthy flights: logs, or files, folders and patterns like "healthy/*.tlog".

    airframe: a value, the name of one that is shipped, or a TOML file; None for what the flights themselves show.
    created: time stamp to record, ISO 8601 UTC. robust: leave out falls, copies and the like instead of refusing them.
    Raises InputError, IdentificationError or UsageError, in one line that says what to do.
    """
    chosen = with_airframe(options or LearnOptions(), airframe, name)
    chosen = replace(chosen, robust=chosen.robust or robust)
    found = (log for source in _each(flights) for log in _logs(source, vehicle))
    return learning.learn(found, chosen, created=now() if created is None else created)


def judge(
    flight: Source,
    baseline: Baseline | str | Path,
    *,
    vehicle: int | None = None,
    judged_share: float = judging.JUDGED_SHARE,
) -> LogVerdict:
    """The verdict on one flight: a log or its path, by a baseline or its file.

    judged_share: of the flown time that must be judged before a flight is called healthy, 0..1.
    Raises InputError or BaselineError if a file cannot be read; a log that cannot be judged is a verdict, with reason.
    """
    log = flight if isinstance(flight, Log) else log_files.read_part(_path(flight), vehicle)
    return judging.judge(log, _loaded(baseline), judged_share)


def scan(
    flights: str | Path | Iterable[str | Path],
    baseline: Baseline | str | Path,
    *,
    vehicle: int | None = None,
    jobs: int = 1,
    judged_share: float = judging.JUDGED_SHARE,
) -> Iterator[LogVerdict]:
    """The verdicts on many logs (files, folders, patterns), in their order, each as soon as it is there.

    jobs: worker processes, from 1 on. With more, a script must do its work under `if __name__ == "__main__":`.
    A log that cannot be read is a verdict `error`, and loses nothing. Raises BaselineError for the baseline.
    """
    if jobs < 1:
        raise UsageError(f"jobs must be 1 or more, not {jobs}")
    named = logs_named(map(_path, _each(flights))).logs
    question = Question.of(_loaded(baseline), Options(vehicle, judged_share=judged_share))
    return (answer.verdict for answer in archive(named, question, jobs))


def rates(flight: Source, axis: Axis | str, window_s: float = 0.1) -> FlightRates:
    """Commanded and measured body rate of one axis, while flying, on one grid: what `md.identify` takes.

    window_s: Savitzky-Golay window of both [s]. There is one array for each unbroken stretch of two seconds or more.
    Raises InputError if no stretch is long enough, UsageError for an axis that there is not.
    """
    axis = axis_named(axis)
    log = flight if isinstance(flight, Log) else read_log(flight)
    front = front_for([log], window_s)
    rows = rows_of(front, log.telemetry)
    pieces = training_pieces(rows, axis)
    if not pieces:
        raise InputError(f"{log.name}: no unbroken flight of {MIN_PIECE_S:g} s with a set-point; fly longer")
    return FlightRates([u for u, _ in pieces], [y for _, y in pieces], front.align.dt_s)


class Watch:
    """A live flight judged by a baseline: the same chain as in the detector.

    profile: of the link, if it is known. Raises BaselineError if the baseline is for another one.
    """

    def __init__(self, baseline: Baseline | str | Path, profile: str | None = None) -> None:
        known = _loaded(baseline)
        check_link(known, profile=profile or known.link.profile, dt_s=known.link.dt_s)
        self._chain = chain_of(known, time.time_ns(), profile)
        self._state = self._chain.start()
        #: Everything that the last step brought, with the latest value of each monitor.
        self.output = ChainOutput()

    def step(self, telemetry: Telemetry) -> tuple[Event | Change, ...]:
        """Take what has arrived; return the monitors' alarms and the changes of the decision, in order of time.

        Raises BaselineError if the telemetry, after two seconds, has another rate or profile than the baseline.
        """
        if not isinstance(telemetry, Telemetry):
            raise UsageError(f"step takes Telemetry, as `log.telemetry`, not {type(telemetry).__name__}")
        self.output = self._chain.step(self._state, telemetry)
        if self._state.refused:
            raise BaselineError(self._state.refused)
        return _in_order(self.output)

    def end_flight(self) -> tuple[Event | Change, ...]:
        """The vehicle landed or the link was lost: close what is open."""
        self.output = self._chain.end_flight(self._state)
        return _in_order(self.output)

    @property
    def diagnosis(self) -> Diagnosis:
        """What is held of the vehicle now."""
        return self._state.diagnosis

    def __repr__(self) -> str:
        return f"<Watch: {self.diagnosis.stage}, {self.diagnosis.reason}>"


def with_airframe(
    options: LearnOptions, airframe: Airframe | str | Path | None, name: str | None, layout: str | None = None
) -> LearnOptions:
    """The options with an airframe (a value, a name, a TOML file), a name for it and the name of a rotor layout."""
    if airframe is not None:
        value = airframe if isinstance(airframe, Airframe) else airframe_from(str(airframe))
        options = replace(options, airframe=value)
    if layout is not None:
        options = replace(options, airframe=with_layout(options.airframe, layout))
    return options if name is None else replace(options, airframe=replace(options.airframe, name=printable(name)))


def now() -> str:
    """The present time as a baseline records it."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _each(sources: Source | Iterable[Source]) -> Iterable[Source]:
    return [sources] if isinstance(sources, str) or not isinstance(sources, Iterable) else sources


def _logs(source: Source, vehicle: int | None) -> Iterable[Log]:
    if isinstance(source, Log):
        return [source]
    return (log_files.read_part(path, vehicle) for path in logs_named([_path(source)]).paths())


def _loaded(baseline: Baseline | str | Path) -> Baseline:
    return baseline if isinstance(baseline, Baseline) else Baseline.load(_path(baseline))


def _path(source: object) -> Path:
    if isinstance(source, str | Path):
        return Path(source)
    raise UsageError(f"a path is needed here, not {type(source).__name__}")


def _in_order(output: ChainOutput) -> tuple[Event | Change, ...]:
    told: list[Event | Change] = [*output.events, *output.changes]
    return tuple(sorted(told, key=lambda one: one.t_ns if isinstance(one, Change) else one.end_ns or one.start_ns))
