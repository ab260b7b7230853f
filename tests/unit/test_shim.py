"""The bad link in a box: its figures come out as asked, the same for the same seed, and its limits are told."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from memory_port import memory_pair
from patience import PATIENCE_S

from mavdiag.commands.shim import Passage
from mavdiag.demo.subprocesses import child
from mavdiag.errors import LinkError, UsageError
from mavdiag.link.shim import Impairment, Shim

MS = 1_000_000
COUNT = 20_000


def passed(
    impairment: Impairment, seed: int = 1, every_ms: int = 1, looks_ms: int = 1
) -> tuple[Shim, list[tuple[int, int]]]:
    """(when, number) of what comes out of numbered messages, one every so often."""
    shim, found = Shim(impairment, seed), []
    for ms in range(COUNT * every_ms + 3000):
        if ms % every_ms == 0 and ms < COUNT * every_ms:
            shim.offer((ms // every_ms).to_bytes(4, "little"), ms * MS)
        if ms % looks_ms == 0:
            found += [(ms, int.from_bytes(data, "little")) for data in shim.due(ms * MS)]
    return shim, found


def test_loss_duplicates_and_corruption_are_as_often_as_asked() -> None:
    shim, found = passed(Impairment(loss=0.05, duplicate=0.01, corrupt=0.02))
    count = shim.count
    assert count.lost / COUNT == pytest.approx(0.05, abs=0.006)
    assert count.duplicated / COUNT == pytest.approx(0.01, abs=0.003)
    assert count.corrupted / COUNT == pytest.approx(0.02, abs=0.004)
    assert count.passed == len(found) == COUNT - count.lost + count.duplicated
    wrong = sum(number != ms for ms, number in found)
    assert count.corrupted <= wrong <= count.corrupted + 20  # second copies as well
    assert count.reordered == 0


@pytest.mark.parametrize("depth", [1, 8])
def test_a_message_is_overtaken_by_no_more_than_asked(depth: int) -> None:
    shim, found = passed(Impairment(reorder=depth))
    numbers = [number for _, number in found]
    assert sorted(numbers) == list(range(COUNT))
    overtaken = [sum(later > number for later in numbers[:at][-20:]) for at, number in enumerate(numbers)]
    assert max(overtaken) == depth
    assert shim.count.reordered == sum(one > 0 for one in overtaken)


def test_a_slow_line_carries_what_it_can_and_throws_the_rest_away() -> None:
    shim, found = passed(Impairment(rate=2000.0))  # 4 bytes a message: half of what comes
    assert len(found) == pytest.approx(COUNT / 2, rel=0.06)
    assert shim.count.overflowed == COUNT - len(found)
    assert max(ms - number for ms, number in found) <= 1003


def test_a_passage_that_was_held_up_goes_by_when_messages_arrived() -> None:
    arrived = [0]
    vehicle, near = memory_pair(clock=lambda: arrived.pop(0) if len(arrived) > 1 else arrived[0])
    far, daemon = memory_pair()
    way = Passage(near, far, Shim(Impairment(jitter_s=0.010), 1))
    for k in range(500):
        vehicle.send(k.to_bytes(4, "little"))
    arrived[:] = [k * 100 * MS for k in range(500)]  # so none overtakes another
    way.step(60_000 * MS)
    assert [int.from_bytes(data, "little") for data, _ in daemon.receive(0.0)] == list(range(500))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Impairment(loss=5.0), "--loss 5: write a probability from 0 to 1"),
        (lambda: Impairment(duplicate=float("nan")), "--duplicate nan"),
        (lambda: Impairment(jitter_s=-0.001), "--jitter -1: write milliseconds"),
        (lambda: Impairment(reorder=-1), "--reorder -1"),
        (lambda: Impairment(rate=0.0), "--rate 0: write bytes a second"),
    ],
)
def test_impossible_values_are_refused_by_name(make: Callable[[], Impairment], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        make()


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "made_program.py").write_text(
        "import sys, time\n"
        "print('first line', flush=True)\n"
        "for _ in range(int(sys.argv[1])):\n"
        "    time.sleep(0.1); print('tick', flush=True)\n"
        "print('last line', flush=True)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    return "made_program"


@pytest.mark.realtime
def test_b15_a_process_that_died_is_not_waited_for_and_a_timeout_is_of_the_whole_wait(module: str) -> None:
    with child(module, "0") as one:
        assert one.wait_for("last", PATIENCE_S) == "last line"
        begun = time.monotonic()
        with pytest.raises(LinkError, match="made_program stopped: last line"):
            one.wait_for("ready", 10 * PATIENCE_S)
        assert time.monotonic() - begun < PATIENCE_S
    with child(module, "1000") as one:
        one.wait_for("first", PATIENCE_S)
        with pytest.raises(LinkError, match="did not get ready: tick"):
            one.wait_for("ready", 1.0)
