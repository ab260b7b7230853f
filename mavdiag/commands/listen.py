"""Listen to a live link for a while, as if it were a log (edge: it reads the clock)."""

import time

from mavdiag.errors import InputError
from mavdiag.link.codec import Decoder, Frame
from mavdiag.link.ports import Endpoint, open_endpoint, wait
from mavdiag.link.profiles import PROFILES, detect_profile
from mavdiag.link.samples import by_vehicle
from mavdiag.link.vehicles import VehicleStream
from mavdiag.telemetry import Log, Signal

__all__ = ["UNKNOWN", "listen"]

POLL_S = 0.05
UNKNOWN = "unknown"  # instead of a profile
OF_THE_IMU = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE)  # their unit is known with the profile only


def listen(address: str, duration_s: float, vehicle: int | None) -> Log:
    """All that one vehicle sends within `duration_s`; profile `UNKNOWN`, and why, if its messages do not tell it.

    Raises InputError if no vehicle sends, or several do and none was chosen.
    """
    with open_endpoint(address) as endpoint:
        sent = by_vehicle(_frames(endpoint, duration_s))
    ids = ", ".join(map(str, sorted(sent)))
    if not sent:
        raise InputError(f"{address}: nothing arrived in {duration_s:g} s; does the vehicle send to this address?")
    if vehicle is None and len(sent) > 1:
        raise InputError(f"{address}: the system ids {ids} send; choose one with --vehicle")
    sysid = next(iter(sent)) if vehicle is None else vehicle
    if sysid not in sent:
        raise InputError(f"{address}: nothing arrived from system id {sysid}, only from {ids}")
    found = detect_profile(sent[sysid])
    signals = [signal for signal in Signal if found.profile is not None or signal not in OF_THE_IMU]
    stream = VehicleStream(found.profile or PROFILES["ardupilot"], signals)
    name, notes = (UNKNOWN, (found.reason,)) if found.profile is None else (found.profile.name, ())
    return Log(f"{address} system {sysid}", "", name, stream.step(sent[sysid]), notes=notes)


def _frames(endpoint: Endpoint, duration_s: float) -> list[Frame]:
    decoder = Decoder()
    decode = decoder.feed_datagram if endpoint.address.startswith("udp") else decoder.feed
    frames: list[Frame] = []
    until = time.monotonic() + duration_s
    while (left := until - time.monotonic()) > 0:
        wait([endpoint], min(left, POLL_S))
        for data, host_ns in endpoint.receive(0):
            frames += decode(data, host_ns)
    return frames
