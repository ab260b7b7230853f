"""The demo's processes and its kept baseline."""

import time
from pathlib import Path

import pytest
from patience import PATIENCE_S

from mavdiag.demo.subprocesses import child
from mavdiag.errors import LinkError


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
