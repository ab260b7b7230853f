"""Where a flight lies among the thesis's classes of faults: T Fig 5.10 and 5.12.

T prints no figures for its classes. The centres here are those of the emulated QDrone 2 with the same nine faults, in
docs/results.md under "The thesis's table" (`python benchmarks/thesis_table.py --trials 10 --phenomenology 1`), so they
hold for that vehicle, and as far as the emulator is right. Unbalances are T Table 3.2's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.airframe.propellers import FaultType, propeller
from mavdiag.drawing import Colour
from mavdiag.report.rates import NO_MODEL, Runs, longest_by_column, runs_of
from mavdiag.report.style import LIMIT, LINES, Picture, drawn, legend_above
from mavdiag.traces import RateTrace, SlotTrace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["CLASSES", "CLASSIFIER", "FaultClass", "plane_picture", "severity_picture", "unbalance_of"]

CLASSIFIER = "qdrone2-emulated"  # the airframes that the classes hold for
MOST_POINTS = 200
NAMES = {
    FaultType.EDGE_CUT: "F1 edge cut",
    FaultType.CRACK: "F2 crack",
    FaultType.SURFACE_UNBALANCE: "F3 surface unbalance",
}
MARKERS = {FaultType.EDGE_CUT: "o", FaultType.CRACK: "^", FaultType.SURFACE_UNBALANCE: "D"}
PLANE = Picture(
    "plane",
    "The flight in the plane of margin and FSD",
    "Small dots are this flight's stretches outside of the margin and the star is the longest of them: left of the "
    "FML (dashed) the thesis's rule is silent.",
    "5.10",
)
SEVERITY = Picture(
    "severity",
    "Residual margin against unbalance, by severity",
    "Each line is one type of fault from severity 1 to 3, the star is this flight: more unbalance moves it to the "
    "right, a rotor whose thrust is unsteady moves it up.",
    "5.12",
)


@dataclass(frozen=True, slots=True)
class FaultClass:
    """One of T's faults on the emulated vehicle, roll axis: mean, and the 5 % and 95 % points of trials.

    fsd_s: longest FSD of a flight [s].
    peak_rad_s: highest |r| above the margin in it [rad/s].
    """

    fault_type: FaultType
    severity: int
    fsd_s: tuple[float, float, float]
    peak_rad_s: tuple[float, float, float]

    @property
    def unbalance_g_mm(self) -> float:
        """Of the propeller (T Table 3.2) [g mm]."""
        return propeller(self.fault_type, self.severity).unbalance_g_mm


CLASSES = (
    FaultClass(FaultType.EDGE_CUT, 1, (0.177, 0.159, 0.197), (0.047, 0.031, 0.061)),
    FaultClass(FaultType.EDGE_CUT, 2, (0.182, 0.167, 0.196), (0.051, 0.040, 0.067)),
    FaultClass(FaultType.EDGE_CUT, 3, (0.186, 0.171, 0.198), (0.051, 0.039, 0.064)),
    FaultClass(FaultType.CRACK, 1, (0.394, 0.375, 0.421), (0.156, 0.128, 0.179)),
    FaultClass(FaultType.CRACK, 2, (0.401, 0.376, 0.422), (0.167, 0.142, 0.195)),
    FaultClass(FaultType.CRACK, 3, (0.405, 0.377, 0.424), (0.172, 0.147, 0.202)),
    FaultClass(FaultType.SURFACE_UNBALANCE, 1, (0.252, 0.213, 0.297), (0.062, 0.045, 0.080)),
    FaultClass(FaultType.SURFACE_UNBALANCE, 2, (0.331, 0.300, 0.366), (0.089, 0.065, 0.122)),
    FaultClass(FaultType.SURFACE_UNBALANCE, 3, (0.387, 0.370, 0.416), (0.142, 0.115, 0.169)),
)


def plane_picture(rates: Sequence[RateTrace], classifier: str | None) -> Picture:
    """The runs of the first modelled axis that judged; classes only for an airframe that they hold for."""
    trace = next((one for one in rates if one.judged.any()), None)
    if trace is None:
        return replace(PLANE, not_drawn=NO_MODEL)
    runs, known = runs_of(trace), classifier == CLASSIFIER
    if not len(runs) and not known:
        return replace(
            PLANE, not_drawn="the residual never left its margin, and no classes are known for this airframe"
        )
    fml_s = trace.fml_s

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        if known:
            _classes(axes)
        _flight(axes, runs)
        axes.axvline(fml_s, color=LIMIT.color, linestyle=LIMIT.stroke, label=f"FML {fml_s:.3f} s")
        axes.set(xlabel=f"FSD, {trace.axis} [s]", ylabel="highest residual above\nthe margin [rad/s]")
        axes.set(xlim=(0.0, None), ylim=(0.0, None))
        legend_above(axes, 3)

    classes = "The class that it lies nearest to is the thesis's answer; the classes are of the emulated QDrone 2."
    none = "No classes are shown, for they are known for the emulated QDrone 2 alone."
    point = f"{runs.fsd_s.max():.3f} s and {_peak(runs):.3f} rad/s" if len(runs) else "none"
    words = f"Longest run of this flight: {point}; FML {fml_s:.3f} s."
    svg = drawn(PLANE.title, words, plot, 3.3)
    return replace(PLANE, caption=f"{PLANE.caption} {classes if known else none}", svg=svg)


def severity_picture(
    rates: Sequence[RateTrace], slots: Sequence[SlotTrace], since_s: float | None, classifier: str | None
) -> Picture:
    """Unbalance and residual of the flight among the classes. since_s: when a fault was declared; None if none was."""
    trace = next((one for one in rates if one.judged.any()), None)
    if trace is None:
        return replace(SEVERITY, not_drawn=NO_MODEL)
    if classifier != CLASSIFIER:
        reason = "its severities are known for the emulated QDrone 2 alone"
        return replace(SEVERITY, not_drawn=reason)
    unbalance = unbalance_of(slots, since_s)
    if unbalance is None:
        return replace(
            SEVERITY, not_drawn="the unbalance of this flight was not measured in g mm: see the table of monitors"
        )
    peak = _peak(runs_of(trace))

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for line, kind in zip(LINES, FaultType, strict=False):
            rows = [one for one in CLASSES if one.fault_type is kind]
            x, y = [one.unbalance_g_mm for one in rows], [one.peak_rad_s[0] for one in rows]
            axes.plot(x, y, MARKERS[kind], color=line.color, linestyle=line.stroke, label=NAMES[kind])
            for one in rows:
                axes.annotate(
                    str(one.severity), (one.unbalance_g_mm, one.peak_rad_s[0]), (4, 4), textcoords="offset points"
                )
        axes.plot(unbalance, peak, "*", color=Colour.REFERENCE, markersize=13, label="this flight")
        axes.set(xlabel="unbalance [g mm]", ylabel="highest residual above\nthe margin [rad/s]")
        axes.set(xlim=(0.0, None), ylim=(0.0, None))
        legend_above(axes, 4)

    words = (
        f"This flight: {unbalance:.2f} g mm beyond the healthy unbalance, residual {peak:.3f} rad/s above the margin."
    )
    return replace(SEVERITY, svg=drawn(SEVERITY.title, words, plot, 3.0))


def unbalance_of(slots: Sequence[SlotTrace], since_s: float | None) -> float | None:
    """Rms of the unbalance beyond the healthy one, since a time or of the flight [g mm]; None if it is not known."""
    for one in slots:
        if one.slot.monitor.name == "unbalance" and one.slot.monitor.unit == "g mm":
            use = one.found.valid & (one.found.t_ns >= (0 if since_s is None else round(since_s * 1e9)))
            if use.any():
                return float(np.sqrt(np.mean(np.square(one.found.level[use]))))
    return None


def _peak(runs: Runs) -> float:
    """Of the longest run [rad/s]; 0 without one."""
    return float(runs.peak_rad_s[runs.fsd_s.argmax()]) if len(runs) else 0.0


def _classes(axes: "Axes") -> None:
    for line, kind in zip(LINES, FaultType, strict=False):
        rows = [one for one in CLASSES if one.fault_type is kind]
        x, y = (np.array([getattr(one, name) for one in rows]) for name in ("fsd_s", "peak_rad_s"))
        axes.errorbar(
            x[:, 0],
            y[:, 0],
            xerr=np.abs(x[:, 1:] - x[:, :1]).T,
            yerr=np.abs(y[:, 1:] - y[:, :1]).T,
            fmt=MARKERS[kind],
            color=line.color,
            elinewidth=0.7,
            label=NAMES[kind],
        )


def _flight(axes: "Axes", runs: Runs) -> None:
    """Its runs, the longest of them as a star."""
    shown = longest_by_column(runs, MOST_POINTS)
    axes.plot(shown.fsd_s, shown.peak_rad_s, ".", color=Colour.NOT_JUDGED, markersize=4, label="runs of this flight")
    if len(runs):
        x, y = float(runs.fsd_s.max()), _peak(runs)
        axes.plot(x, y, "*", color=Colour.REFERENCE, markersize=13, label="longest of this flight")
