"""Hear a live link for a while, as if it were a log (edge: it reads the clock)."""

import time

from mavdiag.errors import InputError
from mavdiag.link.codec import Decoder, Frame
from mavdiag.link.ports import Endpoint, open_endpoint, wait
from mavdiag.link.profiles import PROFILES, detect_profile
from mavdiag.link.samples import Converter, SampleState, by_vehicle
from mavdiag.logs import Log

__all__ = ["hear"]

POLL_S = 0.05


def hear(address: str, duration_s: float, vehicle: int | None) -> Log:
    """Everything that one vehicle says within `duration_s`. Raises InputError if none, or several, can be heard."""
    with open_endpoint(address) as endpoint:
        frames = _frames(endpoint, duration_s)
    spoken = by_vehicle(frames)
    if not spoken:
        raise InputError(f"{address}: nothing heard in {duration_s:g} s; is the vehicle sending to this address?")
    if vehicle is None and len(spoken) > 1:
        raise InputError(f"{address}: system ids {', '.join(map(str, sorted(spoken)))} speak; choose with --vehicle")
    sysid = next(iter(spoken)) if vehicle is None else vehicle
    if sysid not in spoken:
        raise InputError(f"{address}: system id {sysid} was not heard, only {', '.join(map(str, sorted(spoken)))}")
    profile = detect_profile(spoken[sysid])
    _, telemetry = Converter(PROFILES[profile]).step(SampleState(), spoken[sysid])
    return Log(f"{address} system {sysid}", "", profile, telemetry, 0)


def _frames(endpoint: Endpoint, duration_s: float) -> list[Frame]:
    decoder = Decoder()
    frames: list[Frame] = []
    until = time.monotonic() + duration_s
    while (left := until - time.monotonic()) > 0:
        wait([endpoint], min(left, POLL_S))
        for data, host_ns in endpoint.receive(0):
            frames += decoder.feed(data, host_ns)
    return frames
