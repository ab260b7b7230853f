"""`sitl-plant fleet`: many emulated vehicles, a process each (edge)."""

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

import typer
from typer import Option

from mavdiag import commandline
from mavdiag.commands.progress import working
from mavdiag.errors import UsageError
from mavdiag.link.ports import Endpoint, open_endpoint
from sitl_plant.emulator import Link, fly
from sitl_plant.options import STARTING, FlightPlan, with_flight
from sitl_plant.plant import Plant

AFTER_S = 3.0  # of flight time beyond a landing, so that everybody hears that it is disarmed (our choice)
LAST_ID = 255
POLL_S = 0.2  # how often the processes are looked at


@with_flight
def fleet(
    plan: FlightPlan,
    count: Annotated[int, Option("-n", "--count", min=1, max=LAST_ID, help="How many.")] = 20,
    faulty: Annotated[
        str | None, Option(metavar="SYSID,..", help="Which of them get the --fault.  [default: all]")
    ] = None,
    out: Annotated[str, Option(metavar="ENDPOINT", help="Where all send to, each from a port of its own.")] = (
        "udpout:127.0.0.1:14550"
    ),
    port_each: Annotated[bool, Option("--port-each", help="The second sends to the next port, and so on.")] = False,
) -> None:
    """Fly several vehicles in real time, with system ids and seeds that follow each other from --system-id and --seed.

    Until the duration is over, or until SIGINT or SIGTERM. Exit code 0, or 2 for an error.
    """
    plans = [_numbered(plan, number) for number in range(count)]
    wanted = {one.dialect.sysid for one in plans} if faulty is None else _ids(faulty, plans)
    if faulty is not None and plan.config.fault is None:
        raise UsageError("--faulty is about a fault; add --fault F2/SV2")
    with working(STARTING):
        Plant(plan.config).advance(1)  # compiled once, for all processes
    context = multiprocessing.get_context("fork")  # which shares what was compiled
    ends = [open_endpoint(_address(out, number * port_each)) for number in range(count)]
    with commandline.stop_signals() as stop:
        pairs = [
            (one if one.dialect.sysid in wanted else replace(one, config=replace(one.config, fault=None)), end)
            for one, end in zip(plans, ends, strict=True)
        ]
        flights = [context.Process(target=_fly, args=(*pair, stop)) for pair in pairs]
        for flight in flights:
            flight.start()
        typer.echo(f"{count} vehicles fly, {len(wanted) if plan.config.fault else 0} with a fault; they send to {out}")
        while not stop() and any(flight.is_alive() for flight in flights):
            time.sleep(POLL_S)
        for flight in flights:
            if flight.is_alive() and stop():
                flight.terminate()
            flight.join()
    for end in ends:
        end.close()


def _fly(plan: FlightPlan, end: Endpoint, stop: Callable[[], bool]) -> None:
    plant = Plant(plan.config)
    link = Link(end, plan.dialect, plan.rate_hz, plant.rotors)
    over_s = None if plan.duration_s is None else plan.duration_s + AFTER_S * (plan.config.start == "ground")
    fly(plant, plan.dialect, [link], duration_s=over_s, speed=1.0, stop=stop, watch=lambda samples: None)


def _numbered(plan: FlightPlan, number: int) -> FlightPlan:
    """The plan of a vehicle, from 0. Raises UsageError for a system id that there is not."""
    sysid = plan.dialect.sysid + number
    if sysid > LAST_ID:
        raise UsageError(f"system ids end at {LAST_ID}: fly fewer vehicles, or from a lower --system-id on")
    config = replace(plan.config, seed=plan.config.seed + number)
    return replace(plan, config=config, dialect=replace(plan.dialect, sysid=sysid))


def _ids(text: str, plans: list[FlightPlan]) -> set[int]:
    known = {plan.dialect.sysid for plan in plans}
    words = text.split(",")
    if not all(word.strip().isdecimal() and int(word) in known for word in words):
        raise UsageError(f"--faulty {text}: name system ids of the fleet, {min(known)} to {max(known)}, as in 3,7")
    return {int(word) for word in words}


def _address(out: str, further: int) -> str:
    """The address with a port that is so much higher."""
    head, _, port = out.rpartition(":")
    return f"{head}:{int(port) + further}" if further and port.isdecimal() else out
