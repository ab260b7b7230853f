"""Learn from healthy flights and judge two others, all in memory: no files, no link, no clock."""

from mavdiag.judging import judge
from mavdiag.learning import Flight, LearnOptions, learn
from mavdiag.logs import Log
from mavdiag.telemetry import Axis, Series, Signal, Telemetry
from sitl_plant.plant import Plant, PlantConfig


def flown(config: PlantConfig, duration_s: float = 30.0) -> Telemetry:
    """One flight of the emulator, as telemetry."""
    samples = Plant(config).advance(round(1000 * duration_s))
    t_ns = samples.t_ns
    return Telemetry(
        (
            Series(Signal.ATTITUDE_SETPOINT, t_ns, t_ns, samples.setpoint),
            Series(Signal.BODY_RATE, t_ns, t_ns, samples.gyro),
        )
    )


healthy = [
    Flight(f"flight {seed}", f"{seed:064x}", "qdrone2", flown(PlantConfig(drone=1, seed=seed))) for seed in range(6)
]
options = LearnOptions(axes=(Axis.ROLL,), airframe="drone 1")
baseline = learn(healthy, options, created="2026-01-01T00:00:00+00:00")
model = baseline.model_of(Axis.ROLL)
print(f"{model.method} {model.order} explains {100 * model.r2t:.1f} % of the healthy roll rate")

for name, config in {
    "healthy": PlantConfig(drone=1, seed=100),
    "two cracks in propeller 1 from 10 s": PlantConfig(drone=1, seed=100, fault="F2/SV2", rotor=1, onset_s=10.0),
}.items():
    verdict = judge(Log(name, "", "qdrone2", flown(config), 0), baseline)
    first = f", first alarm at {verdict.events[0].t_s:.2f} s" if verdict.events else ""
    print(f"{name}: {verdict.verdict}: {verdict.reason}{first}")
