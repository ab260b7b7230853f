"""The commands that put the plant under an autopilot outside, and their loops (edge).

They receive, fly and answer, until a signal or the duration ends it.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mavdiag import commandline
from mavdiag.commands.progress import working
from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder
from mavdiag.link.ports import Endpoint, Kind, open_endpoint, parse_address
from sitl_plant import options
from sitl_plant.hil.ardupilot import Lockstep
from sitl_plant.hil.px4 import WANTED, Bridge
from sitl_plant.hil.simulation import AutopilotName, OutputMap, Simulation, output_map, parameter_file
from sitl_plant.physics.airframe import Payload
from sitl_plant.physics.airframe import drone as specimen
from sitl_plant.physics.faults import Injection, fault_injection
from sitl_plant.plant import PlantConfig
from sitl_plant.truth import Truth, truth_file
from sitl_plant.vehicle import vehicle_from

POLL_S = 0.2  # how often a signal is looked for
PATIENCE_S = 1.0  # wall clock: a sensor message that was not answered for so long is followed by the next (our choice)
SLIP_S = 0.1  # wall clock: what is later than this is not caught up
_PRINTED = "Print the parameter file to load into the autopilot, and end."


@dataclass(frozen=True, slots=True)
class HilOptions:
    """What the commands share. duration_s: infinite if it was left open."""

    config: PlantConfig
    after_takeoff: tuple[Injection, ...]  # the fault, if there is one
    duration_s: float
    truth: Path | None
    parameters_of: AutopilotName | None

    @contextmanager
    def serving(
        self, endpoint: str, link: str, rate_hz: float, autopilot: str, outputs: OutputMap
    ) -> Iterator[tuple[Endpoint, Simulation, Callable[[], bool]]]:
        """Open port, simulation and truth file, and say in one line who may connect where, and what will happen.

        The last of the values says whether to go on. link, rate_hz: for the truth file.
        """
        with open_endpoint(endpoint) as port, truth_file(self.truth) as lines, commandline.stop_signals() as stop:
            with working(options.STARTING):
                watch = Truth(self.config, link, rate_hz, None, lines).write
                simulation = Simulation(self.config, self.after_takeoff, watch)
            told = "healthy"
            for fault in self.after_takeoff:
                place = f"rotor {fault.rotor} (motor {outputs.motor(fault.rotor)})"
                told = f"{fault.name} on {place} {fault.onset_s:g} s after the take-off"
            typer.echo(f"{self.config.vehicle.name} stands ready, {told}; waiting for {autopilot} on {port.address}")
            yield port, simulation, lambda: simulation.t_s < self.duration_s and not stop()


def hil_options(
    vehicle: options.VehicleName = "qdrone2",
    drone: options.Drone = 1,
    fault: options.FaultCode = None,
    rotor: Annotated[int, Option(help="Damaged rotor, as the vehicle's file counts.")] = 1,
    onset: Annotated[float, Option(metavar="S", help="When the fault begins, counted from the take-off.")] = 0.0,
    phenomenology: options.Phenomenology = 1.0,
    wind: options.Wind = 0.0,
    turbulence: options.W20 = 0.0,
    payload: options.PayloadKg = 0.0,
    seed: Annotated[int, Option(help="Equal seeds and equal commands give equal flights.")] = 0,
    duration: Annotated[float | None, Option(metavar="S", help="Flight time.  [default: run until stopped]")] = None,
    truth: options.TruthFile = None,
    print_parameters: Annotated[AutopilotName | None, Option(help=_PRINTED)] = None,
) -> HilOptions:
    """Check the options and put them together. Raises UsageError for what cannot be flown."""
    options.check_times(fault, onset, duration, rotor, phenomenology)
    kind = vehicle_from(vehicle)
    if not 1 <= rotor <= len(kind.rotors):
        raise UsageError(f"rotor must be 1 to {len(kind.rotors)}, not {rotor}")
    config = PlantConfig(
        vehicle=kind,
        drone=drone,
        airframe=specimen(kind, drone),
        start="ground",
        trajectory="hover",
        rotor=rotor,
        phenomenology=phenomenology,
        wind_m_s=wind,
        turbulence_m_s=turbulence,
        payload=Payload(payload),
        seed=seed,
    )
    later = () if fault is None else (fault_injection(fault, rotor, onset, phenomenology),)
    return HilOptions(config, later, math.inf if duration is None else duration, truth, print_parameters)


@options.with_options(hil_options)
def serve_ardupilot(
    asked: HilOptions,
    listen: Annotated[
        str, Option(metavar="udpin:HOST:PORT", help="Where ArduPilot (--model JSON:HOST) sends its frames.")
    ] = "udpin:127.0.0.1:9002",
) -> None:
    """Be the JSON physics of ArduPilot, until the duration is over, SIGINT or SIGTERM. Exit code 0, or 2 for an error.

    Rotors and outputs are those of the table [hil] of the vehicle's file.
    """
    if asked.parameters_of:
        typer.echo(parameter_file(asked.config.vehicle, asked.parameters_of), nl=False)
        return
    outputs = output_map(asked.config.vehicle, "ardupilot")
    if parse_address(listen).kind is not Kind.UDP_IN:
        raise UsageError(f"{listen}: the autopilot sends to a UDP port: write udpin:HOST:PORT")
    with asked.serving(listen, "ardupilot-json", 1000.0, "ArduPilot", outputs) as (port, simulation, goes_on):
        lockstep, started_s = Lockstep(simulation, outputs), time.monotonic()
        counts = lockstep.counts
        while goes_on():
            received = port.receive(POLL_S)
            for (data, _), peer in zip(received, received.sources, strict=True):
                foreign = counts.foreign
                answer = lockstep.feed(data, peer, time.monotonic())
                if answer is not None:
                    port.answer(answer, peer)
                elif counts.foreign == 1 > foreign:
                    what = f"{len(data)} bytes that are no servo frame of ArduPilot"
                    commandline.say(f"ignored {what}, and shall ignore others too", err=True)
    took_s = time.monotonic() - started_s
    typer.echo(
        f"{simulation.t_s:.1f} s flown in {took_s:.1f} s; {counts.frames} frames ({counts.frames / took_s:.0f}/s), "
        f"{counts.resent} answered again, {counts.restarts} restarts of the autopilot, "
        f"{counts.foreign} foreign datagrams, {counts.ignored} of a replaced autopilot"
    )


Rate = Annotated[float, Option(metavar="HZ", min=50.0, max=1000.0, help="Rate of HIL_SENSOR.")]


@options.with_options(hil_options)
def serve_px4(
    asked: HilOptions,
    listen: Annotated[
        str, Option(metavar="tcpin:HOST:PORT", help="Where PX4 in simulation connects to.")
    ] = "tcpin:127.0.0.1:4560",
    rate: Rate = 250.0,
    speed: Annotated[str, Option(metavar="X|max", help="Flight seconds a second, if PX4 keeps step.")] = "1",
) -> None:
    """Be the simulator of PX4, until the duration is over, SIGINT or SIGTERM. Exit code 0, or 2 for an error.

    PX4 and the plant wait for each other, if PX4 was built so.
    """
    pace = options.parse_speed(speed)
    _serve_mavlink(asked, listen, rate, period_s=1.0 / (rate * pace) if pace else 0.0, hardware=False)


@options.with_options(hil_options)
def serve_hil(
    asked: HilOptions,
    endpoint: Annotated[str, typer.Argument(help="/dev/ttyX,BAUD, or another address of a flight controller.")],
    rate: Rate = 250.0,
) -> None:
    """Be sensors and motors of a PX4 flight controller in HIL mode, in real time. Exit code 0, or 2 for an error."""
    _serve_mavlink(asked, endpoint, rate, period_s=1.0 / rate, hardware=True)


def _serve_mavlink(asked: HilOptions, address: str, rate_hz: float, *, period_s: float, hardware: bool) -> None:
    """Fly PX4 over MAVLink. In simulation wait for the controls where they ask for it.

    period_s: wall clock from one sensor message to the next in lockstep, 0 for as fast as it goes; else real time.
    """
    if asked.parameters_of:
        typer.echo(parameter_file(asked.config.vehicle, asked.parameters_of, hardware=hardware), nl=False)
        return
    outputs, peer = output_map(asked.config.vehicle, "px4"), "a flight controller" if hardware else "PX4"
    with asked.serving(address, "px4-hil", rate_hz, peer, outputs) as (endpoint, simulation, goes_on):
        bridge, decoder, started_s = Bridge(simulation, outputs, rate_hz), Decoder(WANTED), time.monotonic()
        flying, told, next_s = False, False, 0.0
        sent_s: float | None = None  # when the last sensor message went out
        while goes_on():
            flying = flying and endpoint.connected
            wait_s = _left_s(bridge, sent_s, next_s, lockstep=not hardware) if flying else POLL_S
            for frame in decoder.take(endpoint.receive(wait_s), datagrams=endpoint.datagrams):
                bridge.hear(frame)
            if not flying and endpoint.connected:
                if sent_s is not None:
                    bridge.restart()
                flying, sent_s = True, time.monotonic()
                next_s = sent_s
            if flying and not _left_s(bridge, sent_s, next_s, lockstep=not hardware):
                for message in bridge.advance():
                    endpoint.send(message)
                sent_s = time.monotonic()
                next_s = max(
                    next_s + (bridge.period_s if hardware or not bridge.lockstep else period_s), sent_s - SLIP_S
                )
            if hardware and not told and bridge.in_hil is False:
                told, remedy = True, "load the file of --print-parameters px4 and restart it"
                commandline.say(f"the flight controller is not in HIL mode: {remedy}", err=True)
        traffic = endpoint.traffic
    typer.echo(
        f"{simulation.t_s:.1f} s flown in {time.monotonic() - started_s:.1f} s; {bridge.controls} motor commands, "
        f"{traffic.sent} messages sent, {traffic.dropped} dropped, {bridge.restarts} restarts of the autopilot"
    )


def _left_s(bridge: Bridge, sent_s: float | None, next_s: float, *, lockstep: bool) -> float:
    """Until the next message is due; while an answer to the last one is awaited, as long as patience goes."""
    waits = lockstep and bridge.lockstep and not bridge.answered and sent_s is not None
    until_s = max(next_s, (sent_s or 0.0) + PATIENCE_S) if waits else next_s
    return min(POLL_S, max(0.0, until_s - time.monotonic()))
