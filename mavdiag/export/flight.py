"""A judged flight as time series for other tools: a table over time, or an MCAP file.

Each topic has a time and named figures: the signals ("body_rate": roll, pitch, yaw); of each axis with a model
"model/roll" (commanded, measured, simulated rate, residual, margin [rad/s], FSD and FML [s]); of each monitor
"monitor/rotor_trim" (value, threshold, ratio, 1 where it judged, and evidence of each rotor). The decision's changes
are texts, in MCAP as `foxglove.Log`. MCAP's messages are JSON with a JSON Schema, which Foxglove and PlotJuggler read.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.errors import InputError, check_installed
from mavdiag.judging import JudgedFlight
from mavdiag.storage import replacing
from mavdiag.telemetry import FloatArray, IntArray, Log
from mavdiag.traces import rate_traces, slot_traces
from mavdiag.units import NS_PER_S

_NUMBER = {"type": ["number", "null"]}
_TEXT, _WHOLE = {"type": "string"}, {"type": "integer"}
_TIME = {"type": "object", "properties": {"sec": _WHOLE, "nsec": _WHOLE}}
LOG_SCHEMA = {"timestamp": _TIME, "level": _WHOLE, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _WHOLE}
LEVELS = {Stage.SUSPECTED: 3, Stage.FAULT: 4, Stage.INSPECT: 3}  # of foxglove.Log: 2 info, 3 warning, 4 error


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """Figures over time. t_ns: (n,) vehicle clock. values: (n, k)."""

    name: str
    names: tuple[str, ...]
    t_ns: IntArray
    values: FloatArray


def topics_of(log: Log, judged: JudgedFlight | None = None) -> Iterator[Topic]:
    """The signals of a log; if it was judged in full, then what its models and its monitors said."""
    for series in log.telemetry:
        known = np.flatnonzero(np.isfinite(series.values).any(axis=0))
        names = series.signal.names(series.values.shape[1])
        if len(known):
            yield Topic(series.signal, tuple(names[at] for at in known), series.t_ns, series.values[:, known])
    if judged is None or judged.chain is None:
        return
    for rate in rate_traces(judged.chain, judged.pieces):
        columns = {name: getattr(rate, name) for name in ("commanded", "measured", "simulated", "residual")}
        columns |= {"margin": rate.margin_rad_s, "fsd_s": rate.fsd_s, "fml_s": rate.fml_s}
        values = np.column_stack(np.broadcast_arrays(*columns.values()))
        yield Topic(f"model/{rate.axis}", tuple(columns), rate.t_ns, values)
    for trace in slot_traces(judged.chain, judged.pieces):
        slot, found = trace.slot, trace.found
        name = "/".join(("monitor", *(part for part in slot.key if part is not None)))
        rotors = found.rotors if found.rotors.ndim == 2 and len(found.rotors) else np.empty((len(found), 0))
        value = np.where(found.valid, found.value, np.nan)
        threshold = np.full(len(value), slot.threshold)
        names = ("value", "threshold", "ratio", "judged", *(f"rotor_{n + 1}" for n in range(rotors.shape[1])))
        values = np.column_stack((value, threshold, value / slot.threshold, found.valid, rotors))
        yield Topic(name, names, found.t_ns, values)


def write_mcap(path: Path, log: Log, topics: Sequence[Topic], changes: Sequence[Change]) -> None:
    """Write an MCAP file, its messages in order of time; of the wall clock where the log knows it.

    Raises UsageError without the library, or if it cannot be written; InputError if no topic has a figure.
    """
    check_installed("MCAP", "mcap", "export")
    from mcap.writer import Writer

    if not any(len(topic.t_ns) for topic in topics):
        raise InputError(f"{log.name}: there is nothing to write; give a log with signals (see `mavdiag look`)")
    t_ns = np.concatenate([topic.t_ns for topic in topics])
    whose = np.repeat(np.arange(len(topics)), [len(topic.t_ns) for topic in topics])
    rows = np.concatenate([np.arange(len(topic.t_ns)) for topic in topics])
    shift_ns = log.epoch_ns or max(0, -int(t_ns.min()))
    with replacing(path) as stream:
        writer = Writer(stream)
        writer.start(library="mavdiag")

        def channel(topic: str, schema: str, properties: dict[str, Any]) -> int:
            content = json.dumps({"type": "object", "properties": properties}).encode()
            return writer.register_channel(f"/{topic}", "json", writer.register_schema(schema, "jsonschema", content))

        def write(number: int, at_ns: int, message: dict[str, Any]) -> None:
            writer.add_message(number, at_ns, json.dumps(message).encode(), at_ns)

        channels = [channel(one.name, f"mavdiag.{one.name}", dict.fromkeys(one.names, _NUMBER)) for one in topics]
        told = channel("log", "foxglove.Log", LOG_SCHEMA)
        for change in changes:
            at_ns = change.t_ns + shift_ns
            stamp = {"sec": at_ns // NS_PER_S, "nsec": at_ns % NS_PER_S}
            text = {"message": str(change), "name": "mavdiag", "file": log.name, "line": 0}
            write(told, at_ns, {"timestamp": stamp, "level": LEVELS.get(change.stage, 2), **text})
        for at in np.argsort(t_ns, kind="stable").tolist():
            topic = topics[whose[at]]
            values = [value if np.isfinite(value) else None for value in topic.values[rows[at]].tolist()]
            write(channels[whose[at]], int(t_ns[at]) + shift_ns, dict(zip(topic.names, values, strict=True)))
        finish: Callable[[], None] = writer.finish
        finish()
