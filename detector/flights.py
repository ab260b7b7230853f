"""The history that the daemon feeds (edge): each flight is recorded, and judged once more after its landing.

A recording is a .tlog of one vehicle, from its arming until it is disarmed or gone. A thread hands it to `mavdiag
history add`, a process of its own that gives way to the daemon: the record is the one that the log would give. Then
the recording is deleted. One that could not be added stays in the folder, and is tried again at the next start.
"""

import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import BinaryIO, TypeAlias

from detector.fleet import Vehicle
from detector.hooks import Courier
from detector.judging import Judge
from mavdiag.baseline import Baseline, dump
from mavdiag.commandline import own_environ
from mavdiag.errors import UsageError, check_installed
from mavdiag.judging import MIN_JUDGED_S
from mavdiag.logs.tlog import tlog_record
from mavdiag.storage import leave_room, write_atomically
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S, NS_PER_US

Passed: TypeAlias = Iterable[tuple[bytes, int]]  # frames with their time of arrival [ns]
_Job: TypeAlias = tuple[Path, int, Baseline]  # a recording, the system id of its vehicle, and what judges it
ADD_S = 600.0  # that one flight may take to be judged (our choice: an hour at 1 kHz on a small computer)
GONE_S = 60.0  # without a frame a flight is over (our choice: a radio is lost for less, a battery's change takes more)
MAVLINK_2 = 0xFD  # first byte of a frame; its system id is the sixth, of MAVLink 1 the fourth


@dataclass(slots=True)
class _Flight:
    path: Path
    judges: list[Judge]  # of the vehicle's session in turn: a reboot brings another
    before_s: float  # flight time of the first of them at its begin
    file: BinaryIO | None = None  # None where it could not be opened


class Flights(Courier[_Job]):
    """Records the flights of all vehicles. folder: of the recordings. warn: as in `Courier`.

    Raises UsageError if the folder or the history's database cannot be used.
    """

    def __init__(self, database: str, folder: Path, warn: Callable[[str], None]) -> None:
        check_installed("--history", "SQLAlchemy", "history")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{folder}: {error.strerror}; name another folder of flights") from error
        self._database, self._folder = database, folder
        self._open: dict[int, _Flight] = {}
        self._left = sorted(p for p in folder.iterdir() if re.fullmatch(r"\d{1,3}-\d{8}T\d{6}\.tlog", p.name))
        super().__init__("history", self._add, warn)

    def look(self, passed: Passed, vehicles: Mapping[int, Vehicle], now: Instant, epoch_ns: int) -> None:
        """After each look of the daemon. epoch_ns: unix time less the clock of the times of arrival."""
        for sysid, vehicle in vehicles.items():
            session, flight = vehicle.session, self._open.get(sysid)
            flies = session.armed and now - session.latest <= GONE_S
            if flight is not None and session.judge is not None and session.judge not in flight.judges:
                flight.judges.append(session.judge)
            if flight is None and flies and session.judge is not None:
                at = datetime.fromtimestamp((epoch_ns + now.ns) / NS_PER_S, UTC)
                begun = _Flight(self._folder, [session.judge], session.judge.flight_s)
                self._open[sysid] = begun
                with self._telling(self._folder):
                    while (path := self._folder / f"{sysid}-{at:%Y%m%dT%H%M%S}.tlog").exists():
                        at += timedelta(seconds=1)  # the wall clock was set back
                    begun.path, begun.file = path, path.open("xb", buffering=0)
            elif flight is not None and not flies:
                self._landed(sysid, vehicle)
        for sysid in self._open.keys() - vehicles.keys():  # they were swapped for others, which are not watched
            self._landed(sysid, None)
        if self._open:
            self._append(passed, epoch_ns)

    def end(self, vehicles: Mapping[int, Vehicle]) -> None:
        """The daemon stops: what flies has landed as far as it can know."""
        for sysid in tuple(self._open):
            self._landed(sysid, vehicles.get(sysid))

    def add_left(self, baseline_of: Callable[[int], Baseline | None]) -> None:
        """Try again what an earlier start left, of vehicles whose baseline is known. baseline_of: by system id."""
        for path in tuple(self._left):
            sysid = int(path.name.partition("-")[0])
            if (baseline := baseline_of(sysid)) is not None:
                self._left.remove(path)
                self.put((path, sysid, baseline))

    def _append(self, passed: Passed, epoch_ns: int) -> None:
        records: dict[int, list[bytes]] = {sysid: [] for sysid in self._open}
        for frame, host_ns in passed:
            sysid = frame[5] if frame[0] == MAVLINK_2 else frame[3]
            if sysid in records:
                records[sysid].append(tlog_record((epoch_ns + host_ns) // NS_PER_US, frame))
        for sysid, own in records.items():
            flight = self._open[sysid]
            if own and flight.file is not None:
                with self._telling(flight.path):
                    leave_room(flight.file)
                    flight.file.write(b"".join(own))

    def _landed(self, sysid: int, vehicle: Vehicle | None) -> None:
        flight = self._open.pop(sysid)
        if flight.file is None:
            return
        flown_s = sum(judge.flight_s for judge in flight.judges) - flight.before_s
        flew = vehicle is None or vehicle.session.judge is None or flown_s >= MIN_JUDGED_S
        flew = flew and flight.file.tell() > 0  # a full disk had no room for it
        with self._telling(flight.path):
            flight.file.close()
            if not flew:
                flight.path.unlink(missing_ok=True)
        if flew:
            self.put((flight.path, sysid, flight.judges[0].baseline))

    @contextmanager
    def _telling(self, path: Path) -> Iterator[None]:
        """Count what cannot be written as lost; the flight is not given up for it."""
        try:
            yield
        except OSError as error:
            self._lose(f"{path}: {error.strerror}")

    def _add(self, job: _Job) -> None:
        """On the thread. Raises OSError, with what the command says, if the flight is not added."""
        path, sysid, baseline = job
        airframe = baseline.airframe.name + ("" if baseline.airframe.scope == "airframe" else f" {sysid}")
        judged_by = self._folder / f"{baseline.digest.rpartition(':')[2][:16]}.json"
        options = ("--baseline", str(judged_by), "--vehicle", str(sysid), "--airframe", airframe)
        command = ["nice", sys.executable, "-m", "mavdiag", "history", "add", str(path), *options, "--no-cache"]
        run = partial(subprocess.run, capture_output=True, text=True, timeout=ADD_S, env=own_environ())
        try:
            if not judged_by.exists():
                write_atomically(judged_by, dump(baseline))
            done = run([*command, "--jobs", "1", "--database", self._database], start_new_session=True, check=False)
        except (subprocess.SubprocessError, UsageError) as error:
            raise OSError(str(error)) from error
        if done.returncode:
            raise OSError(" ".join((done.stderr or done.stdout).splitlines()[-1:]))
        path.unlink()
