"""`mavdiag setup`: from a bare vehicle to a watched one. The folder is the state: the flights that were recorded."""

import itertools
import json
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, BinaryIO, TypeAlias

import typer
from typer import Argument, Option

from mavdiag.airframe.airframe import Airframe
from mavdiag.archive.paths import AS_BASELINE, check_output
from mavdiag.commandline import own_environ, say
from mavdiag.commands import options as opt
from mavdiag.commands.identify import make_baseline
from mavdiag.commands.inspect import COMPANION_OF, ask_for_all, hear
from mavdiag.errors import InputError, UsageError
from mavdiag.face import with_airframe
from mavdiag.learning import LearnOptions
from mavdiag.learning.coaching import ROUNDS, Coverage
from mavdiag.learning.flights import front_for, rows_of
from mavdiag.learning.suspicions import accepted
from mavdiag.link.codec import message_name
from mavdiag.link.keys import read_key
from mavdiag.link.link import POLL_S, Link, open_link
from mavdiag.link.messages import Autopilot, MavType, Severity
from mavdiag.link.profiles import PROFILES, Profile
from mavdiag.link.wants import LEAST_HZ, Companion, remedy
from mavdiag.logs import read_part
from mavdiag.logs.tlog import tlog_record
from mavdiag.look.inspection import RIGHT, Inspection, inspection_of
from mavdiag.look.words import in_full
from mavdiag.monitors.base import SLACK
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import Border
from mavdiag.storage import write_atomically
from mavdiag.telemetry import Instant, Log, Signal
from mavdiag.units import NS_PER_US

HEAR_S = 3.0  # of the link before it is told (our choice)
LOOK_S = 3.0  # between two looks at what was flown (our choice)
AGAIN_S = 20.0  # before a task is told again (our choice)
SILENT_S = 5.0  # without a frame a flight is over, or a battery is changed (our choice)
SILENCE = "the vehicle is off, or a recording has ended; it goes on when more comes, Ctrl-C keeps what was flown"
KEPT = 20_000  # frames before a take-off that go into its recording (our choice: 10 s of 1 kHz)
BASELINE, CONFIG = "baseline.json", "detector.toml"
UNIT = "mavdiag-detector.service"
HOME = Path("/var/lib/mavdiag")  # of the service

Frames: TypeAlias = list[tuple[bytes, int]]  # with their times of arrival [ns]


def setup(
    endpoint: Annotated[str, Argument(metavar="ENDPOINT", help="The vehicle's link, as the detector will have it.")],
    folder: Annotated[
        Path, Option("-o", "--output", metavar="DIR", help="Keeps flights, baseline and configuration.")
    ] = Path("mavdiag-setup"),
    airframe: Annotated[str | None, Option(metavar="NAME|FILE.toml", help="What is known of the vehicle.")] = None,
    layout: opt.Layout = None,
    name: Annotated[str | None, Option(metavar="LABEL", help='Its name.  [default: "vehicle" and its id]')] = None,
    vehicle: opt.Vehicle = None,
    signing_key: opt.SigningKey = None,
    accept: opt.Accept = False,
    yes: Annotated[bool, Option("--yes", help="Ask nothing, and do not start the service.")] = False,
) -> None:
    """Set a vehicle up: look at its link, ask for streams, coach healthy flights, learn, write the configuration.

    Fly with sound propellers. The pilot is told what to fly here and by STATUSTEXT, by what the flights cover so far.
    It may be stopped at any time and goes on where it was: the recordings in the folder count. Take one out that
    should not. It never arms and never sets a parameter. Exit code 0, or 2 with what to do.
    """
    baseline_file, config = folder / BASELINE, folder / CONFIG
    options = with_airframe(LearnOptions(robust=True), airframe, name, layout)
    key, passed = None if signing_key is None else read_key(signing_key), list[tuple[bytes, int]]()
    with open_link(endpoint, vehicle, None, key, passed) as link:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{folder}: {error.strerror}; name another folder with -o") from error
        check_output(baseline_file, kind=AS_BASELINE)
        log = _look(link, options.airframe, vehicle or COMPANION_OF)
        sysid, coverage = link.vehicle or COMPANION_OF, Coverage()
        flights = list(_known(folder, coverage, sysid, options))
        coach = _Coach(link, front_for([log], options.window_s, options.airframe.gate), coverage, passed)
        while coverage.step is not None:
            free = (folder / f"flight-{number:03d}.tlog" for number in itertools.count(1))
            path = next(path for path in free if not path.exists())
            flights += [path] if coach.fly(path) else []
    baseline = make_baseline(flights, options, called=f"vehicle {sysid}", vehicle=sysid)
    if not accept:
        accepted(baseline, f"--accept; take flights that are not sound out of {folder}, and run this again")
    baseline.save(baseline_file)
    settings = config_text(endpoint, sysid, folder.resolve(), signing_key)
    kept = config.exists() and config.read_bytes() != settings.encode()  # its user may have changed it
    if not kept:
        write_atomically(config, settings)
    told = " is kept as it is; for what this run would write, remove it and run this again" * kept
    say(*str(baseline).split("\n"), f"written to {baseline_file}, and for the detector {config}{told}:")
    check = [sys.executable, "-m", "detector", "--config", str(config), "--check"]
    if subprocess.run(check, env=own_environ(), check=False).returncode:
        raise UsageError(f"the detector refuses {config}; see above")
    say(f"start it with: mavdiag-detector --config {config}")
    _offer_service(folder.resolve(), ask=not yes)


