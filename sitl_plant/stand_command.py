"""`sitl-plant stand`: the flight-stand test of T 3.2.3, as a table or as JSON."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from sitl_plant.stand import StandReport, stand_test


def stand(
    rpm: Annotated[float, typer.Option(help="Speed of the rotor; T's peak at 83.3 Hz is 5000 rpm.")] = 5000.0,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal numbers.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Run twelve propellers on an emulated flight stand and estimate their unbalance from the vibration.

    Mass, stiffness and noise of the stand are estimates: the scale is a number of this stand, not of T's.
    """
    report = stand_test(rpm, seed)
    if as_json:
        typer.echo(json.dumps(asdict(report)))
    else:
        _print(report)


def _print(report: StandReport) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"flight stand at {report.speed_rpm:g} rpm, {report.speed_rpm / 60:.1f} Hz")
    for heading in ("propeller", "peak Hz", "x m/s²", "y m/s²", "z m/s²", "weighed g mm", "estimated g mm"):
        table.add_column(heading, justify="right")
    for bar in report.bars:
        axes = (f"{amplitude:.3f}" for amplitude in bar.peak.amplitude_m_s2)
        known, estimated = f"{bar.known_g_mm:.2f}", f"{bar.estimated_g_mm:.2f}"
        table.add_row(bar.name, f"{bar.peak.frequency_hz:.1f}", *axes, known, estimated)
    console = Console()
    console.print(table)
    scale = report.scale
    console.print(
        f"scale {scale.g_mm_per_m_s2:.3f} ± {scale.standard_error:.3f} g mm per m/s² along y, R² {scale.r2:.4f}; "
        "mass and stiffness of the stand are estimates"
    )
