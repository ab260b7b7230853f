"""The commands that put the plant under an autopilot outside, and their loops (edge).

They receive, fly and answer, until a signal or the duration ends it.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, get_args

import typer
from typer import Option

from mavdiag import commandline
from mavdiag.commands.progress import working
from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder
from mavdiag.link.ports import Endpoint, Kind, open_endpoint, parse_address
from sitl_plant.hil.ardupilot import Lockstep
from sitl_plant.hil.px4 import WANTED, Bridge
from sitl_plant.hil.simulation import (
    FLYING_M,
    AutopilotName,
    HilPlan,
    OutputMap,
    Simulation,
    output_map,
    parameter_file,
)
from sitl_plant.options import (
    STARTING,
    W20,
    Drone,
    FaultCode,
    Onset,
    PayloadKg,
    Phenomenology,
    TruthFile,
    VehicleName,
    Wind,
    check_times,
    parse_speed,
    with_options,
)
from sitl_plant.physics.airframe import Payload
from sitl_plant.physics.faults import fault_injection
from sitl_plant.plant import PlantConfig
from sitl_plant.truth import Truth, truth_file
from sitl_plant.vehicle import Vehicle, vehicle_from

POLL_S = 0.2  # how often a signal is looked for
PATIENCE_S = 1.0  # wall clock: a sensor message that was not answered for so long is followed by the next (our choice)
_PRINTED = "Print the parameter file to load into the autopilot, and end."
SLIP_S = 0.1  # wall clock: what is later than this is not caught up


class OnsetFrom(StrEnum):
    """From when --onset counts."""

    TAKEOFF = "takeoff"
    START = "start"


@dataclass(frozen=True, slots=True)
class HilOptions:
    """What the commands share. duration_s: infinite if it was left open. fault: what is told of it, empty for none."""

    plan: HilPlan
    vehicle: Vehicle
    duration_s: float
    truth: Path | None
    fault: str
    rotor: int
    parameters_of: AutopilotName | None

    @contextmanager
    def simulation(self, name: str, rate_hz: float) -> Iterator[Simulation]:
        """The simulation, with its truth file open. name, rate_hz: of the link, for the truth file."""
        with truth_file(self.truth) as lines:
            with working(STARTING):
                simulation = Simulation(self.plan, Truth(self.plan.config, name, rate_hz, None, lines).write)
            yield simulation

    def announce(self, autopilot: str, address: str, outputs: OutputMap) -> None:
        """One line: who may connect where, and what will happen."""
        what, later = "healthy", self.plan.after_takeoff
        if self.fault:
            when = (
                f"{later[0].onset_s:g} s after the take-off"
                if later
                else f"{self.plan.config.onset_s:g} s after the start"
            )
            what = f"{self.fault} on rotor {self.rotor} (motor {outputs.motor(self.rotor)}) {when}"
        typer.echo(f"{self.vehicle.name} stands ready, {what}; waiting for {autopilot} on {address}")


def hil_options(
    vehicle: VehicleName = "qdrone2",
    drone: Drone = 1,
    fault: FaultCode = None,
    rotor: Annotated[int, Option(help="Damaged rotor, as the vehicle's file counts.")] = 1,
    onset: Onset = 0.0,
    onset_from: Annotated[
        OnsetFrom, Option(help=f"Count --onset from the first {FLYING_M:g} m of height, or from the start.")
    ] = OnsetFrom.TAKEOFF,
    phenomenology: Phenomenology = 1.0,
    wind: Wind = 0.0,
    turbulence: W20 = 0.0,
    payload: PayloadKg = 0.0,
    seed: Annotated[int, Option(help="Equal seeds and equal commands give equal flights.")] = 0,
    duration: Annotated[
        float | None, Option(metavar="S", help="End after so much flight time.  [default: run until stopped]")
    ] = None,
    truth: TruthFile = None,
    print_parameters: Annotated[
        str | None,
        Option(metavar="ardupilot|px4", help=_PRINTED),
    ] = None,
) -> HilOptions:
    """Check the options and put them together. Raises UsageError for what cannot be flown."""
    check_times(fault, onset, duration)
    wanted = next((name for name in get_args(AutopilotName) if name == print_parameters), None)
    if wanted != print_parameters:
        raise UsageError(f"no parameters for {print_parameters!r}: give ardupilot or px4")
    kind, from_start = vehicle_from(vehicle), onset_from is OnsetFrom.START
    later = () if fault is None or from_start else (fault_injection(fault, rotor, onset, phenomenology),)
    if not 1 <= rotor <= len(kind.rotors):
        raise UsageError(f"rotor must be 1 to {len(kind.rotors)}, not {rotor}")
    config = PlantConfig(
        vehicle=kind,
        drone=drone,
        start="ground",
        trajectory="hover",
        fault=fault if from_start else None,
        rotor=rotor,
        onset_s=onset if from_start else 0.0,
        phenomenology=phenomenology,
        wind_m_s=wind,
        turbulence_m_s=turbulence,
        payload=Payload(payload),
        seed=seed,
    )
    span = math.inf if duration is None else duration
    return HilOptions(HilPlan(config, later), kind, span, truth, fault or "", rotor, wanted)


def _say(line: str) -> None:
    typer.echo(line, err=True)


@with_options(hil_options)
def serve_ardupilot(
    options: HilOptions,
    listen: Annotated[
        str, Option(metavar="udpin:HOST:PORT", help="Where ArduPilot (--model JSON:HOST) sends its frames.")
    ] = "udpin:127.0.0.1:9002",
) -> None:
    """Be the JSON physics of ArduPilot, until the duration is over, SIGINT or SIGTERM. Exit code 0, or 2 for an error.

    Rotors and outputs are those of the table [hil] of the vehicle's file.
    """
    if options.parameters_of:
        typer.echo(parameter_file(options.vehicle, options.parameters_of), nl=False)
        return
    outputs = output_map(options.vehicle, "ardupilot")
    if parse_address(listen).kind is not Kind.UDP_IN:
        raise UsageError(f"{listen}: the autopilot sends to a UDP port: write udpin:HOST:PORT")
    with ExitStack() as stack:
        port = stack.enter_context(open_endpoint(listen))
        simulation = stack.enter_context(options.simulation("ardupilot-json", 1000.0))
        stop = stack.enter_context(commandline.stop_signals())
        lockstep = Lockstep(simulation, outputs)
        options.announce("ArduPilot", port.address, outputs)
        started_s = time.monotonic()
        serve_json(port, lockstep, simulation, duration_s=options.duration_s, stop=stop, say=_say)
    counts, took_s = lockstep.counts, time.monotonic() - started_s
    typer.echo(
        f"{simulation.t_s:.1f} s flown in {took_s:.1f} s; {counts.frames} frames ({counts.frames / took_s:.0f}/s), "
        f"{counts.resent} answered again, {counts.restarts} restarts of the autopilot, "
        f"{counts.foreign} foreign datagrams, {counts.ignored} of a replaced autopilot"
    )


Rate = Annotated[float, Option(metavar="HZ", min=50.0, max=1000.0, help="Rate of HIL_SENSOR.")]


@with_options(hil_options)
def serve_px4(
    options: HilOptions,
    listen: Annotated[
        str, Option(metavar="tcpin:HOST:PORT", help="Where PX4 in simulation connects to.")
    ] = "tcpin:127.0.0.1:4560",
    rate: Rate = 250.0,
    speed: Annotated[str, Option(metavar="X|max", help="Flight seconds a second, if PX4 keeps step.")] = "1",
) -> None:
    """Be the simulator of PX4, until the duration is over, SIGINT or SIGTERM. Exit code 0, or 2 for an error.

    PX4 and the plant wait for each other, if PX4 was built so.
    """
    pace = parse_speed(speed)
    _serve_mavlink(options, listen, rate, period_s=1.0 / (rate * pace) if pace else 0.0, hardware=False)


@with_options(hil_options)
def serve_hil(
    options: HilOptions,
    endpoint: Annotated[str, typer.Argument(help="/dev/ttyX,BAUD, or another address of a flight controller.")],
    rate: Rate = 250.0,
) -> None:
    """Be sensors and motors of a PX4 flight controller in HIL mode, in real time. Exit code 0, or 2 for an error."""
    _serve_mavlink(options, endpoint, rate, period_s=1.0 / rate, hardware=True)


def _serve_mavlink(options: HilOptions, address: str, rate_hz: float, *, period_s: float, hardware: bool) -> None:
    if options.parameters_of:
        typer.echo(parameter_file(options.vehicle, options.parameters_of, hardware=hardware), nl=False)
        return
    outputs = output_map(options.vehicle, "px4")
    with ExitStack() as stack:
        endpoint = stack.enter_context(open_endpoint(address))
        simulation = stack.enter_context(options.simulation("px4-hil", rate_hz))
        stop = stack.enter_context(commandline.stop_signals())
        bridge = Bridge(simulation, outputs, rate_hz)
        options.announce("a flight controller" if hardware else "PX4", endpoint.address, outputs)
        started_s = time.monotonic()
        span, lockstep = options.duration_s, not hardware
        serve_frames(endpoint, bridge, period_s=period_s, lockstep=lockstep, duration_s=span, stop=stop, say=_say)
        traffic = endpoint.traffic
    typer.echo(
        f"{simulation.t_s:.1f} s flown in {time.monotonic() - started_s:.1f} s; {bridge.controls} motor commands, "
        f"{traffic.sent} messages sent, {traffic.dropped} dropped, {bridge.restarts} restarts of the autopilot"
    )


def serve_json(
    port: Endpoint,
    lockstep: Lockstep,
    simulation: Simulation,
    *,
    duration_s: float,
    stop: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Answer ArduPilot until `duration_s` of flight or `stop`. say: is told of the first datagram that is no frame."""
    while simulation.t_s < duration_s and not stop():
        for (data, _), peer in zip(port.receive(POLL_S), port.sources, strict=True):
            foreign = lockstep.counts.foreign
            answer = lockstep.feed(data, peer, time.monotonic())
            if answer is not None:
                port.answer(answer, peer)
            elif lockstep.counts.foreign == 1 > foreign:
                say(f"ignored {len(data)} bytes that are no servo frame of ArduPilot, and shall ignore others silently")


