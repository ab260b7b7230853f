"""`mavdiag scan --scheduler`: two worker processes on loopback, one of them killed; the pool's answers."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from made_archive import archive_baseline, made
from patience import PATIENCE_S

pytest.importorskip("distributed", reason="Dask is an extra")
from dask_cluster import cluster

COUNT = 30


@pytest.mark.realtime
def test_a_killed_worker_loses_nothing_and_gives_nothing_twice(tmp_path: Path) -> None:
    names = [f"{number:03d}.tlog" for number in range(COUNT)]
    made(tmp_path / "logs", *names, first_seed=300, shaken=names[::7])
    archive_baseline().save(tmp_path / "baseline.json")
    command = [sys.executable, "-m", "mavdiag", "scan", "logs", "--baseline", "baseline.json", "--json"]

    with cluster(2) as (address, processes):
        _, doomed, _ = processes
        told = [*command, "--no-cache", "--scheduler", address]
        with subprocess.Popen(told, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            assert child.stderr is not None
            lines = [child.stdout.readline().rstrip("\n") for _ in range(5)]
            doomed.send_signal(signal.SIGKILL)
            lines += child.stdout.read().splitlines()
            assert child.wait(PATIENCE_S) == 1, child.stderr.read()
        assert doomed.wait(PATIENCE_S) == -signal.SIGKILL
    pool = subprocess.run(
        [*command, "--no-cache", "--jobs", "2"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (pool.returncode, pool.stderr) == (1, "")
    assert lines == pool.stdout.splitlines()
    assert [json.loads(line)["log"] for line in lines] == [f"logs/{name}" for name in names]
    assert sum(json.loads(line)["verdict"] == "fault" for line in lines) == len(names[::7])
