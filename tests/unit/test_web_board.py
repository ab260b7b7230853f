"""What the live page's server keeps: entries are numbered, none is given twice or left out, and nothing grows."""

import json

from hypothesis import given
from hypothesis import strategies as st

from detector.web.board import BATCH, FIRST, KEPT, Board, Reader, parse_last


def filled(count: int, run: str = "r") -> Board:
    board = Board(run)
    for number in range(1, count + 1):
        board.take(f"J {number} {number}")
    return board


def events(data: bytes) -> list[dict[str, str]]:
    """Server-sent events as a browser reads them (WHATWG HTML, 9.2.6)."""
    return [dict(line.split(": ", 1) for line in block.split("\n")) for block in data.decode().split("\n\n")[:-1]]


def numbers(data: bytes) -> list[int]:
    return [int(one["id"].split("-")[1]) for one in events(data) if one["event"] == "entry"]


def drained(reader: Reader) -> list[int]:
    found: list[int] = []
    while data := reader.next():
        found += numbers(data)
    return found


@given(st.lists(st.tuples(st.integers(0, 1500), st.booleans()), max_size=12))
def test_a_page_that_comes_and_goes_gets_every_entry_once(steps: list[tuple[int, bool]]) -> None:
    board, got, total = Board("r"), list[int](), 0
    reader = board.enter(None, 0)
    for count, leaves in steps:
        for _ in range(count):
            total += 1
            board.take(f"J {total} {{}}")
        got += numbers(reader.next())
        if leaves:
            board.readers.discard(reader)
            reader = board.enter(None, parse_last(f"r-{got[-1] if got else 0}", "r"))
    got += drained(reader)
    assert got == list(range(1, total + 1))


def test_a_replay_that_jumps_begins_anew_for_every_page() -> None:
    board = filled(20)
    reader = board.enter(1, None)
    reader.next()
    for line in ('P {"at_s": 3}', "N 1 old", "C r-1", "A 1 {}", "J 1 {}", "N 1 {}"):
        board.take(line)
    found = events(reader.next())
    assert [one["event"] for one in found] == ["hello", "about", "now", "entry"]
    assert json.loads(found[0]["data"]) == {"run": "r-1", "newest": 0, "fresh": True}
    assert found[-1]["id"] == "r-1-1"
    again = [one["event"] for one in events(board.enter(1, parse_last("r-20", board.run)).next())]
    assert again == ["hello", "playing", "about", "now", "entry"]


def test_a_new_page_gets_the_latest_entries_and_one_that_was_away_for_long_all_that_are_kept() -> None:
    board = filled(KEPT + 300)
    new = board.enter(None, None)
    assert drained(new) == list(range(KEPT + 301 - FIRST, KEPT + 301))
    away = board.enter(None, 100)
    hello = json.loads(events(away.next())[0]["data"])
    assert hello == {"run": "r", "newest": KEPT + 300, "fresh": False}
    assert drained(board.enter(None, 100)) == list(range(301, KEPT + 301))
    assert len(board.entries) == KEPT
    assert len(numbers(board.enter(None, 0).next())) == BATCH


def test_figures_go_to_those_who_look_at_the_vehicle_and_a_slow_page_loses_the_oldest() -> None:
    board = Board("r")
    one, other = board.enter(1, None), board.enter(2, None)
    assert board.watched == (1, 2)
    for reader in (one, other):
        reader.next()
    board.take('A 1 {"drawing":1}')
    for k in range(1000):
        board.take(f"N 1 {k}")
    assert other.next() == b""
    kept = [int(event["data"]) for event in events(one.next()) if event["event"] == "now"]
    assert kept == list(range(1000 - len(kept), 1000))
    assert 100 <= len(kept) <= 300
    late = events(board.enter(1, None).next())
    assert [event["event"] for event in late[:2]] == ["hello", "about"]
    assert late[-1]["data"] == "999"
