"""A live flight of another vehicle is told once, when 20 s of it are there."""

import itertools
from dataclasses import replace

from flying_telemetry import flying

from detector.judging import records_of
from detector.values import Note
from mavdiag.airframe.fingerprint import Figure, Fingerprint, Outcome
from mavdiag.chain import Chain, ChainOutput, chain_of
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log, Telemetry


def taught() -> Chain:
    logs = [Log(f"{seed}", "", "px4", flying(3000, seed)) for seed in range(2)]
    return chain_of(learn(logs, LearnOptions(), created=""))


def steps(chain: Chain, pieces: int) -> list[ChainOutput]:
    """A flight of 40 s in so many pieces."""
    telemetry, state, out = flying(4000, 9), chain.start(), []
    edges = [round(i * 40e9 / pieces) for i in range(pieces + 1)]
    for low, high in itertools.pairwise(edges):
        state, one = chain.step(state, between(telemetry, low, high))
        out.append(one)
    return out


def between(telemetry: Telemetry, low_ns: int, high_ns: int) -> Telemetry:
    first = min(int(one.t_ns[0]) for one in telemetry.series)
    parts = []
    for one in telemetry.series:
        keep = (one.t_ns - first >= low_ns) & (one.t_ns - first < high_ns)
        parts.append(one.where(keep))
    return Telemetry(tuple(parts))


def test_another_vehicle_is_told_in_a_text_and_with_figures_in_the_journal() -> None:
    chain = taught()
    learnt = chain.baseline.fingerprint
    assert learnt is not None
    figures = tuple(
        Figure(one.name, one.mean + 5.0, 0.01) if one.name.startswith("gyro noise") else one for one in learnt.figures
    )
    other = replace(chain, baseline=chain.baseline.model_copy(update={"fingerprint": Fingerprint(figures, 2)}))
    told = [one for one in steps(other, 40) if one.likeness is not None]
    assert [one.likeness.outcome for one in told if one.likeness] == [Outcome.FAR]
    notes = [one.text for output in told for one in records_of(output, "E8") if isinstance(one, Note)]
    assert len(notes) == 1
    assert notes[0].startswith("does not look like E8: ")
