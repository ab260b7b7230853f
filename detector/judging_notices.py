"""What is said once: doubts about a baseline's rotor layout or the IMU, names that no monitor has, another vehicle."""

from collections.abc import Iterable

from detector.alerts import Kind, Notice
from detector.streams import Streams
from detector.values import Note
from mavdiag.airframe.fingerprint import Outcome
from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainOutput
from mavdiag.link.codec import message_name
from mavdiag.link.profiles import LAST_RESORT, Profile
from mavdiag.monitors import NEED_LAYOUT

__all__ = ["imu_notes", "layout_notices", "notes_on", "vehicle_notices"]


def vehicle_notices(output: ChainOutput) -> list[Notice]:
    """What is said, once, of a vehicle that is another than the baseline's."""
    far = output.likeness is not None and output.likeness.outcome is Outcome.FAR
    return [Notice(Kind.OTHER_VEHICLE)] if far else []


def layout_notices(baseline: Baseline) -> list[Notice]:
    """What is said, once for each baseline, of a rotor layout that is unknown or that its flights contradict."""
    if not baseline.layout_doubt:
        return []
    if baseline.airframe.layout is not None:
        return [Notice(Kind.OTHER_LAYOUT, (baseline.airframe.layout.name,))]
    lost = sum(one.monitor in NEED_LAYOUT for one in baseline.not_judgeable)
    return [Notice(Kind.NO_LAYOUT, (str(lost),))]


def notes_on(baseline: Baseline, chain: Chain, suspect: Iterable[str]) -> list[Note]:
    """What the journal gets as judging begins: doubts about the rotor layout, and the names in `suspect` that no
    monitor of the chain has."""
    doubts = [Note(baseline.layout_doubt)] if baseline.layout_doubt else []
    return doubts + _unknown_suspects(chain, suspect)


def imu_notes(read: Profile, own: Profile, before: Streams, after: Streams) -> list[Note]:
    """What the journal gets, once for a link, of a gyro that another message carries, or of a scale that is wrong.

    read: the profile with the IMU message that is read. own: the link's profile. before, after: the latest look.
    """
    notes: list[Note] = []
    if after.gyro.samples and not before.gyro.samples and read.imu != own.imu:
        name = message_name(read.imu)
        poor = ": the estimator's rates, filtered, at a low rate and without accelerometer" * (read.imu == LAST_RESORT)
        notes.append(Note(f"the gyro is read from {name}, for {message_name(own.imu)} does not come{poor}"))
    if after.scale_doubt and not before.scale_doubt:
        notes.append(
            Note(f"the vehicle does not feel 1 g by the scale of the profile {own.name}, but {after.scale_doubt}")
        )
    return notes


def _unknown_suspects(chain: Chain, suspect: Iterable[str]) -> list[Note]:
    monitors = [slot.monitor for slot in chain.slots]
    known = {name for monitor in monitors for name in (monitor.name, f"{monitor.name}.{monitor.axis}")}
    return [Note(f"suspect: the baseline has no monitor {name!r}") for name in suspect if name not in known]
