"""What is said once of a baseline: doubts about its rotor layout, names that no monitor has, another vehicle."""

from collections.abc import Iterable

from detector.alerts import Kind, Notice
from detector.values import Note
from mavdiag.airframe.fingerprint import Outcome
from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainOutput
from mavdiag.monitors import NEED_LAYOUT

__all__ = ["layout_notices", "notes_on", "vehicle_notices"]


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


def _unknown_suspects(chain: Chain, suspect: Iterable[str]) -> list[Note]:
    monitors = [slot.monitor for slot in chain.slots]
    known = {name for monitor in monitors for name in (monitor.name, f"{monitor.name}.{monitor.axis}")}
    return [Note(f"suspect: the baseline has no monitor {name!r}") for name in suspect if name not in known]
