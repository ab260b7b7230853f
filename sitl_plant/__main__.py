"""The `sitl-plant` command (edge): fly an emulated multirotor over MAVLink, or many, or record its flight.

Exit codes: 0 the flight ended, by its duration or a signal; 2 an error, with one line on stderr; 130 a record stopped.
"""

if __name__ == "__main__":  # before what takes time to load
    from mavdiag.__main__ import start

    start("sitl_plant.__main__")

import json
import multiprocessing
import os
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from typer import Option

from mavdiag import commandline
from mavdiag.archive.paths import AS_TLOG, check_output
from mavdiag.commands.progress import working
from mavdiag.errors import MavdiagError, UsageError
from mavdiag.link.keys import open_signing
from mavdiag.link.ports import Endpoint, open_endpoint
from sitl_plant.campaign.command import campaign
from sitl_plant.emulator import FlightReport, Link, fly, record_flight
from sitl_plant.hil.command import serve_ardupilot, serve_hil, serve_px4
from sitl_plant.options import STARTING, FlightPlan, TruthFile, check_times, parse_speed, with_flight
from sitl_plant.plant import Plant, PlantSamples
from sitl_plant.truth import Truth, truth_file

RECORD_S = 60.0  # a recorded flight, unless --duration says otherwise
AFTER_S = 3.0  # of flight time beyond a landing, so that everybody hears that it is disarmed (our choice)
LAST_ID = 255
POLL_S = 0.2  # how often the processes are looked at
_LINKS = "udpout:H:P, udpin:H:P, tcp:H:P, tcpin:H:P or /dev/ttyX,BAUD; repeat it for several links."

app = commandline.application("Fly an emulated multirotor with propeller faults over MAVLink.")
for command in (campaign, serve_ardupilot, serve_px4, serve_hil):
    app.command()(command)


@app.command()
@with_flight
def run(
    plan: FlightPlan,
    out: Annotated[list[str], Option(metavar="ENDPOINT", help=_LINKS)] = ["udpout:127.0.0.1:14550"],  # noqa: B006
    speed: Annotated[str, Option(metavar="X|max", help="Flight seconds a second.")] = "1",
    fresh: Annotated[bool, Option("--fresh-link", help="Send unasked only what the real autopilot does.")] = False,
    truth: TruthFile = None,
    signing_key: Annotated[Path | None, Option(metavar="FILE", help="Sign, and refuse what is not signed.")] = None,
    as_json: Annotated[bool, Option("--json", help="Print start and end as JSON lines on stdout.")] = False,
) -> None:
    """Fly in real time until the duration is over, or until SIGINT or SIGTERM. Exit code 0, or 2 for an error."""
    pace = parse_speed(speed)
    if fresh and not plan.dialect.unasked:
        raise UsageError(f"--fresh-link needs --profile ardupilot or px4, not {plan.dialect.profile.name}")
    with ExitStack() as stack:
        ends = [stack.enter_context(open_endpoint(address)) for address in out]
        with working(STARTING):
            plant = Plant(plan.config)
        own = None if signing_key is None else closing(open_signing(signing_key, "plant", time.time_ns()))
        kept = None if own is None else stack.enter_context(own)
        signing = None if kept is None else kept.signing
        links = [Link(end, plan.dialect, plan.rate_hz, plant.rotors, signing, fresh=fresh) for end in ends]
        lines = stack.enter_context(truth_file(truth))
        stop = stack.enter_context(commandline.stop_signals())
        typer.echo(_announced(plan, [link.endpoint.address for link in links], as_json))
        now_ns = time.time_ns() if pace == 1.0 else None
        told = Truth(plan.config, plan.dialect.profile.name, plan.rate_hz, now_ns, lines)

        def watch(samples: PlantSamples) -> None:
            told.write(samples, plant.take_changes())
            if kept is not None:
                kept.step(time.time_ns())

        report = fly(
            plant, plan.dialect, links, duration_s=plan.duration_s, speed=pace, stop=stop, watch=watch, slip=told.slip
        )
    typer.echo(json.dumps({"event": "landed"} | asdict(report)) if as_json else _concluded(report))


@app.command()
@with_flight
def record(
    plan: FlightPlan,
    output: Annotated[Path, Option("-o", "--output", metavar="FILE.tlog", help="File to write.")],
    flights: Annotated[int, Option(help="Record so many flights, to FILE-000.tlog and on, seed by seed.")] = 1,
    truth: TruthFile = None,
) -> None:
    """Fly as fast as it goes into a .tlog file. The same options give the same file, bit for bit."""
    if plan.config.commanded:
        raise UsageError("nobody commands a vehicle that is recorded: use run, or another --trajectory")
    if flights < 1 or (flights > 1 and truth is not None):
        raise UsageError(f"--flights {flights}: give one or more, and --truth for a single flight only")
    duration = RECORD_S if plan.duration_s is None else plan.duration_s
    check_times(plan.config.fault, plan.config.onset_s, duration)
    for number in range(flights):
        path = output if flights == 1 else output.with_name(f"{output.stem}-{number:03d}{output.suffix}")
        check_output(path, truth, kind=AS_TLOG)
        own = replace(plan, config=replace(plan.config, seed=plan.config.seed + number, landed_s=duration))
        words = f"{path}: flying {duration:g} s; the first flight compiles the plant, up to a minute ..."
        with truth_file(truth, whole=True) as lines, working(words):
            written = Truth(own.config, own.dialect.profile.name, own.rate_hz, None, lines)
            messages = record_flight(path, own, duration, written.write)
        typer.echo(f"{path}: {duration:g} s of flight, {messages} messages")


