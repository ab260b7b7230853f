"""MAVLink 2 message signing, sans I/O: seals for what goes out, and a check of what comes in.

A signed frame ends with 13 bytes: link id, time stamp (48 bits, 10 us since 2015-01-01), and the first 6 bytes of
SHA-256 over the key, the frame and both; each stream's stamps must rise. As https://mavlink.io/en/guide/message_signing.html,
but a key refuses every unsigned frame. pymavlink's own check keeps a stamp before it has compared the signature.
"""

import hashlib
from collections import Counter
from enum import StrEnum
from hmac import compare_digest

from mavdiag.errors import UsageError

KEY_BYTES = 32
SEAL_BYTES = 13
SIGNED_FLAG = 0x01  # MAVLINK_IFLAG_SIGNED
STALE = 6_000_000  # a new stream's stamp may be so much behind the newest [10 us]: one minute, by the specification
STREAMS_MAX = 4096  # streams that are told apart, so that memory is bounded for holders of the key too (our choice)

_MARKER_V1 = 0xFE
_DIGEST_BYTES = 6
_TICK_NS = 10_000
_EPOCH_NS = 1_420_070_400 * 1_000_000_000  # 2015-01-01 UTC, in Unix time
_HIGHEST = (1 << 48) - 1


class Refusal(StrEnum):
    """Why a frame was refused."""

    UNSIGNED = "unsigned"
    MAVLINK_1 = "MAVLink 1, which has no signature"
    FORGED = "signature wrong"
    REPLAYED = "time stamp not above the stream's last"
    STALE = "new stream, time stamp over a minute old"


def stamp_at(unix_ns: int) -> int:
    """Unix time [ns] as a time stamp [10 us since 2015-01-01], within its 48 bits."""
    return min(max(0, unix_ns - _EPOCH_NS) // _TICK_NS, _HIGHEST)


class Signing:
    """One holder of a key (32 bytes), for all frames that it sends, with this link id, and receives.

    stamp: the newest time stamp, sent or accepted [10 us]; nothing older is sent any more.
    refused: frames that were not genuine so far, by the cause.
    """

    def __init__(self, key: bytes, *, link_id: int = 0, stamp: int = 0) -> None:
        if len(key) != KEY_BYTES or not 0 <= link_id <= 255:
            raise UsageError(f"a signing key has {KEY_BYTES} bytes and a link id is 0 to 255")
        self._keyed = hashlib.sha256(key)
        self._link_id = link_id.to_bytes(1, "little")
        self.stamp = stamp
        self._streams: dict[bytes, int] = {}
        self.refused: Counter[Refusal] = Counter()

    def advance(self, unix_ns: int) -> None:
        """Let the stamp follow the wall clock [ns]; it never goes back."""
        self.stamp = max(self.stamp, stamp_at(unix_ns))

    def seal(self, frame: bytes) -> bytes:
        """The 13 bytes that complete a frame, which has the flag set. Every call takes the next stamp."""
        self.stamp = min(self.stamp + 1, _HIGHEST)
        tail = self._link_id + self.stamp.to_bytes(6, "little")
        return tail + self._digest(frame + tail)

    def genuine(self, frame: bytes) -> bool:
        """Whether a received frame, whole and with its checksum right, is signed with the key; else it is counted."""
        if frame[0] == _MARKER_V1:
            return self._refuse(Refusal.MAVLINK_1)
        if not frame[2] & SIGNED_FLAG:
            return self._refuse(Refusal.UNSIGNED)
        if not compare_digest(self._digest(frame[:-_DIGEST_BYTES]), frame[-_DIGEST_BYTES:]):
            return self._refuse(Refusal.FORGED)
        return True

    def fresh(self, frame: bytes) -> bool:
        """Whether a genuine frame is new, and then its stamp is kept; else it is counted."""
        stream, stamp = frame[5:7] + frame[-SEAL_BYTES:][:1], int.from_bytes(frame[-12:-6], "little")
        last = self._streams.get(stream)
        if last is not None and stamp <= last:
            return self._refuse(Refusal.REPLAYED)
        if last is None and (stamp + STALE < self.stamp or len(self._streams) >= STREAMS_MAX):
            return self._refuse(Refusal.STALE)
        self._streams[stream] = stamp
        self.stamp = max(self.stamp, stamp)
        return True

    def _digest(self, data: bytes) -> bytes:
        hashing = self._keyed.copy()
        hashing.update(data)
        return hashing.digest()[:_DIGEST_BYTES]

    def _refuse(self, why: Refusal) -> bool:
        self.refused[why] += 1
        return False
