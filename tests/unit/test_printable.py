"""Each path by which a text from the wire or a file reaches a terminal, the journal or the metrics is safe."""

from dataclasses import replace

import pytest
from made_session import baseline_for

import detector.__main__ as command
from mavdiag import commandline
from mavdiag.errors import InputError
from mavdiag.printable import printable

EVIL = "\x1b[31mred\x1b]0;title\x07\r\nforged line\x9b2J\u202eleft\u2028end\x00"


def steering(text: str, keep: str = "\n") -> list[str]:
    return [one for one in text if not one.isprintable() and one not in keep]


def test_every_control_character_is_shown_as_its_escape() -> None:
    shown = printable(EVIL)
    assert shown == r"\x1b[31mred\x1b]0;title\x07\r\nforged line\x9b2J\u202eleft\u2028end\x00"
    for number in (*range(32), *range(127, 160), 0x200E, 0x202A, 0x2066, 0xFEFF, 0xD800, 0xE0001):
        assert not steering(printable(chr(number)), keep=""), hex(number)
    assert printable("Größe 5 µs, 3 × „Ω“") == "Größe 5 µs, 3 × „Ω“"
    assert printable("a\nb\r", keep="\n") == "a\nb\\r"


def test_what_daemon_commands_and_baselines_say(capsys: pytest.CaptureFixture[str]) -> None:
    command._say(f"vehicle 1: {EVIL}")
    app = commandline.application("Nothing.")

    @app.command()
    def fail() -> None:
        """Fail."""
        raise InputError(f"{EVIL}.tlog: cannot be read")

    with pytest.raises(SystemExit) as caught:
        commandline.run(app, EVIL)
    assert caught.value.code == 2
    sound = baseline_for()
    evil = sound.model_copy(update={"airframe": replace(sound.airframe, name=EVIL)})
    assert len(str(evil).splitlines()) == len(str(sound).splitlines())
    commandline.say(f"{evil}\nwritten to {EVIL}")
    out, err = capsys.readouterr()
    assert "forged line" in out
    assert "forged line" in err
    assert not steering(out + err)
