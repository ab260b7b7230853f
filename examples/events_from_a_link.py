"""Five lines from a live link to its events. The vehicle is the emulator, over UDP on this machine."""

import tempfile
from pathlib import Path

import mavdiag as md
from mavdiag.demo.subprocesses import Child, run_child

with tempfile.TemporaryDirectory() as name:
    record = ("record", "--flights", "3", "--duration", "30", "-o", f"{name}/healthy.tlog")
    run_child("sitl_plant", *record)
    baseline = md.learn(Path(name), airframe="qdrone2")

with md.open_link("udpin:127.0.0.1:0") as link:  # port 0: any that is free
    flight = ("--duration", "30", "--seed", "9", "--fault", "F2/SV2", "--rotor", "3", "--onset", "8")
    with Child("sitl_plant", "run", "--out", link.address.replace("udpin", "udpout"), *flight):
        watch = md.Watch(baseline)
        for telemetry in link:
            for event in watch.step(telemetry):
                print(event)
            if watch.diagnosis.stage == "fault":
                break
print(watch)
