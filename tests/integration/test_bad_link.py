"""Over a bad link the same is declared as over a perfect one, and loss is counted as it was; the long form of this is
benchmarks/bad_link.py. And hostile datagrams beside a genuine vehicle; the long form is fuzz/datagrams.py.
"""

import re
import signal
import subprocess
import sys
import time

import pytest
from made_session import baseline_for
from made_vehicle import RATE_HZ, MadeVehicle
from patience import PATIENCE_S
from virtual_link import heard

from mavdiag.link.ports import open_endpoint
from mavdiag.link.shim import Impairment, Shim
from mavdiag.units import NS_PER_S

BAD = Impairment(loss=0.05, jitter_s=0.010, reorder=3, duplicate=0.01)
ONSET_S, FML_S = 15.0, 0.3


def flight(onset_s: float, seconds: float = 20.0) -> list[tuple[int, bytes]]:
    """Every frame of a flight and when it is sent [ns]."""
    vehicle, frames = MadeVehicle(1), list[tuple[int, bytes]]()
    for k in range(round(seconds * RATE_HZ)):
        vehicle.turning = 0.5 if k >= onset_s * RATE_HZ else 0.0
        frames += [(k * NS_PER_S // RATE_HZ, frame) for frame in vehicle.samples(1)]
    return frames


@pytest.mark.parametrize("seed", [1, 2])
def test_a_fault_is_declared_within_one_fml_of_a_perfect_link(seed: int) -> None:
    frames, shim = flight(ONSET_S), Shim(BAD, seed)
    good, bad = heard(frames, baseline_for()), heard(frames, baseline_for(), shim)
    assert good.declared[0][0] > 5.0 + ONSET_S  # the made vehicle's clock begins at 5 s
    assert bad.declared[0][0] == pytest.approx(good.declared[0][0], abs=FML_S)
    assert bad.judged_s > 0.9 * good.judged_s
    assert bad.count is not None
    assert abs(bad.count.lost - shim.count.lost) <= 0.001 * len(frames)
    assert bad.count.duplicated == pytest.approx(shim.count.duplicated, abs=2)


def test_a_healthy_flight_stays_silent_over_a_bad_link() -> None:
    found = heard(flight(99.0, 40.0), baseline_for(), Shim(BAD, 3))
    assert (found.declared, found.events) == ([], 0)
    assert found.judged_s > 30.0


@pytest.mark.realtime
def test_the_command_passes_messages_both_ways_and_says_what_became_of_them() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as station:
        out = station.address.replace("udpin", "udpout")
        options = ["udpin:127.0.0.1:0", out, "--duplicate", "1", "--delay", "5"]
        child = subprocess.Popen(
            [sys.executable, "-m", "mavdiag", "shim", *options],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert child.stderr is not None
        address = re.search(r"ready: (\S+) to", child.stderr.readline())
        assert address is not None
        with open_endpoint(address[1].replace("udpin", "udpout")) as vehicle:
            vehicle.send(b"one")
            got: list[bytes] = []
            give_up = time.monotonic() + PATIENCE_S
            while len(got) < 2 and time.monotonic() < give_up:
                got += [data for data, _ in station.receive(0.1)]
            station.send(b"back")
            back = [data for data, _ in vehicle.receive(PATIENCE_S)]
        child.send_signal(signal.SIGINT)
        said, _ = child.communicate(timeout=PATIENCE_S)
    assert got == [b"one", b"one"]
    assert back == [b"back"]
    assert child.returncode == 0
    assert "from IN to OUT: 1 offered, 2 passed, 0 lost, 0 overflowed, 1 duplicated" in said
    assert "from OUT to IN: 1 offered, 1 passed" in said
