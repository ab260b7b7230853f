"""The applet for the flight controller, in Lua 5.3, judges as mavdiag does by the same monitors, and costs little."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying
from lupa import lua53
from made_rows import changed
from made_telemetry import changed as altered
from shared_data import shared
from typer.testing import CliRunner

import mavdiag as md
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.baseline import Baseline, Link, MonitorEntry, Provenance, SourceLog
from mavdiag.chain import chain_of
from mavdiag.cli import app
from mavdiag.decision.alarm import DecisionState
from mavdiag.decision.diagnosis import Change
from mavdiag.errors import MavdiagError, UsageError
from mavdiag.export.lua import DT_S, WINDOW, applet
from mavdiag.kernel import AT, LOOK_NS, RATIO, READ, Looked
from mavdiag.logs import between
from mavdiag.monitors import by_name, monitor_of
from mavdiag.monitors.base import FaultKind, LearnContext
from mavdiag.monitors.conditions import covered_by
from mavdiag.monitors.rotor_speed import RotorSpeedSpec
from mavdiag.monitors.trim_step import TrimStepSpec
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.block import Block
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import Signal, Telemetry
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import threshold_of
from mavdiag.units import NS_PER_MS

API = """
local w, sent = {params = {}, rpm = {}, slots = 1}, {texts = {}, floats = {}, logs = {}, saved = 0, most = 0}
local function vector(x, y, z)
  return x and {x = function() return x end, y = function() return y end, z = function() return z end,
    length = function() return math.sqrt(x * x + y * y + z * z) end} or nil
end
function millis() return {toint = function() return w.ms end} end
arming = {is_armed = function() return w.armed end, get_aux_auth_id = function() return w.slots > 0 and 0 or nil end,
  set_aux_auth_failed = function(_, id, why) sent.refused = why end,
  set_aux_auth_passed = function(_, id) sent.refused = false end}
vehicle = {get_control_output = function(_, which) return which == 3 and w.thrust or nil end}
ahrs = {get_gyro = function() return vector(w.p, w.q, w.r) end,
  get_accel = function() return w.fz and vector(w.fx or 0, w.fy or 0, w.fz) end,
  get_vibration = function() return vector(w.vx, w.vy, w.vz) end, get_roll = function() return w.roll end,
  get_pitch = function() return w.pitch end, get_relative_position_D_home = function() return w.down end}
local function channel(f) return f <= 40 and f - 33 or f - 74 end
SRV_Channels = {get_output_pwm = function(_, f) return w["o" .. channel(f)] end,
  find_channel = function(_, f) return channel(f) end}
