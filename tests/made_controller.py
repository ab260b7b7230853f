"""A flight controller for scripts: the documented ArduPilot API as far as the applet may use it, in Lua 5.3.

A call that is not here raises an error in the script. Rows are played one after the other, and what it sent is kept.
"""

from collections.abc import Mapping
from typing import Any

from lupa import lua53

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
  get_accel = function() return w.fz and vector(0, 0, w.fz) end,
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
  local count = 0
  debug.sethook(function() count = count + 100 end, "", 100)
  again = again()
  debug.sethook()
  sent.most = math.max(sent.most, count)
end
function slots_now()
  local found = {}
  for _, slot in ipairs(peek("slots")) do found[slot.name] = {slot.at, slot.ratio, slot.value} end
  return found
end
return w, sent
"""


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
        """A local value of the script."""
        return self._lua.globals().peek(name)

    @property
    def slots(self) -> dict[str, tuple[float, float, float]]:
        """Of each monitor the time of its latest value [ms], its ratio and the value."""
        return {name: tuple(one.values()) for name, one in self._lua.globals().slots_now().items()}

    @property
    def texts(self) -> list[tuple[int, int, str]]:
        """What it said: time [ms], severity, text."""
        return [tuple(one.values()) for one in self.sent.texts.values()]

    @property
    def kilobytes(self) -> float:
        """Memory in use, after a collection."""
        self._lua.execute("collectgarbage()")
        return float(self._lua.eval("collectgarbage('count')"))