def _known(folder: Path, coverage: Coverage, sysid: int, options: LearnOptions) -> Iterator[Path]:
    """The flights that are in the folder already and teach something; `coverage` takes them in."""
    for path in sorted(folder.glob("flight-*.tlog")):
        log = read_part(path, sysid)
        if coverage.take(rows_of(front_for([log], options.window_s, options.airframe.gate), log.telemetry)):
            say(f"{path} is flown already; covered so far: {coverage}")
            yield path
        else:
            say(f"{path} holds hardly any flight and is left out")


def _look(link: Link, told: Airframe, vehicle: int) -> Log:
    """Ask for streams and say what there is. Raises InputError, with what gives it, if that is too little to learn."""
    say(f"{link.address}: asking for streams and parameters")
    asked = ask_for_all(link, vehicle)
    log, rates_hz = hear(link, HEAR_S)
    found = inspection_of(log, told, link.address, None, link.count, rates_hz, asked)
    profile = PROFILES[log.profile]
    types, autopilots = ({one.value: one.name.lower() for one in kind} for kind in (MavType, Autopilot))
    kind = types.get(log.mav_type or 0, f"MAV_TYPE {log.mav_type}")
    say(f"vehicle {link.vehicle}: a {kind}, its autopilot is {autopilots[profile.autopilot]}", *in_full(found))
    if lacking := tuple(_lacking(found, profile)):
        raise InputError(f"too little comes to learn from: {'; '.join(lacking)}; then run this again")
    return log


def _lacking(found: Inspection, profile: Profile) -> Iterator[str]:
    yield from next(state.missing for state in found.monitors if state.monitor == RunLength.name)
    for signal, msgid in ((Signal.BODY_RATE, profile.imu), (Signal.ATTITUDE_SETPOINT, profile.setpoint)):
        rate_hz = next((one.rate_hz or 0.0 for one in found.signals if one.signal == signal), 0.0)
        if 0.0 < rate_hz < SLACK * LEAST_HZ:
            gives = remedy(profile.autopilot, msgid)
            yield f"{message_name(msgid)} comes at {rate_hz:.0f} Hz, {LEAST_HZ:.0f} are needed: {gives}"
    if found.units.gravity_g is not None and found.units.gravity != RIGHT:
        yield f"gravity is {found.units.gravity_g:.2f} g: {found.units.gravity}"


