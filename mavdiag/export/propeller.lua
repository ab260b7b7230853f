-- Watches the propellers of one ArduPilot vehicle by a baseline of its healthy flights. It never steers.
-- Made by `mavdiag export --lua` ({{ version }}); docs/flight-controller.md tells its parameters and texts.
-- It holds for this vehicle alone. Do not change it: export it anew.
local B = { -- trims are fractions of hover, by roll, pitch and yaw
  digest = {{ baseline.digest }}, created = {{ baseline.provenance.created }},
  airframe = {{ baseline.airframe.name }},
  arms = {{ arms }}, names = {{ arms | map("string") | list }}, -- first motor on the arm of each; how it is called
  gate = { -- less collective command, 0..1, or height [m] is no flight; not judged after take-off, before landing [ms]
    thrust = {{ gate.min_thrust or 0.0 }}, height = {{ -infinity if gate.min_height_m is none else gate.min_height_m }},
    start = {{ (1000 * gate.trim_start_s) | round }}, stop = {{ (1000 * gate.trim_end_s) | round }},
  },
  -- What was learnt, {from, to, how far beyond it nothing is judged}: [rad], mean of 5 s; 0..1; [rad/s]; [m].
  tilt = {{ envelope.tilt }}, throttle = {{ envelope.throttle }},
  yaw_rate = {{ envelope["yaw rate"] }}, height = {{ envelope.height }},
{% for name, entry in entries.items() %}
  [{{ name }}] = { -- threshold: {{ units[name] }}; from what share of it on a fault is suspected
    threshold = {{ entry.threshold.value }}, suspected = {{ entry.threshold.suspected[0] }},
{% if name != "rotor_trim" %}
    window = {{ par[name][0] }}, -- rows
{% else %}
    parts = {{ par[name][3] }}, rows = {{ par[name][4] }}, window = {{ par[name][6] }}, -- of a tick; of a part; ticks
    mean = {{ entry.spec.mean + entry.spec.about }}, -- of healthy flights, and the pull and yaw rate of these
    spread = {{ entry.spec.spread }},
    turn = {{ entry.spec.turn }}, -- yaw trim by yaw rate [1/(rad/s)], its slope [1/(rad/s^2)], and less by its own [s]
    pull = {{ entry.spec.pull }}, -- roll and pitch trim by pull [1/rad]
    errors = {{ par[name][12:15] }}, days = {{ par[name][30] }}, -- variances: of pull, 9 of turn; of the yaw trim by day
    felt = {{ entry.spec.felt | int }}, turn_trim = {{ turning }}, -- by the accelerometer; of a tick that counts half
    least = {{ trims.MIN_OUTPUT }}, curve = {{ par[name][32] }}, -- mean output, 0..1; of thrust by output
    unmix = {{ entry.spec.layout.unmixing }}, scale = {{ par[name][-1] }}, -- trim by output; of what a rise explains
    weight = {{ evidence[name].weight }}, unit = {{ evidence[name].least }}, -- [logits] by what shows a rotor; unit
{% endif %}
{% if name == "thrust_loss" %}
    per_command = {{ par[name][1] }}, forget = {{ par[name][2] }}, -- upward force by command [m/s^2]; by row
    per_rad_s = {{ loss.PER_RAD_S }}, tumbling = {{ loss.TUMBLING_RAD_S }}, -- share of thrust by body rate; [rad/s]
    cut = {{ loss.CUT }}, least = {{ loss.MIN_THRUST }}, -- most force, of the healthy one; least command
    falls = {{ par[name][3:] }}, weight = {{ evidence[name].weight }}, -- roll and pitch of each rotor's loss; [logits]
{% endif %}
  },
{% endfor %}
}

local STEP, BIN, LOOK, NAN, HUGE = 50, {{ bin_ms }}, {{ look_ms }}, 0.0 / 0.0, math.huge -- ms between rows, bins and decisions
local R, ARMS, MOTORS = #B.arms, B.arms, {33, 34, 35, 36, 37, 38, 39, 40, 82, 83, 84, 85} -- SERVOn_FUNCTION
local max, min, abs = math.max, math.min, math.abs

local function finite(x) return x - x == 0 end
local function filled(count, value, width) -- a list; of lists, if a width is given
  local list = {}
  for i = 1, count do list[i] = width and filled(width, value) or value end
  return list
end

