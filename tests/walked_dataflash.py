"""The records of a DataFlash log, one after the other: what the reader that takes them in arrays is compared with."""

from collections.abc import Collection

import numpy as np

from mavdiag.logs.dataflash_records import FMT_TYPE, HEADER, Format, declared, table_of
from mavdiag.logs.log import Table


def walked(data: bytes, wanted: Collection[str]) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Tables of the wanted messages by name, and what is wrong with the file."""
    formats: dict[int, Format] = {}
    starts: dict[int, list[int]] = {}
    position, sound_end, sound = data.find(HEADER), 0, 0
    while 0 <= position <= len(data) - 3:
        kind = data[position + 2]
        length = 89 if kind == FMT_TYPE else formats[kind].length if kind in formats else 0
        if position + length > len(data):
            break
        sound_end, sound = position + length if length else sound_end, sound + length
        if kind in starts:
            starts[kind].append(position)
        if kind == FMT_TYPE:
            number, found = declared(data, position)
            if number != FMT_TYPE and found.length >= 3 and (number not in formats or not formats[number].sound):
                formats[number] = found
                if found.sound and found.name in wanted:
                    starts[number] = []
        position = data.find(HEADER, position + (length or 1))
    tables: dict[str, Table] = {}
    for kind, at in starts.items():
        form = formats[kind]
        if at and form.name not in tables:
            content = b"".join(data[place : place + form.length] for place in at)
            tables[form.name] = table_of(form, np.array(at), np.frombuffer(content, form.layout()))
    rest = data[sound_end:]
    cut = f"it ends within a record, {len(rest)} bytes are lost: the recording was cut off"
    skipped = f"{sound_end - sound} bytes of it are no records of a known type and were skipped"
    notes = ((skipped, sound_end > sound), (cut, bool(rest.strip(b"\0\xff"))))
    return tables, tuple(note for note, told in notes if told)
