"""The walk in arrays finds what a walk from record to record finds, in any pieces, whatever happened to the file."""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_logs import DATAFLASH_SELF, DataFlashMessage, dataflash
from walked_dataflash import walked

from mavdiag.logs.dataflash_records import Walk

WANTED = ("IMU", "ATT", "EV", "NONE")
IMU = DataFlashMessage(163, "IMU", "QBf", "TimeUS,I,GyrX")
ATT = DataFlashMessage(70, "ATT", "Ih", "TimeMS,Roll")
EV = DataFlashMessage(0x95, "EV", "B", "Id")  # a record of it looks like the end of a header
OTHER = DataFlashMessage(0xA3, "XYZ", "QQ", "TimeUS,A")
AGAIN = DataFlashMessage(71, "IMU", "QBf", "TimeUS,I,GyrX")  # a second type of the same name
LONGER = DataFlashMessage(70, "ATT", "Ihq", "TimeMS,Roll,B")  # another definition of the same type
MESSAGES = (IMU, ATT, EV, OTHER, AGAIN)
SEALED = int.from_bytes(b"\x01\xa3\x95\xa3\x95\x46\xa3\x95", "little")  # headers within a record


def unsound(message: DataFlashMessage, more: int) -> bytes:
    """A definition whose length is not that of its fields."""
    content = bytearray(message.definition())
    content[4] = (content[4] + more) & 0xFF
    return bytes(content)


RECORDS = st.one_of(
    st.builds(IMU.record, st.sampled_from([1, 2, SEALED]), st.integers(0, 2), st.just(0.5)),
    st.builds(ATT.record, st.sampled_from([3, 0xA395A395, 0x46_95_A3_00]), st.just(-1)),
    st.builds(EV.record, st.sampled_from([10, 0xA3, 0x95])),
    st.builds(OTHER.record, st.sampled_from([5, SEALED]), st.sampled_from([6, SEALED])),
    st.builds(AGAIN.record, st.just(7), st.integers(0, 2), st.just(-0.5)),
)
DEFINITIONS = st.one_of(
    st.sampled_from([*(message.definition() for message in (*MESSAGES, LONGER)), DATAFLASH_SELF.definition()]),
    st.sampled_from([message.definition().replace(b"Ih", b"??", 1) for message in (ATT, LONGER)]),  # unknown fields
    st.builds(unsound, st.sampled_from([*MESSAGES, LONGER]), st.integers(-12, 255)),
)
DAMAGE = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([b"\xa3", b"\xa3\x95", b"\xa3\x95\x80", b"\xa3\xa3\x95\xa3", bytes(300), b"\xff" * 40]),
    st.builds(lambda kind: b"\xa3\x95" + bytes([kind]), st.integers(0, 255)),
    st.builds(lambda whole, kept: whole[:kept], st.one_of(RECORDS, DEFINITIONS), st.integers(1, 80)),
)
FILES = st.builds(
    lambda head, pieces: b"".join([dataflash(head, []), *(piece * times for piece, times in pieces)]),
    st.lists(st.sampled_from(MESSAGES), max_size=5, unique=True),
    st.lists(
        st.tuples(st.one_of(RECORDS, RECORDS, DEFINITIONS, DAMAGE), st.sampled_from([1, 1, 3, 40])),
        min_size=10,
        max_size=60,
    ),
)


def cut(data: bytes, sizes: Iterable[int]) -> list[bytes]:
    """The file in pieces of these sizes, and the rest."""
    places = [0, *np.minimum(np.cumsum([0, *sizes]), len(data)).tolist(), len(data)]
    return [data[start:stop] for start, stop in pairwise(places)]


@settings(max_examples=200)
@given(
    data=FILES,
    sizes=st.lists(st.one_of(st.integers(0, 9), st.integers(0, 2000)), max_size=6),
)
def test_the_same_records_and_notes_as_one_by_one(data: bytes, sizes: list[int]) -> None:
    walk = Walk(WANTED)
    for piece in cut(data, sizes):
        walk.feed(piece)
    tables, notes = walk.finish()
    expected, expected_notes = walked(data, WANTED)
    assert notes == expected_notes
    assert list(tables) == list(expected)
    for name, table in tables.items():
        assert table.starts.tolist() == expected[name].starts.tolist()
        assert list(table.fields) == list(expected[name].fields)
        for field, stored in table.fields.items():
            assert stored.tobytes() == expected[name].fields[field].tobytes()