@app.command()
@with_flight
def fleet(
    plan: FlightPlan,
    count: Annotated[int, Option("-n", "--count", min=1, max=LAST_ID, help="How many.")] = 20,
    faulty: Annotated[str | None, Option(metavar="SYSID,..", help="Which get the --fault.  [default: all]")] = None,
    out: Annotated[str, Option(metavar="ENDPOINT", help="Where to, from one port each.")] = "udpout:127.0.0.1:14550",
    port_each: Annotated[bool, Option("--port-each", help="The second sends to the next port, and so on.")] = False,
) -> None:
    """Fly several vehicles in real time, with system ids and seeds that follow each other from --system-id and --seed.

    Until the duration is over, or until SIGINT or SIGTERM. Exit code 0, or 2 for an error.
    """
    plans = [_numbered(plan, number) for number in range(count)]
    wanted = {member.dialect.sysid for member in plans} if faulty is None else _ids(faulty, plans)
    if faulty is not None and plan.config.fault is None:
        raise UsageError("--faulty is about a fault; add --fault F2/SV2")
    plans = [p if p.dialect.sysid in wanted else replace(p, config=replace(p.config, fault=None)) for p in plans]
    with working(STARTING):
        Plant(plan.config).advance(1)  # compiled once, for all processes
    context = multiprocessing.get_context("fork")  # which shares what was compiled
    with ExitStack() as stack:
        ends = [stack.enter_context(open_endpoint(_address(out, number * port_each))) for number in range(count)]
        stop, pairs = stack.enter_context(commandline.stop_signals()), zip(plans, ends, strict=True)
        flights = [context.Process(target=_fly, args=(*pair, stop, os.getpid())) for pair in pairs]
        for flight in flights:
            flight.start()
        typer.echo(f"{count} vehicles fly, {len(wanted) if plan.config.fault else 0} with a fault; they send to {out}")
        while not stop() and any(flight.is_alive() for flight in flights):
            time.sleep(POLL_S)
        for flight in flights:
            if flight.is_alive() and stop():
                flight.terminate()
            flight.join()
        died = sum(flight.exitcode != 0 for flight in flights) if not stop() else 0
    if died:
        raise MavdiagError(f"{died} of {count} vehicles died; what they said is above")


def _fly(plan: FlightPlan, end: Endpoint, stop: Callable[[], bool], parent: int) -> None:
    plant = Plant(plan.config)
    link = Link(end, plan.dialect, plan.rate_hz, plant.rotors)
    over_s = None if plan.duration_s is None else plan.duration_s + AFTER_S * (plan.config.start == "ground")
    fly(plant, plan.dialect, [link], duration_s=over_s, speed=1.0, stop=lambda: stop() or os.getppid() != parent)


def _numbered(plan: FlightPlan, number: int) -> FlightPlan:
    sysid = plan.dialect.sysid + number
    if sysid > LAST_ID:
        raise UsageError(f"system ids end at {LAST_ID}: fly fewer vehicles, or from a lower --system-id on")
    config = replace(plan.config, seed=plan.config.seed + number)
    return replace(plan, config=config, dialect=replace(plan.dialect, sysid=sysid))


def _ids(text: str, plans: list[FlightPlan]) -> set[int]:
    known = {plan.dialect.sysid for plan in plans}
    words = text.split(",")
    if not all(word.strip().isdecimal() and int(word) in known for word in words):
        raise UsageError(f"--faulty {text}: name system ids of the fleet, {min(known)} to {max(known)}, by commas")
    return {int(word) for word in words}


def _address(out: str, further: int) -> str:
    head, _, port = out.rpartition(":")
    return f"{head}:{int(port) + further}" if further and port.isdecimal() else out


def _announced(plan: FlightPlan, addresses: list[str], as_json: bool) -> str:
    config, profile, rate_hz = plan.config, plan.dialect.profile.name, plan.rate_hz
    if as_json:
        return json.dumps({"event": "flying", "addresses": addresses, "profile": profile, "rate_hz": rate_hz})
    fault = f", {config.fault} on rotor {config.rotor} from {config.onset_s:g} s" if config.fault else ", healthy"
    path = "as it is told" if config.commanded else f"a {config.trajectory}"
    link = f"{profile} at {rate_hz:g} Hz on {', '.join(addresses)}"
    return f"{config.vehicle.name} number {config.drone} flies {path}{fault}; {link}"


def _concluded(report: FlightReport) -> str:
    return (
        f"{report.flown_s:.1f} s flown in {report.wall_s:.1f} s at {100 * report.cpu_s / report.wall_s:.0f} % CPU; "
        f"{report.messages} messages sent, {report.dropped} dropped, {report.received} received; "
        f"late by at most {report.late_max_ms:.1f} ms"
    )


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "sitl-plant")