gcs = {send_text = function(_, severity, text) sent.texts[#sent.texts + 1] = {w.ms, severity, text} end,
  send_named_float = function(_, name, value) assert(#name <= 10) sent.floats[name] = value end}
logger = {write = function(_, name, labels, format, ...)
  local _, commas = labels:gsub(",", "")
  assert(#name <= 4 and #labels <= 58 and #format == commas + 1 and select("#", ...) == #format, name)
  sent.logs[name] = {...}
end}
local prefix
param = {add_table = function(_, key, name, count) prefix = name return not w.taken end,
  add_param = function(_, key, number, name, default)
    w.params[prefix .. name] = w.params[prefix .. name] or default
    return true
  end}
function Parameter()
  local name
  return {init = function(_, wanted) name = wanted return w.params[name] ~= nil end,
    get = function() return w.params[name] end,
    set_and_save = function(_, value) w.params[name], sent.saved = value, sent.saved + 1 return true end}
end
local again, held
local function look_for(f, seen) -- what is local to the script, by the functions that read it
  for i = 1, 255 do
    local name, value = debug.getupvalue(f, i)
    if name == nil then break end
    if held[name] == nil then held[name] = {f, i} end
    if type(value) == "function" and not seen[value] and debug.getinfo(value, "S").what == "Lua" then
      seen[value] = true
      look_for(value, seen)
    end
  end
end
function start(script, escs)
  if escs then esc_telem = {get_rpm = function(_, number) return w.rpm[number] end} end
  again, held = assert(load(script))(), {}
  look_for(again, {})
end
function peek(name) return select(2, debug.getupvalue(held[name][1], held[name][2])) end
function run()
  local count, decide = 0, peek("decide")
  looks = {}
  debug.sethook(function(event)
    if event == "count" then count = count + 100
    elseif debug.getinfo(2, "f").func == decide then
      for _, slot in ipairs(peek("slots")) do looks[#looks + 1] = {slot.name, slot.at, slot.ratio, slot.value} end
    end
  end, "r", 100)
  again = again()
  debug.sethook()
  sent.most = math.max(sent.most, count)
end
return w, sent
"""
FLOAT32 = 1e-4  # relative: what a flight controller's single precision may change
GATE = GateSpec(min_thrust=0.1, trim_start_s=5.0, trim_end_s=0.6)
TURN = np.where(np.arange(6000) % 2000 < 1000, 0.6, -0.6)  # of the nose, to and fro [rad/s]
NAMES = ("vibration_level", "rotor_trim", "thrust_loss")


class Controller:
    """It runs one script, 20 times a second. sent: texts, named values, logs, and what the arming check says."""

    def __init__(self, script: str, *, escs: bool = False, params: Mapping[str, float] | None = None, **world: Any):
        self._lua = lua53.LuaRuntime()
        self.world, self.sent = self._lua.execute(API)
        for name, value in {"ms": 1000, **world}.items():
            self.world[name] = value
        for name, value in (params or {}).items():
            self.world.params[name] = value
        self._lua.globals().start(script, escs)
        self._run = self._lua.globals().run

    def play(self, ms: int, row: Mapping[str, float | bool | str | None]) -> None:
        """One call, at a time [ms], with what the API tells then."""
        self.world.ms = ms
        for name, value in row.items():
            self.world[name] = value
        self._run()

    def held(self, name: str) -> Any:
        return self._lua.globals().peek(name)

    @property
    def looks(self) -> list[tuple[str, float, float, float]]:
        """Of each look of the last call and each monitor the time of its latest value [ms], its ratio and the value."""
        return [tuple(one.values()) for one in self._lua.globals().looks.values()]

    @property
    def texts(self) -> list[tuple[int, int, str]]:
        return [tuple(one.values()) for one in self.sent.texts.values()]

    @property
    def kilobytes(self) -> float:
        self._lua.execute("collectgarbage()")
        return float(self._lua.eval("collectgarbage('count')"))


def told(telemetry: Telemetry) -> Telemetry:
    """What scripts can read: the attitude in place of the commanded one; stamps on whole milliseconds at first."""
    gyro, attitude = telemetry.need(Signal.BODY_RATE), telemetry.get(Signal.ATTITUDE)
    odd_ns = int(gyro.t_ns.min()) % NS_PER_MS
    kept = [one for one in telemetry.series if one.signal is not Signal.ATTITUDE_SETPOINT]
    kept += [] if attitude is None else [replace(attitude, signal=Signal.ATTITUDE_SETPOINT)]
    return Telemetry(tuple(replace(one, t_ns=one.t_ns - odd_ns) for one in kept))


def pieces(front: Front, telemetry: Telemetry) -> Iterator[Rows | Border]:
    for part in front.step(front.start(), telemetry):  # what waits at the end of a log waits on
        if isinstance(part, Rows):
            setpoint = part.block.setpoint.copy()
            setpoint[:, 2] = np.nan
            part = replace(part, block=changed(part.block, setpoint=setpoint))
        yield part


def baseline_of(telemetry: Telemetry, layout: RotorLayout, gate: GateSpec, outputs: tuple[int, ...] | None) -> Baseline:
    """The applet's monitors fitted to one healthy flight, at its rate; thresholds from its own values."""
    airframe, align = Airframe(name="recorded", layout=layout, outputs=outputs), AlignSpec(DT_S, Grid.RESAMPLED)
    if outputs is not None:
        align = replace(align, takes={Signal.ACTUATOR: [one - 1 for one in outputs]})
    front = Front(align, gate, RateSpec.of(DT_S, WINDOW.samples))
    rows = [part for part in pieces(front, told(telemetry)) if isinstance(part, Rows) and len(part.block)]
    entries = []
    for name in NAMES:
        try:
            (spec,) = by_name(name).fit([rows], LearnContext(airframe, None, DT_S, WINDOW.samples))
        except MavdiagError:
            continue
        found = [one.value[one.valid] for one in monitor_of(spec).over(rows)]
        scores = Scores(np.array([float(np.concatenate(found).max())]), np.array([10.0]), np.array([0]))
        entries.append(MonitorEntry(spec=spec, threshold=threshold_of(scores, sessions=[0], prior=by_name(name).prior)))
    return Baseline(
        airframe=airframe,
        link=Link(profile="ardupilot", dt_s=DT_S, grid=Grid.RESAMPLED, max_gap_s=align.max_gap_s, gate=gate),
        window=WINDOW,
        monitors=tuple(entries),
        not_judgeable=(),
        envelope=covered_by([rows]),
        healthy_hours=0.1,
        provenance=Provenance(logs=(SourceLog(name="a", sha256="", judged_s=60.0),), created="2026-01-01", tool="test"),
    )


@dataclass
class Judged:
    """What one way of judging made of a flight: ratio and value by monitor and time [ms]; stage, rotor and kind."""

    values: dict[tuple[str, int], tuple[float, float]] = field(default_factory=dict)
    stages: list[tuple[str, int | None, bool]] = field(default_factory=list)

    def stage(self, name: str, rotor: int | None, gross: bool) -> None:
        name, gross = str(name).replace("not judged", "none"), gross and name == "fault"
        now = (name, None if rotor is None else int(rotor), gross)
        if self.stages[-1:] != [now]:
            self.stages.append(now)


def by_python(baseline: Baseline, telemetry: Telemetry) -> Judged:
    chain, found = chain_of(baseline), Judged(stages=[("none", None, False)])
    memory, state = chain.kernel.start(), DecisionState()

    def note(looked: Looked, changes: Sequence[Change]) -> None:
        for number, readings in enumerate(looked.readings):
            look = looked.first + number if looked.end_ns is None else looked.end_ns / LOOK_NS
            for slot, reading in zip(chain.slots, readings.tolist(), strict=True):
                if reading[AT] == look:
                    found.values[slot.key[0], round(look * LOOK_NS / NS_PER_MS)] = reading[RATIO], reading[READ]
        for change in changes:
            found.stage(change.stage, change.rotor, change.kind is FaultKind.GROSS_LOSS)

    for part in pieces(chain.front, telemetry):
        if isinstance(part, Border):
            left, ended = chain.kernel.close(memory, part.t_ns), chain.kernel.open_alarms(memory, ended=True)
            state, _, changes = chain.decision.end_segment(state, left, ended, part.t_ns, flies=not part.landed)
            chain.kernel.restart(memory)
            note(left, changes)
            found.stage(state.diagnosis.stage, state.diagnosis.rotor, False)
        elif len(part.block):
            looked, _ = chain.kernel.step(memory, part)
            state, _, changes = chain.decision.step(state, looked)
            note(looked, changes)
    return found


def by_applet(baseline: Baseline, telemetry: Telemetry) -> tuple[Judged, Controller]:
    chain, found, controller = chain_of(baseline), Judged(stages=[("none", None, False)]), Controller(applet(baseline))
    align = chain.front.align
    for block in align.step(align.start(), telemetry):
        for ms, row in rows_of(block, baseline):
            controller.play(ms, row)
            for name, at, ratio, value in controller.looks:
                if at > 0:
                    found.values[name, round(at)] = ratio, value
            found.stage(controller.held("stage"), controller.held("rotor"), controller.held("gross"))
    return found, controller


def rows_of(block: Block, baseline: Baseline) -> Iterator[tuple[int, dict[str, float | bool | None]]]:
    """What the API tells at each row: nil where the row does not know."""
    lean = block.setpoint[:, :2].copy()
    lean[~block.setpoint_valid] = np.nan
    rate = np.where(block.valid[:, None], block.rate, np.nan)
    columns = (rate, block.force, block.vibration, block.thrust[:, None], lean, -block.height[:, None])
    names = ["p", "q", "r", "fx", "fy", "fz", "vx", "vy", "vz", "thrust", "roll", "pitch", "down"]
    table = np.concatenate((*columns, 1000.0 + 1000.0 * block.actuator), axis=1).tolist()
    names += [f"o{j}" for j in range(block.actuator.shape[1])]
    armed = ~(block.armed < 0.5) | (not baseline.link.gate.need_armed)
    for t_ns, row, flies in zip(block.t_ns.tolist(), table, armed.tolist(), strict=True):
        values = {name: None if math.isnan(value) else value for name, value in zip(names, row, strict=True)}
        yield round(t_ns / NS_PER_MS), {**values, "armed": flies}


def unbroken(telemetry: Telemetry) -> Telemetry:
    """Its longest part without a break of the gyro."""
    t_ns = np.unique(telemetry.need(Signal.BODY_RATE).t_ns)
    edges = np.concatenate(([0], np.flatnonzero(np.diff(t_ns) > 0.9e9) + 1, [len(t_ns)]))
    longest = int(np.argmax(np.diff(t_ns[np.append(edges[:-1], len(t_ns) - 1)])))
    stop = t_ns[edges[longest + 1] - 1]
    return between(telemetry, float(t_ns[edges[longest]]) / 1e9 - 1e-6, float(stop) / 1e9 + 1e-6)


def both(baseline: Baseline, telemetry: Telemetry) -> tuple[Judged, Controller]:
    """Judge both ways, and hold one against the other."""
    telemetry = told(unbroken(telemetry))
    wanted, (found, controller) = by_python(baseline, telemetry), by_applet(baseline, telemetry)
    assert set(wanted.values) == set(found.values)
    for key, figures in wanted.values.items():
        assert found.values[key] == pytest.approx(figures, rel=FLOAT32, abs=1e-9), key
    assert found.stages == wanted.stages
    assert controller.sent.most <= 10_000  # 20,000 at 10 Hz
    texts = controller.texts
    assert all(len(text) <= 50 and text.startswith("PROP") and "script" not in text for _, _, text in texts)
    assert all(later[0] - sooner[0] >= 2000 for sooner, later in pairwise(texts))
    return found, controller


@cache
def made(name: str = "x", rise: float = 0.03) -> Baseline:
    """Of a healthy made flight; its rotors have inertia, and such a rise is a fault."""
    base = baseline_of(flying(6000, 1, layout=name, turn=TURN), layout_named(name), GATE, None)
    vibration, trim, loss = base.monitors
    low = replace(vibration.threshold, suspected=(0.6, 0.6)), replace(trim.threshold, value=rise, session_allowance=0)
    heavy = replace(trim.spec, turn=(*trim.spec.turn[:2], 0.01))
    changed = vibration.model_copy(update={"threshold": low[0]}), MonitorEntry(spec=heavy, threshold=low[1])
    return base.model_copy(update={"monitors": (*changed, loss)})


@pytest.mark.parametrize(("layout", "motor"), [("x", "3"), ("octo-x", "3"), ("y6", "2/3")])
def test_a_healthy_flight_is_quiet_and_each_monitor_finds_its_fault(layout: str, motor: str) -> None:
    base = made(layout)
    assert [entry.spec.kind for entry in base.monitors] == list(NAMES)
    found, healthy = both(base, flying(6000, 2, layout=layout, turn=TURN))
    assert [stage for stage, *_ in found.stages] == ["none", "quiet"]
    assert {name for name, _ in found.values} == set(NAMES)
    assert healthy.texts[0][2].startswith("PROP watching")
    found, weak = both(base, flying(6000, 3, layout=layout, weak_rotor=3, rise=0.3, turn=TURN))
    assert found.stages[-1] == ("fault", int(motor[0]), False)
    assert any(f"motor {motor} lost" in text for _, _, text in weak.texts)
    found, shaken = both(base, flying(6000, 4, layout=layout, shake=3.0))
    assert found.stages[-1] == ("fault", None, False)
    assert any(text.startswith("PROP FAULT rotor unknown: vibrates") for _, _, text in shaken.texts)


def test_little_evidence_names_no_rotor() -> None:
    assert both(made(), flying(6000, 4, shake=0.5))[0].stages[-1] == ("suspected", None, False)
    found, _ = both(made(rise=0.01), flying(6000, 3, weak_rotor=3, rise=0.012, turn=TURN))
    assert found.stages[-1] == ("fault", None, False)


def falling(seed: int) -> Telemetry:
    """Half of the thrust is lost at 30 s and the vehicle rolls; then it lands, and flies again."""
    weak = altered(flying(9000, seed), Signal.SPECIFIC_FORCE, lambda force: force * [1.0, 1.0, 0.4], 30.0, 31.0)
    rolling = altered(weak, Signal.BODY_RATE, lambda rate: np.add(rate, (-4.0, 4.0, 0.0)), 30.0, 31.0)
    return altered(rolling, Signal.THRUST_SETPOINT, lambda _: 0.0, 50.0, 55.0)


def test_lost_thrust_is_latched_forbids_arming_and_waits_for_somebody_who_looks() -> None:
    base = made()
    found, controller = both(base, falling(5))
    assert [stage for stage, *_ in found.stages] == ["none", "quiet", "fault", "inspect"]
    texts = [text for _, _, text in controller.texts]
    assert any(text.startswith("PROP THRUST LOST motor") for text in texts)
    assert any(text.endswith("inspect before flight") for text in texts)
    motor = controller.world.params["PROP_OPEN"]
    assert motor in (1, 2, 3, 4)
    again = Controller(applet(base), params={"PROP_OPEN": motor}, armed=False)  # after a restart
    for ms in range(2000, 6000, 50):
        again.play(ms, {})
    assert again.sent.refused == f"PROP inspect motor {motor:g}, PROP_OPEN=0"
    again.world.params["PROP_ARM"] = 0
    again.play(7000, {})
    assert again.sent.refused is False
    again.world.params["PROP_ARM"] = 1
    again.play(8000, {})
    again.world.params["PROP_OPEN"] = 0
    again.play(9000, {})
    assert again.sent.refused is False
    assert again.held("stage") == "none"


def test_nothing_that_is_missing_hurts_and_memory_does_not_grow() -> None:
    bare = Controller(applet(made()), slots=0, armed=True)
    for ms in range(2000, 20_000, 50):
        bare.play(ms, {"thrust": 0.5})
    assert bare.held("stage") == "none"
    assert [text for _, _, text in bare.texts] == ["PROP cannot forbid arming: no slot is free"]
    one, sizes = Controller(applet(made()), escs=True, armed=True), []
    rng = np.random.default_rng(6)
    for j in range(4):
        one.world.rpm[j] = 5000.0 + j
    for minute in range(3):
        for ms in range(60_000 * minute + 2000, 60_000 * minute + 62_000, 50):
            p, q, r, *outputs = rng.normal(0.0, 0.05, 7).tolist()
            named = {f"o{j}": 1500.0 + 100.0 * value for j, value in enumerate(outputs)}
            shaken = {"vx": abs(p), "vy": abs(q), "vz": abs(r)}
            one.play(ms, {"p": p, "q": q, "r": r, "thrust": 0.5, "fz": -9.81, "roll": p, "pitch": q, **named, **shaken})
        sizes.append(one.kilobytes)
    assert sizes[2] - sizes[1] < 1.0
    assert list(one.sent.logs["PRPM"].values()) == [5000.0, 5001.0, 5002.0, 5003.0]
    assert set(one.sent.floats) == {"PF_EVID", "PF_VIB", "PF_TRIM", "PF_LOSS"}


def test_the_command_writes_the_script_and_says_what_it_leaves_out(tmp_path: Path) -> None:
    path, script, trim = tmp_path / "b.json", tmp_path / "propeller.lua", made().monitors[1]
    step = TrimStepSpec(layout=layout_named("x"), source="actuator", spread=trim.spec.spread)
    none = ((0.0, 0.0),) * 4
    speed = RotorSpeedSpec(layout=layout_named("x"), mean=(0.0,) * 4, about=none, errors=none[:2], spread=0.01)
    more = (trim.model_copy(update={"spec": spec}) for spec in (step, speed))
    base = made().model_copy(update={"monitors": (*made().monitors, *more)})
    base.save(path)
    run = CliRunner().invoke(app, ["export", "--lua", str(path), "-o", str(script), "--table-key", "77"])
    assert run.exit_code == 0, run.output
    text = script.read_text()
    assert base.provenance.created in text
    assert "add_table(77" in text
    assert Baseline.load(path).digest in text
    assert "left out   trim_step: rotor_trim stands for it" in run.output
    assert "left out   rotor_speed: the script only records speeds" in run.output
    other = base.model_copy(update={"link": base.link.model_copy(update={"profile": "px4"})})
    with pytest.raises(UsageError, match="ArduPilot"):
        applet(other)


RECORDED = (
    ("arducopter_sitl/healthy_quad3kg_sq1.tlog", "arducopter_sitl/*quad3kg*.tlog"),
    ("arducopter_sitl/jsonplant_flight.bin", "arducopter_sitl/*.bin"),
    ("autopilots_in_the_loop/ap463_hil_healthy.tlog", "autopilots_in_the_loop/ap463*.tlog"),
    ("autopilots_in_the_loop/px4_hil_healthy.tlog", "autopilots_in_the_loop/px4*.tlog"),
    ("ardupilot_real/log171.bin", "ardupilot_real/*.bin"),
)


@pytest.mark.parametrize(("healthy", "judged"), RECORDED)
def test_recorded_flights_are_judged_alike(healthy: str, judged: str) -> None:
    folder = shared("data")
    base = baseline_of(md.read_log(folder / healthy).telemetry, layout_named("x"), GATE, None)
    paths = sorted(folder.glob(judged))
    for path in {paths[0], paths[-1]}:
        found, _ = both(base, md.read_log(path).telemetry)
        assert found.values
