"""A judged flight for other tools: what is written is what was flown and judged, by the tools' own readers."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from flying_telemetry import flying
from made_baselines import whole
from mcap.reader import make_reader
from typer.testing import CliRunner

import mavdiag as md
from mavdiag.cli import app
from mavdiag.export.flight import topics_of, write_mcap
from mavdiag.judging import judge_in_full

ROOT = Path(__file__).resolve().parents[2]
WEAK = md.Log("weak.ulg", "", "px4", flying(3000, 5, weak_rotor=3, rise=0.2), started_ns=1_760_000_000 * 10**9)


def test_mcap_has_every_signal_and_statistic_in_order_of_the_wall_clock(tmp_path: Path) -> None:
    judged = judge_in_full(WEAK, whole())
    topics = list(topics_of(WEAK, judged))
    write_mcap(tmp_path / "x.mcap", WEAK, topics, judged.verdict.changes)
    with (tmp_path / "x.mcap").open("rb") as stream:
        found = [(channel.topic, message) for _, channel, message in make_reader(stream).iter_messages()]
    times = [message.log_time for _, message in found]
    assert times == sorted(times)
    assert times[0] == WEAK.started_ns
    rates = [json.loads(message.data) for topic, message in found if topic == "/body_rate"]
    assert np.array_equal([list(one.values()) for one in rates], WEAK["body_rate"].values)
    assert list(rates[0]) == ["roll", "pitch", "yaw"]
    ratios = [json.loads(message.data)["ratio"] for topic, message in found if topic == "/monitor/rotor_trim"]
    highest = next(one for one in judged.verdict.monitors if one.name == "rotor_trim")
    assert max(one for one in ratios if one is not None) == pytest.approx(highest.ratio)
    texts = [json.loads(message.data) for topic, message in found if topic == "/log"]
    assert [one["level"] for one in texts].count(4) >= 1
    assert any("rotor 3" in one["message"] for one in texts)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_has_each_sample_once(tmp_path: Path, kind: str) -> None:
    log = tmp_path / "flight.csv"
    rate, t_s = WEAK["body_rate"].values, WEAK["body_rate"].t_s
    pd.DataFrame(np.column_stack((t_s, rate)), columns=["t", "p", "q", "r"]).to_csv(log, index=False)
    (tmp_path / "map.toml").write_text('[time]\ncolumn = "t"\n[body_rate]\ncolumns = ["p", "q", "r"]\nunit = "rad/s"\n')
    output = tmp_path / f"out.{kind}"
    arguments = ["export", str(log), f"--{kind}", "--columns", str(tmp_path / "map.toml"), "-o", str(output)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "written to" in result.output
    frame = pd.read_csv(output, index_col="t_s") if kind == "csv" else pd.read_parquet(output)
    assert list(frame.columns) == ["body_rate/roll", "body_rate/pitch", "body_rate/yaw"]
    assert np.allclose(frame.to_numpy(), rate, atol=1e-9)
    assert np.allclose(frame.index, t_s, atol=1e-8)


def test_a_notebook_shows_logs_verdicts_and_baselines_as_tables() -> None:
    verdict = md.judge(WEAK, whole())
    highest = verdict.to_frame()["ratio"].to_dict()
    assert highest["rotor_trim"] == next(one.ratio for one in verdict.monitors if one.name == "rotor_trim") > 1.0
    assert WEAK.to_frame("body_rate").shape == WEAK["body_rate"].values.shape
    rows = {WEAK: len(WEAK.telemetry.series), verdict: len(verdict.monitors), whole(): len(whole().monitors)}
    for value, count in rows.items():
        assert value._repr_html_().count("<tr>") == 1 + count
    assert len(WEAK.plot("body_rate").get_lines()) == 3


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.ipynb")), ids=lambda path: path.stem)
def test_every_notebook_runs(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / path.name
    text = path.read_text()
    slower = text.replace('\\"record\\",', '\\"record\\", \\"--rate\\", \\"200\\",')  # it says the same, sooner
    assert slower != text
    copy.write_text(slower)
    run = [sys.executable, "-m", "jupyter", "execute", "--inplace", copy.name]
    subprocess.run(run, cwd=tmp_path, check=True, timeout=300, capture_output=True)
    outputs = [out for cell in json.loads(copy.read_text())["cells"] for out in cell.get("outputs", ())]
    kinds = {kind for out in outputs for kind in out.get("data", ())}
    assert {"text/html", "image/png"} <= kinds
    assert any("<table>" in "".join(out.get("data", {}).get("text/html", "")) for out in outputs)
