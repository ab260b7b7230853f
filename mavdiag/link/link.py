"""A live link as an iterator (edge: it opens a port and reads the clock).

with open_link("udpin:127.0.0.1:14550", vehicle=1) as link:
    for telemetry in link:
        print(telemetry)
"""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace

from mavdiag.errors import InputError, UsageError
from mavdiag.link.datagrams import Datagrams
from mavdiag.link.ports import Endpoint, open_endpoint
from mavdiag.link.profiles import Profile, profile_named
from mavdiag.link.samples import joined
from mavdiag.link.sequence import LinkCount
from mavdiag.link.signing import Signing, stamp_at
from mavdiag.link.vehicles import Ack, LinkDecoder, VehicleStream
from mavdiag.telemetry import Log, Telemetry

POLL_S = 0.04
SILENT_NOTE = "it sends no message with a measurement; let it send ATTITUDE_TARGET and an IMU message"
SILENT_ADVICE = "is the vehicle sending to this address? Some send only to who spoke first: try `mavdiag inspect --ask`"
PATIENCE_S = 5.0  # how long a vehicle without a clear profile is waited for (our choice)


def open_link(
    address: str,
    vehicle: int | None = None,
    profile: str | None = None,
    key: bytes | None = None,
    passed: list[tuple[bytes, int]] | None = None,
) -> "Link":
    """Open one end of a link (see `mavdiag.link.ports`) and follow one vehicle on it.

    vehicle: its system id; None takes the only one there is. profile: name of its link profile; None finds it by what
    it sends. key: of MAVLink 2 signing, 32 bytes: only what is signed with it is heard. passed: as in `Decoder`.
    Raises UsageError for a malformed address or an unknown profile, LinkError for a port that cannot be opened.
    """
    if vehicle is not None and vehicle not in range(1, 256):
        raise UsageError(f"vehicle must be a system id, 1 to 255, not {vehicle!r}")
    chosen = None if profile is None else profile_named(profile)
    signing = None if key is None else Signing(key, stamp=stamp_at(time.time_ns()))
    return Link(open_endpoint(address), vehicle, chosen, signing, passed)


class Link(AbstractContextManager["Link"]):
    """One vehicle on a live link. It iterates what came since the last time, for as long as it is open.

    endpoint: an open port; it is closed with the link. acks: what the autopilot answered to our commands so far.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        vehicle: int | None = None,
        profile: Profile | None = None,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
    ) -> None:
        self._endpoint, self._vehicle, self.signing = endpoint, vehicle, signing
        self.address, self.close, self.acks = endpoint.address, endpoint.close, tuple[Ack, ...]()
        self._decoder = LinkDecoder(profile, vehicle, endpoint.datagrams, signing=signing, passed=passed)

    @property
    def vehicle(self) -> int | None:
        """System id of the vehicle; None before it has entered."""
        return self._vehicle if self._vehicle in self._decoder.vehicles else None

    @property
    def stream(self) -> VehicleStream | None:
        """The vehicle's profile and clock; None before it has entered."""
        return None if self._vehicle is None else self._decoder.vehicles.get(self._vehicle)

    def __iter__(self) -> Iterator[Telemetry]:
        """What the vehicle sends, as it comes, without end; nothing while it is silent.

        Raises InputError if there are several vehicles and none was named, or if the vehicle's profile stays unclear.
        """
        began = time.monotonic()
        while True:
            telemetry = self.poll(POLL_S)
            if telemetry.series:
                yield telemetry
            elif self.stream is None and time.monotonic() - began > PATIENCE_S and self._decoder.waiting:
                raise InputError(self.absent)

    def poll(self, timeout_s: float) -> Telemetry:
        """What came since the last time, after waiting up to `timeout_s`; empty if nothing did.

        Raises InputError if there are several vehicles and none was named.
        """
        return self.take(self._endpoint.receive(timeout_s), time.monotonic_ns())

    def take(self, some: Datagrams, now_ns: int) -> Telemetry:
        """What the vehicle sent of what the other end brought. Raises InputError as `poll`."""
        received = self._decoder.feed(some, now_ns)
        known = sorted(self._decoder.vehicles)
        if self._vehicle is None and known:
            if len(known) > 1:
                names = ", ".join(map(str, known))
                raise InputError(f"{self.address}: there are the vehicles {names}; choose one with --vehicle")
            self._vehicle = known[0]
        found = None if self._vehicle is None else received.get(self._vehicle)
        if found is None:
            return Telemetry()
        self.acks += found.acks
        return found.telemetry

    def send(self, frames: Iterable[bytes]) -> None:
        """Send frames to the other end."""
        for frame in frames:
            self._endpoint.send(frame)

    @property
    def count(self) -> LinkCount | None:
        """What came from the vehicle's autopilot so far, by message, and what was lost; None before it has entered."""
        return None if self._vehicle is None else self._decoder.count(self._vehicle)

    def record(self, duration_s: float, each: Callable[[], None] = lambda: None) -> Log:
        """All that the vehicle sends in so much time. Raises InputError, saying why, if that is nothing.

        each: is called every few hundredths of a second.
        """
        pieces: list[Telemetry] = []
        until = time.monotonic() + duration_s
        while (left := until - time.monotonic()) > 0:
            each()
            pieces.append(self.poll(min(left, POLL_S)))
        telemetry = joined(pieces)
        if self.stream is None:
            raise InputError(self.absent)
        notes = () if telemetry.series else (SILENT_NOTE,)
        name, stream = f"{self.address} vehicle {self._vehicle}", self.stream
        log = Log(name, "", stream.profile.name, telemetry, notes=notes, parameters=stream.parameters)
        return replace(log, mav_type=stream.mav_type)

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def absent(self) -> str:
        """Why no vehicle has entered, as far as is known."""
        waiting = self._decoder.waiting
        for sysid, reason in waiting.items():
            return f"{self.address}: vehicle {sysid}: {reason}"
        if self._decoder.babble:
            return f"{self.address}: {self._decoder.babble}"
        senders = sorted({sysid for sysid, _ in self._decoder.decoder.senders})
        if self.signing is not None and self.signing.refused:
            refused = ", ".join(f"{count} {cause}" for cause, count in self.signing.refused.items())
            return f"{self.address}: no frame with a valid signature; refused: {refused}; check the key"
        if not senders:
            return self._endpoint.absent or f"{self.address}: nothing was received; {SILENT_ADVICE}"
        names = ", ".join(map(str, senders))
        return f"{self.address}: system ids {names} send, but no autopilot's heartbeat came of the vehicle wanted"
