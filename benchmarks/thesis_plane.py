"""How often the thesis's plane names a simulated fault rightly: `python benchmarks/thesis_plane.py [PHENOMENOLOGY]`.

The fleet protocol of T 4.4: drones 2 and 3 train the roll model, all three set margin and FML, drone 1 flies the nine
faults, each eight times and twice on every rotor. Each flight is classified by a plane of the flights with other seeds.
By default the faults' fitted term is on (1), so the figures are about traces of the published kind. About a minute.
"""

import sys
from collections import Counter

import numpy as np
from thesis_plane_rules import Example, FaultPoint, HealthyScale, classify, fault_point, fit_plane
from thesis_runs import Residual, longest_runs, margin_of, runs

from mavdiag.airframe.propellers import PROPELLERS
from mavdiag.errors import InputError
from mavdiag.identify import ArxModel, fit
from mavdiag.rows.savgol import coefficients, window_samples
from mavdiag.telemetry import FloatArray
from sitl_plant.plant import Plant, PlantConfig

DT = 0.001
STEPS = 32_000  # four rounds of the square
SETTLED = 1000  # rows of the start that are not judged
REPEATS = 8


def rates(config: PlantConfig) -> tuple[FloatArray, FloatArray]:
    """Commanded and measured roll rate of a flight."""
    samples = Plant(config).advance(STEPS)
    value, slope, _ = coefficients(window_samples(DT))
    return np.correlate(samples.setpoint[:, 0], slope / DT, "valid"), np.correlate(samples.gyro[:, 0], value, "valid")


def residual(model: ArxModel, config: PlantConfig) -> Residual:
    """Roll residual of a flight, its first second left out."""
    u, y = rates(config)
    r = (y - model.simulate(u))[SETTLED:]
    return Residual(np.arange(len(r), dtype=np.int64), r, np.ones(len(r), dtype=np.bool_), DT)


def point_of(piece: Residual, scale: HealthyScale) -> FaultPoint | None:
    """The flight's point in the plane, None if it has no run longer than the FML."""
    return fault_point(runs(piece, scale.margin_rad_s), scale)


def fly(phenomenology: float) -> tuple[HealthyScale, list[tuple[int, Example]], int]:
    """The healthy scale, the examples with the repeat they come from, and how many flights did not exceed the FML."""
    training = [rates(PlantConfig(drone=number, seed=100 + number)) for number in (2, 3)]
    model = fit([u for u, _ in training], [y for _, y in training], dt=DT)
    healthy = [
        [residual(model, PlantConfig(drone=number, seed=200 + 10 * repeat + number))]
        for number in (1, 2, 3)
        for repeat in range(3)
    ]
    margin = margin_of(healthy)
    scale = HealthyScale(float(longest_runs(healthy, margin).max()), margin)
    examples, missed = [], 0
    for i, row in enumerate(PROPELLERS):
        for repeat in range(REPEATS):
            seed = 1000 + 10 * i + repeat
            config = PlantConfig(fault=row.code, rotor=1 + repeat % 4, seed=seed, phenomenology=phenomenology)
            point = point_of(residual(model, config), scale)
            if point is None:
                missed += 1
            else:
                examples.append((repeat, Example(point, row.fault_type, row.severity, row.unbalance_g_mm)))
    return scale, examples, missed


def main() -> None:
    """Print the table."""
    phenomenology = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    scale, examples, missed = fly(phenomenology)
    types, severities = Counter[str](), Counter[str]()
    for repeat, example in examples:
        others = [other for others_repeat, other in examples if others_repeat != repeat]
        try:
            found = classify(fit_plane(others), example.point)
        except InputError:
            types["no plane"] += 1
            continue
        if found.fault_type is None:
            types[found.outcome.name.lower()] += 1
        elif found.fault_type is not example.fault_type:
            types["wrong"] += 1
        else:
            types["right"] += 1
            unknown = found.severity is None
            severities["unknown" if unknown else "right" if found.severity == example.severity else "wrong"] += 1
    print(f"phenomenology {phenomenology:g}: margin {scale.margin_rad_s:.4f} rad/s, FML {scale.fml_s:.3f} s")
    print(f"flights {len(examples) + missed}, not longer than the FML {missed}")
    print("type      ", dict(types))
    print("severity  ", dict(severities))


if __name__ == "__main__":
    main()
