"""Texts from the wire and from files, made fit for a terminal: what would steer it is shown, and does nothing."""

import unicodedata

_STEERING = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}  # controls, directions, surrogates, unassigned, line ends


def printable(text: str) -> str:
    r"""The text with every character that could move the cursor, colour, reorder or break a line as its escape.

    >>> printable("\x1b[31mred\nnext line")
    '\\x1b[31mred\\nnext line'
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(repr(one)[1:-1] if unicodedata.category(one) in _STEERING else one for one in text)


def counted(count: int, noun: str) -> str:
    """A count before its noun, which has an s unless it is one."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