def serve_frames(
    endpoint: Endpoint,
    bridge: Bridge,
    *,
    period_s: float,
    lockstep: bool,
    duration_s: float,
    stop: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Fly PX4 over MAVLink until `duration_s` of flight or `stop`.

    period_s: wall clock from one sensor message to the next in lockstep, 0 for as fast as it goes; else real time.
    lockstep: wait for the controls where they ask for it; else say if an autopilot is not in HIL mode.
    """
    decoder, pace, flying, told = Decoder(WANTED), _Pace(), False, False
    feed = decoder.feed_datagram if endpoint.datagrams else decoder.feed
    while bridge.simulation.t_s < duration_s and not stop():
        flying = flying and endpoint.connected
        waits = lockstep and bridge.lockstep and not bridge.answered
        for data, host_ns in endpoint.receive(pace.left_s(waits) if flying else POLL_S):
            for frame in feed(data, host_ns):
                bridge.hear(frame)
        if not flying and endpoint.connected:
            if pace.begun:
                bridge.restart()
            flying = True
            pace.begin()
        if flying and not pace.left_s(lockstep and bridge.lockstep and not bridge.answered):
            for message in bridge.advance():
                endpoint.send(message)
            pace.note_sent(period_s if lockstep and bridge.lockstep else bridge.period_s)
        if not (lockstep or told) and bridge.in_hil is False:
            told = True
            say("the flight controller is not in HIL mode: load the file of --print-parameters px4 and restart it")


class _Pace:
    """When the next sensor message goes out."""

    def __init__(self) -> None:
        self.begun = False
        self._sent_s = self._next_s = 0.0

    def begin(self) -> None:
        """The first goes out now."""
        self.begun = True
        self._sent_s = self._next_s = time.monotonic()

    def left_s(self, waits: bool) -> float:
        """How long until then, at most `POLL_S`. waits: for the answer to the last one, as long as patience goes."""
        until_s = max(self._next_s, self._sent_s + PATIENCE_S) if waits else self._next_s
        return min(POLL_S, max(0.0, until_s - time.monotonic()))

    def note_sent(self, period_s: float) -> None:
        """One has gone out; the next is due after `period_s`."""
        self._sent_s = time.monotonic()
        self._next_s = max(self._next_s + period_s, self._sent_s - SLIP_S)
