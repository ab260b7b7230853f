"""Five lines from a folder of logs to a verdict. The logs are recorded from the emulator first."""

import tempfile
from pathlib import Path

import mavdiag as md
from mavdiag.demo.subprocesses import run_child

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    flight = ("record", "--duration", "30", "-o")
    run_child("sitl_plant", *flight, str(folder / "healthy.tlog"), "--flights", "5", "--seed", "1")
    run_child("sitl_plant", *flight, str(folder / "cracked.tlog"), "--fault", "F2/SV2", "--rotor", "3", "--onset", "10")

    baseline = md.learn(folder / "healthy-*.tlog", airframe="qdrone2", name="drone 1")
    baseline.save(folder / "drone1.json")
    print(baseline)
    for verdict in md.scan(folder, baseline):
        print(verdict)
