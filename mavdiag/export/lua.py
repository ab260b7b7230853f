"""A baseline as an ArduPilot Lua applet: what judges at 20 Hz by what the scripts of a flight controller can read.

`reduced` is the baseline that judges as the applet does: the same equations on the same signals at its rate.
"""

import math
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from mavdiag import __version__, kernel
from mavdiag.airframe import trim as trims
from mavdiag.baseline import Baseline, MonitorEntry, Window
from mavdiag.decision import alarm, kinds
from mavdiag.errors import UsageError
from mavdiag.monitors import monitor_of, rotor_trim, thrust_loss
from mavdiag.monitors.base import FaultKind
from mavdiag.printable import printable
from mavdiag.rows import gate as gates
from mavdiag.rows.conditions import BIN_S
from mavdiag.rows.grid import Grid
from mavdiag.thresholds.envelope import ORDER, limits_of
from mavdiag.units import NS_PER_MS, G

DT_S = 0.05  # between rows: slower ones do not tell lost thrust, and a call costs little (our choice)
WINDOW = Window(samples=5, order=2)  # of rates that no monitor of the applet reads
PROFILES = ("ardupilot", "ardupilot-log")
MOST_MOTORS = 12  # that have a SERVOn_FUNCTION
TABLE_KEY = 151  # of its parameters, 1 to 200; each script of a vehicle needs its own (our choice)
MONITORS = ("vibration_level", "rotor_trim", "thrust_loss")
LEFT_OUT = {  # why; of the others: it needs the gyro at its rate
    "trim_step": "rotor_trim stands for it",
    "rotor_trim": "scripts cannot read the torque commands",
    "control_loss": "scripts cannot read the commanded rates",
    "rotor_speed": "the script only records speeds; `mavdiag scan` judges by the ESC messages of the log",
}


def _runs(entry: MonitorEntry) -> bool:
    return entry.spec.kind in MONITORS and getattr(entry.spec, "source", "actuator") == "actuator"


def reduced(baseline: Baseline) -> Baseline:
    """The baseline that judges as the applet: its monitors alone, on rows of `DT_S`. Raises UsageError without any."""
    kept = tuple(filter(_runs, baseline.monitors))
    if not kept:
        raise UsageError(f"the baseline has none of {', '.join(MONITORS)} that a flight controller can compute")
    link = baseline.link.model_copy(update={"dt_s": DT_S, "grid": Grid.RESAMPLED})
    return baseline.model_copy(update={"monitors": kept, "link": link, "window": WINDOW})


def left_out(baseline: Baseline) -> tuple[str, ...]:
    """What the applet does not judge by, and why."""
    dropped = dict.fromkeys(one.spec.kind for one in baseline.monitors if not _runs(one))
    return tuple(f"{kind}: {LEFT_OUT.get(kind, 'scripts cannot follow a sensor at its rate')}" for kind in dropped)


def applet(baseline: Baseline, table_key: int = TABLE_KEY) -> str:
    """The script. Raises UsageError for another autopilot, or where a flight controller can judge nothing."""
    small, layout = reduced(baseline), baseline.airframe.layout
    if baseline.link.profile not in PROFILES:
        raise UsageError(f"the applet runs on ArduPilot; the baseline is for {baseline.link.profile!r}")
    if layout is not None and layout.rotors > MOST_MOTORS:
        raise UsageError(f"scripts read the outputs of {MOST_MOTORS} motors, not of {layout.rotors}")
    monitors = [monitor_of(entry.spec) for entry in small.monitors]
    arms = [] if layout is None else sorted((rotor, arm) for arm in layout.arms for rotor in arm.members)
    loader, spans_s = PackageLoader("mavdiag.export", "."), (gates.QUIET_S, gates.BACK_S, gates.LOUD_S)
    made = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, finalize=literal)
    template = made.get_template("propeller.lua")
    look_ms = kernel.LOOK_NS // NS_PER_MS
    spans_ms = alarm.CLEAR_NS // NS_PER_MS, kernel.STALE_LOOKS * look_ms
    upset_from = kinds.DOUBTFUL_FROM[FaultKind.GROSS_LOSS]
    return template.render(
        version=f"mavdiag {__version__}",
        baseline=baseline,
        arms=[arm for _, arm in arms],
        gate=small.link.gate,
        key=table_key,
        envelope={str(one): limits[:3] for one, limits in zip(ORDER, limits_of(small.envelope), strict=True)},
        entries={entry.spec.kind: entry for entry in small.monitors},
        units={one.name: one.unit for one in monitors},
        par={one.name: one.begin(DT_S).par.tolist() for one in monitors},
        evidence={one.name: one.evidence for one in monitors},
        loss=thrust_loss,
        trims=trims,
        turning=rotor_trim.TURN_TRIM,
        gravity=G,
        infinity=math.inf,
        bin_ms=round(1000 * BIN_S),
        look_ms=look_ms,
        decision=(kernel.CALM_BELOW, *spans_ms, kinds.NAME_AT, upset_from, kinds.SILENT_BELOW),
        impact=(gates.IMPACT, *(round(1000 * span_s) for span_s in (gates.IMPACT_S, gates.USUAL_S, gates.KNOWN_S))),
        quiet=(gates.QUIET_RAD_S, *(round(span_s * 1000) for span_s in spans_s)),
    )


def literal(value: Any) -> str:
    """A value as Lua writes it: a text in plain ASCII, a number, a sequence as a table.

    >>> print(literal((1.0, -np.inf, [0.5, "a"])))
    {1, -math.huge, {0.5, "a"}}
    """
    if isinstance(value, str):
        return '"' + printable(value).encode("ascii", "replace").decode().replace("\\", "/").replace('"', "'") + '"'
    if isinstance(value, tuple | list | np.ndarray):
        return "{" + ", ".join(map(literal, value)) + "}"
    if not np.isfinite(value):
        return f"{'-' if value < 0 else ''}math.huge"
    return repr(int(value) if value == int(value) else float(value))
