"""Options of the commands: what is refused, in which words, and what a log's signals look like to `inspect`."""

from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from detector.__main__ import app as detector
from mavdiag.cli import app
from mavdiag.look.inspection import summary
from mavdiag.telemetry import Series, Signal
from mavdiag.units import NS_PER_S


def test_r8_the_rate_is_the_mean_rate_and_not_that_of_the_median_step() -> None:
    kept = np.arange(1000) % 4 != 0  # a logger at 250 Hz that drops every fourth sample
    t_ns = (np.arange(1000, dtype=np.int64) * NS_PER_S // 250)[kept]
    found = summary(Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((len(t_ns), 3))))
    assert found.rate_hz == pytest.approx(187.5, rel=0.01)
    one = summary(Series(Signal.BODY_RATE, t_ns[:1], t_ns[:1], np.zeros((1, 3))))
    assert (one.rate_hz, one.jitter_ms, one.longest_gap_s) == (None, None, None)


@pytest.mark.parametrize(
    ("program", "application", "begun", "completed"),
    [
        ("mavdiag", app, "base", {"baseline"}),
        ("mavdiag", app, "baseline ext", {"extend"}),
        ("mavdiag", app, "scan --jud", {"--judged-share"}),
        ("mavdiag-detector", detector, "--jou", {"--journal"}),
    ],
)
def test_a_shell_completes_commands_and_options(
    program: str, application: Any, begun: str, completed: set[str]
) -> None:
    words = f"{program} {begun}"
    asked = {"COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    asked[f"_{program.replace('-', '_').upper()}_COMPLETE"] = "complete_bash"
    answer = CliRunner().invoke(application, [], env=asked, prog_name=program)
    assert set(answer.output.split()) == completed
    assert "--install-completion" in CliRunner().invoke(application, ["--help"]).output