class _Coach:
    """Records flights and says what to fly. passed: gets the link's frames."""

    def __init__(self, link: Link, front: Front, coverage: Coverage, passed: Frames) -> None:
        self._link, self._front, self._coverage, self._passed = link, front, coverage, passed
        self._companion = Companion(link.vehicle or COMPANION_OF, link.signing)
        self._first = len(passed)  # frames with the parameters, which the first recording gets
        self._flights = 0  # that were waited for
        self._told: tuple[str, Instant] | None = None  # what, without its figures, and when
        self._silent = False  # whether that was said

    def fly(self, path: Path) -> bool:
        if self._flights:  # another battery: the autopilot may have forgotten what it was asked for
            ask_for_all(self._link, self._link.vehicle or COMPANION_OF)
        self._flights += 1
        state, rows, taught, ended, lost = self._front.start(), list[Rows](), False, False, False
        looked = heard = Instant(time.monotonic_ns())
        with ExitStack() as stack:
            file: BinaryIO | None = None
            while not ended:
                telemetry, now = self._link.poll(POLL_S), Instant(time.monotonic_ns())
                heard, self._silent = (now, False) if telemetry.series else (heard, self._silent)
                lost = now - heard > SILENT_S
                parts = self._front.step(state, telemetry)
                rows += [part for part in parts if isinstance(part, Rows)]
                ended = any(isinstance(part, Border) for part in parts) or lost
                if rows and file is None:
                    file = stack.enter_context(path.open("xb", buffering=0))
                self._record(file)
                if ended or now - looked > LOOK_S:
                    taught = self._coverage.take(rows) or taught
                    looked, rows = now, []
                self._link.send([*self._companion.beat(now), *self._words(file is not None, now)])
        if file is not None and not taught:
            path.unlink()
        if lost and not self._silent:
            say(f"nothing has come for {SILENT_S:g} s: {SILENCE}")
            self._silent = True
        if file is not None:
            how = "cut off" if lost else "landed"
            say(f"{how}; covered so far: {self._coverage}" if taught else "that was hardly a flight")
            self._told = None
        return taught

    def _record(self, file: BinaryIO | None) -> None:
        """Write what came; without a file keep the parameters, which came first, and the latest."""
        if file is None:
            del self._passed[self._first : -KEPT]
            return
        epoch_ns = time.time_ns() - time.monotonic_ns()  # the wall clock may have been set meanwhile
        records = [tlog_record((epoch_ns + ns) // NS_PER_US, frame) for frame, ns in self._passed]
        file.write(b"".join(records))
        self._passed.clear()
        self._first = 0

    def _words(self, flies: bool, now: Instant) -> list[bytes]:
        """Say what to fly if that is new, or was said long ago; the STATUSTEXT with it."""
        step = self._coverage.step
        if not flies:
            task, words = "take off", "arm and climb to where it will fly; sound propellers, hardly any wind at first"
        elif step is None:
            task, words = "land", "all is flown"
        else:
            task, words = step.task.title, f"{step.task.words}; {step.left_s} s, round {step.round} of {ROUNDS}"
        told, at = self._told or ("", now)
        if told == task and (not flies or now - at < AGAIN_S):
            return []
        self._told = task, now
        say(f"now {task}: {words}")
        text = f"now {task}" + (f" {step.left_s} s" if flies and step else "")
        return [self._companion.statustext(Severity.INFO, text)]


def config_text(endpoint: str, sysid: int, folder: Path, signing_key: Path | None) -> str:
    """The detector's configuration for a vehicle whose baseline and journal are in a folder."""
    values: dict[str, str | int] = {"connect": endpoint, "vehicle": sysid, "baseline": str(folder / BASELINE)}
    values["journal"] = str(folder / "events.jsonl")
    values |= {} if signing_key is None else {"signing_key": str(signing_key.resolve())}
    # JSON's strings and whole numbers are TOML's, too.
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())
    return "# made by `mavdiag setup`; `mavdiag-detector --print-config` shows all settings\n" + "".join(lines)


def _offer_service(folder: Path, *, ask: bool) -> None:
    places = Path(sys.prefix, "lib/systemd/system", UNIT), Path(__file__).parents[2] / "deploy" / UNIT
    unit = next((place for place in places if place.is_file()), None)
    if unit is None:
        return
    script = folder / "install-service.sh"
    write_atomically(script, service_script(folder, unit, Path(sysconfig.get_path("scripts"))))
    command = [*([] if os.geteuid() == 0 else ["sudo"]), "sh", str(script)]
    if not (ask and sys.stdin.isatty() and typer.confirm("install and start it as a systemd service?")):
        say(f"as a systemd service: {shlex.join(command)}")
    elif subprocess.run(command, check=False).returncode:
        raise UsageError(f"the service was not installed; see above, mend it and run: {shlex.join(command)}")


def service_script(folder: Path, unit: Path, programs: Path) -> str:
    """The shell script that installs baseline, configuration and unit. programs: where mavdiag-detector is."""
    here, there = shlex.quote(str(folder)), str(HOME)
    written = json.dumps(str(folder), ensure_ascii=False)[1:-1]
    moved = shlex.quote("s|" + re.sub(r"[\[\\.*^$|]", r"\\\g<0>", written) + f"/|{there}/|")
    placed = shlex.quote("s|/opt/mavdiag/bin|" + re.sub(r"[\\&|]", r"\\\g<0>", str(programs)) + "|")
    return f"""#!/bin/sh
set -e
install -D -m 644 {here}/{BASELINE} {there}/{BASELINE}
sed {moved} {here}/{CONFIG} | install -D -m 644 --backup=numbered /dev/stdin /etc/mavdiag/{CONFIG}
sed {placed} {shlex.quote(str(unit))} > /etc/systemd/system/{UNIT}
systemctl daemon-reload
systemctl enable --now {UNIT}
"""