-- Parameters of its own. PROP_OPEN: motor to be inspected, 100 if it is not known; 0 says that somebody has looked.
local PARAM, UNNAMED = {}, 100
assert(param:add_table({{ key }}, "PROP_", 4), "PROP: table key {{ key }} is taken")
for i, one in ipairs({ {"ENABLE", 1}, {"SCALE", 1}, {"ARM", 1}, {"OPEN", 0} }) do
  param:add_param({{ key }}, i, one[1], one[2])
  PARAM[one[1]] = Parameter()
  assert(PARAM[one[1]]:init("PROP_" .. one[1]), "PROP_" .. one[1] .. " is missing")
end
local scale, open = 1.0, PARAM.OPEN:get() or 0
local function keep_open(value)
  if open ~= value then PARAM.OPEN:set_and_save(value) end
  open = value
end

-- Texts, at most one in 2 s. The one that waits gives way to what is as urgent.
local CRITICAL, WARNING, INFO, waiting, severity, said = 2, 4, 6, nil, 6, -2000
local function say(how, text)
  if waiting == nil or how <= severity then waiting, severity = string.sub(text, 1, 50), how end
end

-- Slots: a monitor with its thresholds; the highest ratio since the last decision, and the latest one with its time.
-- rotors: what shows each rotor; of an arm the most of its rotors, at the first one. The others are nan.
local slots = {}
local function slot_of(name)
  local slot = B[name]
  if slot then slot.name, slot.rotors, slots[#slots + 1] = name, filled(R, NAN), slot end
  return slot
end
local vibration, trim, loss = slot_of("vibration_level"), slot_of("rotor_trim"), slot_of("thrust_loss")
local function show(slot, rotor, evidence)
  local arm, shown = ARMS[rotor], slot.rotors
  shown[arm] = arm == rotor and evidence or max(shown[arm], evidence)
end
local function record(slot, value, far) -- returns whether it counts
  if far > 1.0 then return false end
  slot.fresh = value / (1.0 + 0.5 * far)
  local ratio = slot.fresh / (slot.threshold * scale)
  slot.highest = slot.highest and max(slot.highest, ratio) or ratio
  return true
end

-- Conditions of flight in bins of 0.1 s: how far they are from what was learnt, 0 inside, above 1 outside. A bin counts
-- from 0.2 s after its end on, as in mavdiag.
local bins, leans, bin, first_bin = filled(64, 0.0, 0), filled(50, NAN, 2), {}, 0
local function excess(limits, value)
  return max(0.0, max(value - limits[2], limits[1] - value) / limits[3]) -- nan is not known: inside
end
local function close_bin()
  local one, lean, roll, pitch = bins[bin.number % #bins + 1], leans[bin.number % #leans + 1], 0.0, 0.0
  lean[1], lean[2] = bin.roll / bin.leans, bin.pitch / bin.leans
  for i = 1, #leans do roll, pitch = roll + leans[i][1], pitch + leans[i][2] end
  one.stop = (bin.number + 1) * BIN
  one.level = max(excess(B.throttle, bin.thrust / bin.n), excess(B.height, bin.height))
  one.all = max(one.level, excess(B.tilt, math.sqrt(roll * roll + pitch * pitch) / #leans),
    excess(B.yaw_rate, abs(bin.yaw / bin.n)))
  if one.all > 0.0 then bin.beyond = one.stop end
end
local function take_bin(row)
  if bin.number ~= row.t // BIN then
    if bin.number and bin.number >= first_bin then close_bin() end
    bin.number, bin.n, bin.leans, bin.height = row.t // BIN, 0, 0, NAN
    bin.roll, bin.pitch, bin.thrust, bin.yaw = 0.0, 0.0, 0.0, 0.0
  end
  if not row.valid then return end
  local known = finite(row.roll + row.pitch)
  if known then bin.leans, bin.roll, bin.pitch = bin.leans + 1, bin.roll + row.roll, bin.pitch + row.pitch end
  bin.n, bin.thrust, bin.yaw = bin.n + 1, bin.thrust + row.thrust, bin.yaw + row.r
  if finite(row.height) and not (row.height >= bin.height) then bin.height = row.height end
end
local function farthest(t, memory, which)
  local far = 0.0
  for i = 1, bin.beyond + memory > t and #bins or 0 do
    local one = bins[i]
    if one.stop + memory > t and one.stop + 2 * BIN <= t then far = max(far, one[which]) end
  end
  return far
end

-- Vibration: mean of its size.
local V = B.vibration_level or {window = 0}
local levels, level_at, level_run = filled(V.window, 0.0), 0, 0
local function judge_vibration(row)
  local good, sum = row.valid and finite(row.vibration), 0.0
  level_at, level_run = level_at % V.window + 1, good and level_run + 1 or 0
  levels[level_at] = row.vibration
  if level_run < V.window then return end
  for i = 1, V.window do sum = sum + levels[i] end
  record(vibration, sum / V.window, farthest(row.t, V.window * STEP, "level"))
end

-- Thrust loss: 1 - mean(-f_z)/(mean(T) per_command EMA(-f_z/(per_command T))), as far as the vehicle turns.
local L = B.thrust_loss or {window = 0}
local usual, pulls, pull_at, pull_run = 1.0, filled(L.window, 0.0, 5), 0, 0
local function judge_thrust(row)
  local up, thrust, turning = -row.fz, row.thrust, row.p * row.p + row.q * row.q + row.r * row.r
  local good, n = row.valid and finite(turning + up) and thrust > L.least, L.window
  if not good then up, thrust = L.per_command, 1.0 end
  usual = usual + L.forget * (min(max(up / (L.per_command * thrust), 0.0), L.cut) - usual)
  pull_at, pull_run = pull_at % n + 1, good and pull_run + 1 or 0
  local pull, force, command, p, q, rate = pulls[pull_at], 0.0, 0.0, 0.0, 0.0, 0.0
  pull[1], pull[2], pull[3], pull[4], pull[5] = up, thrust, row.p, row.q, math.sqrt(turning)
  if pull_run < n then return end
  for i = 1, n do
    local one = pulls[i]
    force, command, p, q, rate = force + one[1], command + one[2], p + one[3], q + one[4], rate + one[5] / n
  end
  local lost = 1.0 - force / (max(command, L.least * n) * L.per_command * max(usual, 1.0 / L.cut))
  local size = max(math.sqrt(p * p + q * q), 1e-30)
  for j = 1, #L.falls // 2 do show(loss, j, (L.falls[2 * j - 1] * p + L.falls[2 * j] * q) / size) end
  record(loss, rate < L.tumbling and max(min(lost, L.per_rad_s * rate), 0.0) or 0.0, 0.0)
end

-- Rotor trim. A part has means of roll, pitch and yaw trim, pull and yaw rate, then what a turn takes; the first two
-- are the last ones of the tick before. A tick has medians of its parts less what pull and turn take, by its weight.
local T = B.rotor_trim or {parts = 0, window = 0}
local parts, ticks, scratch, shift, now, first = filled(T.parts + 2, NAN, 7), filled(T.window, 0.0, 7), {}, {}, {}, {}
local part, rows, known, moved, tick, tick_run, weight = 1, 0, 0, false, 0, 0, 0.0
local function take_trim(row) -- [fraction of hover]
  local level = 0.0
  for j = 1, R do level = level + row[j] end
  now[1], now[2], now[3] = 0.0, 0.0, 0.0
  for j = 1, R do
    local w = level > T.least * R and row[j] * R / level - 1.0 or NAN
    for axis = 1, 3 do now[axis] = now[axis] + T.unmix[axis][j] * (w + T.curve * w * w) end
  end
  now[4], now[5], now[6] = finite(row.roll) and row.roll or 0.0, finite(row.pitch) and row.pitch or 0.0, row.r
  if T.felt == 1 then now[4], now[5] = -row.fy / {{ gravity }}, row.fx / {{ gravity }} end
end
local function take_tick(whole)
  local most, n = 0.0, T.parts
  for i = 3, n + 2 do for j = 1, 6 do parts[i][j] = whole and parts[i][j] / T.rows or NAN end end
  for i = 1, 2 do for j = 1, whole and parts[i][6] ~= parts[i][6] and 6 or 0 do parts[i][j] = parts[3][j] end end
  for i = 2, n + 1 do
    local last, one, next, span_s = parts[i - 1], parts[i], parts[i + 1], 2 * T.rows * STEP / 1000
    one[7] = T.turn[1] * one[6] + (T.turn[2] * (next[6] - last[6]) + T.turn[3] * (last[3] - next[3])) / span_s
    most = whole and max(most, abs(one[7])) or 0.0
  end
  local own, one = 1.0 / (1.0 + (most / T.turn_trim) ^ 2), ticks[tick % T.window + 1]
  one[7] = tick > 0 and min(own, weight) or own -- rotors lag
  for j = 1, 6 do
    for i = 1, n do
      local at = parts[i + 1]
      local taken = j == 3 and at[7] or j < 3 and T.pull[j] * at[j + 3] or 0.0
      scratch[i] = whole and at[j] - taken or 0.0
    end
    table.sort(scratch)
    one[j] = 0.5 * (scratch[(n + 1) // 2] + scratch[n // 2 + 1]) * one[7]
  end
  weight, tick = own, tick + 1
  parts[1], parts[2], parts[n + 1], parts[n + 2] = parts[n + 1], parts[n + 2], parts[1], parts[2]
end
local function rise(j, pull) -- of one rotor's command that explains the shift best; and how much that explains
  local above, below = 0.0, 0.0
  for axis = 1, 3 do
    local share = T.unmix[axis][j] / (T.spread[axis] ^ 2 + (axis < 3 and T.errors[axis] * pull or 0.0))
    above, below = above + share * shift[axis], below + share * T.unmix[axis][j]
  end
  return above / below, above / math.sqrt(below)
end
local function judge_trim(row)
  take_trim(row)
  local sums = parts[part + 2]
  for j = 1, rows == 0 and 6 or 0 do sums[j] = 0.0 end
  if rows == 0 and part == 1 then known, moved, first[1], first[2], first[3] = 0, false, now[1], now[2], now[3] end
  if row.valid and finite(now[1] + now[2] + now[3] + now[4] + now[5] + row.r) then
    known, moved = known + 1, moved or now[1] ~= first[1] or now[2] ~= first[2] or now[3] ~= first[3]
    for j = 1, 6 do sums[j] = sums[j] + now[j] end
  end
  rows = rows + 1
  if rows < T.rows then return end
  rows, part = 0, part + 1
  if part <= T.parts then return end
  part = 1
  local whole = known >= T.parts * T.rows and moved
  take_tick(whole)
  tick_run = whole and farthest(row.t, 1000, "all") <= 1.0 and tick_run + 1 or 0
  if tick_run < T.window then return end
  for j = 1, 7 do
    shift[j] = 0.0
    for i = 1, T.window do shift[j] = shift[j] + ticks[i][j] end
  end
  for j = 1, 6 do shift[j] = shift[j] / shift[7] - T.mean[j] end
  local best, most = 0.0, -HUGE
  for j = 1, R do
    local found, explained = rise(j, shift[4] ^ 2 + shift[5] ^ 2)
    if explained > most then best, most = found, explained end
  end
  best = best / math.sqrt(1.0 + max(T.errors[3] * shift[6] ^ 2 - T.days, 0.0) / T.spread[3] ^ 2)
  local counts = record(trim, best, farthest(row.t, (T.window + 1) * T.parts * T.rows * STEP, "all"))
  for j = 1, counts and R or 0 do show(trim, j, select(2, rise(j, 0.0)) * T.scale) end
end

-- Decision: what is held of the vehicle. A fault is latched; a landing turns it into an open inspection.
local CALM, CLEAR, STALE, SURE, DOUBTFUL, SILENT = table.unpack({{ decision }}) -- ratio, [ms], [ms], share, ratios
local stage, calm, cleared, rotor, gross, seen, lead, named, over = "none", nil, nil, nil, false, false, 0.0, {}, {}
local function motor() return rotor and "motor " .. B.names[rotor] or "rotor unknown" end
local function finding(slot)
  local whose = motor() .. (rotor and " " or ": ")
  if slot == trim then return whose .. string.format("lost %.0f%% thrust", 100.0 * trim.value / (1.0 + 0.75 * trim.value)) end
  return whose .. string.format("%s %.1fx", slot == loss and "thrust" or "vibrates", min(slot.ratio, 99.0))
end
local function extremes(rotors) -- which rotors have the least and the most evidence
  local least, most = 1, 1
  for j = 2, R do least, most = rotors[j] < rotors[least] and j or least, rotors[j] > rotors[most] and j or most end
  return least, most
end
local function falls() -- a named rotor is mended, or another one carries its load no longer
  local least, most = extremes(trim.rotors)
  return named[least] and -trim.rotors[least] >= trim.rotors[most]
end
local function isolate(slot) -- the rotor, or nil, and by how many logits it leads
  if not slot or slot.now == nil or R == 0 then return nil end
  local _, most = extremes(slot.rotors)
  local unit, sum, second = slot.weight * min(max((slot.now - SILENT) / (1.0 - SILENT), 0.0), 1.0), 0.0, -HUGE
  if slot == trim then unit = unit / max(slot.threshold * scale, slot.unit) end
  for j = 1, R do
    if ARMS[j] == j then sum = sum + math.exp(unit * (slot.rotors[j] - slot.rotors[most])) end
    if ARMS[j] == j and j ~= most then second = max(second, slot.rotors[j]) end
  end
  return unit > 0.0 and 1.0 / sum >= SURE and most or nil, unit * (slot.rotors[most] - second)
end
local function undoubted() return (loss and loss.now or 0.0) < DOUBTFUL and trim or nil end -- who names a weak rotor
local function follow(t) -- a fault that is seen; returns whether there is news
  local all_calm, news = true, false
  for _, slot in ipairs(slots) do
    over[slot] = over[slot] or slot.now ~= nil and slot.now > 1.0
    if over[slot] and (slot.now or 1.0) >= CALM then all_calm = false end
  end
  cleared = all_calm and (cleared or t) or nil
  if cleared and t - cleared >= CLEAR then
    seen = false
    return say(INFO, "PROP no longer seen: " .. motor())
  end
  if not gross and loss and loss.now and loss.now > 1.0 then gross, news = true, true end
  if gross and rotor then return news end
  local at, by = isolate(gross and loss or not gross and undoubted())
  if at and (rotor == nil or by > lead) then lead, news, rotor, named[at] = by, news or rotor ~= at, at, true end
  return news
end
local function decide(t)
  local height, best, before = 0, nil, stage -- 0 unknown, 1 calm, 2 held, 3 raised, 4 over
  for _, slot in ipairs(slots) do
    if slot.highest and slot.highest >= 0.0 then slot.ratio, slot.value, slot.at = slot.highest, slot.fresh, t end
    slot.highest, slot.now = nil, nil
    if t - slot.at <= STALE then
      slot.now = slot == trim and falls() and 0.0 or slot.ratio
      local own = slot.now > 1.0 and 4 or slot.now >= slot.suspected and 3 or slot.now >= CALM and 2 or 1
      if own > height or own == height and slot.now > best.now then height, best = own, slot end
    end
  end
  calm = height == 1 and (calm or t) or nil
  if height == 4 then stage, gross = "fault", stage == "fault" and gross
  elseif height == 0 and (stage == "quiet" or stage == "suspected") then stage = "none"
  elseif stage == "none" and (height == 1 or height == 2) or stage == "suspected" and calm and t - calm >= CLEAR then
    stage = "quiet"
  elseif height == 3 and (stage == "none" or stage == "quiet") then stage = "suspected" end
  if stage == "none" or stage == "quiet" then rotor = nil end
  local at = stage == "suspected" and height == 3 and isolate(undoubted()) or rotor
  if at ~= rotor then
    rotor = at
    say(WARNING, "PROP inspect " .. motor() .. " before the next flight")
  elseif stage == "suspected" and before ~= stage then say(WARNING, "PROP suspect " .. finding(best)) end
  if stage ~= "fault" then return end
  local news = height == 4 and not seen
  if news then seen, rotor, lead, cleared, over = true, nil, 0.0, nil, {} end
  if not seen or not follow(t) and not news then return end
  keep_open(rotor or UNNAMED)
  if gross then say(CRITICAL, "PROP THRUST LOST " .. motor())
  elseif before == "fault" and news then say(WARNING, "PROP seen again: " .. finding(best))
  else say(CRITICAL, "PROP FAULT " .. finding(best)) end
end

-- A flight: its rows one after the other, and its end.
local look, air, low = nil, false, 0
local function begin_flight(t)
  for i = 1, #bins do bins[i].stop, bins[i].all, bins[i].level = -HUGE, 0.0, 0.0 end
  for i = 1, #leans do leans[i][1], leans[i][2] = NAN, NAN end
  for i = 1, #parts do parts[i][6] = NAN end
  bin.number, bin.beyond, first_bin = nil, -HUGE, t // BIN + 1
  level_run, pull_run, usual, part, rows, tick, tick_run = 0, 0, 1.0, 1, 0, 0, 0
  for _, slot in ipairs(slots) do slot.highest, slot.ratio, slot.value, slot.at = nil, 0.0, 0.0, -HUGE end
  look, calm, air, low = nil, nil, true, 0
end
local function judge(row)
  local own = (row.t + LOOK - 1) // LOOK -- the look that its values belong to
  take_bin(row)
  for number = look or own, own - 1 do decide(number * LOOK) end
  if vibration then judge_vibration(row) end
  if trim then judge_trim(row) end
  if loss then judge_thrust(row) end
  look = row.t % LOOK == 0 and own + 1 or own
  if look > own then decide(row.t) end
end
local function end_flight(last)
  if look and last > (look - 1) * LOOK then decide(last) end
  air, seen = false, false
  if stage == "inspect" then return end
  if stage ~= "fault" then stage, rotor = "none", nil return end
  stage = "inspect"
  keep_open(rotor or UNNAMED)
  say(WARNING, "PROP " .. motor() .. ": inspect before flight")
end

-- Gate: what flies. Rows wait for `stop`, and from an impact on (low is 1) or while thrust or height are low (2), until
-- it is known whether it landed.
local QUIET_RAD_S, QUIET, BACK, LOUD = table.unpack({{ quiet }}) -- [rad/s], [ms]
local G, queue, head, queued, kept = B.gate, filled((B.gate.stop + 3500) // STEP, 0.0, R), 0, 0, 0
local blank, last, low_at, loud_at, up, late, tumbles = 0, 0, 0, 0, nil, 0, false
local IMPACT, IMPACT_MS, USUAL, KNOWN = table.unpack({{ impact }})
local settled, felt, force0, thrust0 = 0, 0.0, 0.0, 0.0
local function hits(force, thrust)
  felt = felt + min(STEP / IMPACT_MS, 1.0) * (force - felt)
  local ratio = thrust0 > 0.0 and thrust / thrust0 or 0.0
  local most = IMPACT * force0 * ratio * max(ratio, 1.0)
  local known = settled * STEP >= KNOWN
  settled = settled + 1
  local share = max(STEP / USUAL, 1.0 / settled)
  force0, thrust0 = force0 + share * (force - force0), thrust0 + share * (thrust - thrust0)
  return known and 0.0 < most and most < felt
end
local function gate(row)
  local t, is_low, size = row.t, row.height < G.height or row.thrust < G.thrust, max(abs(row.p), abs(row.q), abs(row.r))
  if not air then
    if is_low or not row.armed then return end
    begin_flight(t)
    blank, queued, kept = t + G.start, 0, 0
    settled, felt, force0, thrust0 = 0, 0.0, 0.0, 0.0
  end
  local loud = size > QUIET_RAD_S and finite(row.p + row.q + row.r)
  local held = is_low and 2 or 0
  if not is_low and t >= blank and finite(row.fz + row.thrust) then held = hits(-row.fz, row.thrust) and 1 or 0 end
  if held > low and not (low > 0 and tumbles) then low, low_at, loud_at, late, tumbles = held, t, t, 0, false end
  local landed = not row.armed or is_low and not loud and t - loud_at >= QUIET
  if landed or queued + 1 >= #queue then return end_flight(last) end
  up = held == 0 and low > 0 and (up or t) or nil
  if up and t - up >= BACK then low = 0 end
  queued, row.valid = queued + 1, row.valid and t >= blank
  if low > 0 and loud then
    late, loud_at = late + (t - low_at > QUIET and 1 or 0), t
    tumbles = late * STEP >= LOUD
  end
  if low == 0 or tumbles then kept, last = queued, t end
  for _ = 1, 2 do -- so many rows a call, for a call may take 10,000 steps
    if kept == 0 or queue[head + 1].t > last - G.stop then return end
    judge(queue[head + 1])
    head, queued, kept = (head + 1) % #queue, queued - 1, kept - 1
  end
end

-- What the flight controller knows now; nan where it does not say.
local newer, before = pcall(function() return ahrs:get_roll_rad() + ahrs:get_pitch_rad() end), nil -- names of 4.7
local function read(row, t)
  local gyro, accel, vibe = ahrs:get_gyro(), ahrs:get_accel(), ahrs:get_vibration()
  row.t, row.armed, row.p, row.q, row.r = t, arming:is_armed(), NAN, NAN, NAN
  if gyro then row.p, row.q, row.r = gyro:x(), gyro:y(), gyro:z() end
  row.valid = finite(row.p + row.q + row.r) and (before == nil or t - before <= 3 * STEP) -- else the script was held up
  row.fx, row.fy = accel and accel:x() or NAN, accel and accel:y() or NAN
  row.fz, row.vibration = accel and accel:z() or NAN, vibe and vibe:length() or NAN
  row.thrust, row.height = vehicle:get_control_output(3) or NAN, -(ahrs:get_relative_position_D_home() or NAN)
  row.roll, before = (newer and ahrs:get_roll_rad() or not newer and ahrs:get_roll()) or NAN, t
  row.pitch = (newer and ahrs:get_pitch_rad() or not newer and ahrs:get_pitch()) or NAN
  for j = 1, R do
    local pulse = SRV_Channels:get_output_pwm(MOTORS[j])
    row[j] = pulse and max(pulse - 1000.0, 0.0) / 1000.0 or NAN
  end
  return row
end

-- Once a second: parameters, arming, named values and the log.
local auth, rpm, names, format, next_s = arming:get_aux_auth_id(), {}, {}, string.rep("f", R), 0
for j = 1, R do names[j] = "M" .. j end
names = table.concat(names, ",")
local function watch_parameters()
  local wanted, factor = PARAM.OPEN:get(), PARAM.SCALE:get() or 1.0
  scale = factor > 0.0 and factor or 1.0
  if stage == "none" and open ~= 0 then -- kept over a restart
    stage, rotor = "inspect", ARMS[math.floor(open)]
    named[rotor or UNNAMED] = true
  end
  if wanted == 0 and open ~= 0 and stage == "inspect" then
    say(INFO, "PROP " .. motor() .. ": inspection acknowledged")
    open, stage, rotor, named = 0, "none", nil, {}
  end
  if auth == nil then return end
  local forbidden = open ~= 0 and PARAM.ARM:get() ~= 0 and PARAM.ENABLE:get() ~= 0
  if not forbidden then return arming:set_aux_auth_passed(auth) end
  arming:set_aux_auth_failed(auth, "PROP inspect " .. motor() .. ", PROP_OPEN=0")
end
local function shown(slot, name)
  if slot == nil or slot.now == nil then return NAN end
  gcs:send_named_float(name, slot.value)
  return slot.value
end
local function tell()
  local evidence, has_rpm = 0.0, false
  for _, slot in ipairs(slots) do evidence = max(evidence, slot.now or 0.0) end
  gcs:send_named_float("PF_EVID", evidence)
  logger:write("PROP", "Evid,Vib,Trim,Loss,Motor,Open", "ffffBB", evidence, shown(vibration, "PF_VIB"),
    shown(trim, "PF_TRIM"), shown(loss, "PF_LOSS"), rotor or 0, math.floor(open))
  for j = 1, R do
    local channel = SRV_Channels:find_channel(MOTORS[j])
    local speed = channel and esc_telem and esc_telem:get_rpm(channel)
    rpm[j], has_rpm = speed or NAN, has_rpm or speed
  end
  if has_rpm then logger:write("PRPM", names, format, table.unpack(rpm)) end
end
local function update()
  local t = millis():toint()
  if t >= next_s then
    next_s = t + 1000
    watch_parameters()
    if air then tell() end
  end
  if PARAM.ENABLE:get() ~= 0 then gate(read(queue[(head + queued) % #queue + 1], t))
  elseif air then end_flight(last) end
  if not air then queued, kept = 0, 0 end
  if waiting == nil or t - said < 2000 then return end
  gcs:send_text(severity, waiting)
  waiting, said = nil, t
end
local function guarded() -- an error must not end the watch in silence
  local sound, wrong = pcall(update)
  if sound then return guarded, STEP end
  gcs:send_text(WARNING, string.sub("PROP script: " .. tostring(wrong), 1, 50))
  return guarded, 5000
end
say(INFO, "PROP watching by baseline " .. string.sub(string.match(B.digest, "[^:]*$"), 1, 8))
if auth == nil then say(WARNING, "PROP cannot forbid arming: no slot is free") end
return guarded()
