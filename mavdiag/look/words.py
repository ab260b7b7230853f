"""An inspection as text: a block of short lines for one log or link, one line each for several logs."""

import itertools
import math
import textwrap
from collections.abc import Iterator, Sequence

from mavdiag.look.figures import VIBRATION_HIGH, VIBRATION_USUAL, OutputLoad, RotorLine, Vibration
from mavdiag.look.inspection import Clock, Inspection, Summary
from mavdiag.printable import counted, printable

WIDTH = 80
NOTABLE = 0.05  # of the mean output: a rotor that is told in the one line of a log (our choice)
CLOSING = "this is no verdict: that takes a baseline of flights with sound propellers (mavdiag identify)"


def in_full(found: Inspection) -> list[str]:
    """All about one log or link, in lines of at most 80 characters."""
    wrap = textwrap.TextWrapper(WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False).wrap
    lines = (wrap(printable(one)) if isinstance(one, str) else map(printable, one) for one in _paragraphs(found))
    return list(itertools.chain.from_iterable(lines))


def in_one_line(found: Inspection) -> str:
    """The most that one line can say of a log."""
    if found.no_flight:
        return f"{found.log}: {found.profile}, {found.span_s:.0f} s, {found.no_flight}"
    rate_hz = 0.0 if found.gyro is None else found.gyro.rate_hz or 0.0
    parts = [found.profile, f"{found.flight_s:.0f} s of flight", f"{rate_hz:.0f} Hz", *parts_of(found)]
    return f"{found.log}: {', '.join(parts)}"


def parts_of(found: Inspection) -> list[str]:
    """What a flight shows in short: upset, busiest motor, saturation, vibration, rotor line, what could be judged."""
    parts = [found.upset] if found.upset else []
    busiest = max(found.loads, key=lambda load: load.over_mean, default=None)
    if busiest is not None and busiest.over_mean >= NOTABLE:
        parts.append(f"motor {busiest.number} {100 * busiest.over_mean:+.1f} %")
    if found.trim is not None and not found.loads:
        parts.append(f"trim {', '.join(f'{value:+.3f}' for value in found.trim.values())}")
    full = max((load.full_share for load in found.loads), default=0.0)
    if full > 0:
        parts.append(f"an output at its end for {100 * full:.1f} %")
    if found.vibration is not None:
        parts.append(f"VIBRATION {max(found.vibration.high):.0f} m/s^2")
    if found.line is not None and not found.line.reason:
        parts.append(f"line at {found.line.hz:.0f} Hz")
    works = sum(state.works for state in found.monitors)
    return [*parts, f"{works} of {counted(len(found.monitors), 'monitor')} could judge"]


def _paragraphs(found: Inspection) -> Iterator[str | list[str]]:
    flight = found.no_flight or f"{found.flight_s:.1f} s of flight that can be judged"
    yield f"{found.log}: profile {found.profile}, {found.span_s:.1f} s long, {flight}"
    yield from (f"note: {note}" for note in found.notes)
    yield from found.asked
    yield from (f"{name}: {text}" for name, text in (("baseline", found.baseline), ("upset", found.upset)) if text)
    yield f"link: {_link(found)}"
    if found.clock is not None:
        yield f"clock: {_clock(found.clock)}"
    if found.messages:
        often = sorted(found.messages, key=lambda message: -message.rate_hz)
        yield f"messages a second: {', '.join(f'{message.name} {message.rate_hz:.1f}' for message in often)}"
    if found.signals:
        yield _signals(found.signals)
    units = found.units
    yield f"gravity: {'' if units.gravity_g is None else f'{units.gravity_g:.2f} g, '}{units.gravity}"
    for axis in units.gyro:
        delay_ms = 1e3 * (axis.delay_s or 0.0)
        figures = "" if axis.scale is None else f"{axis.scale:.2f} of the attitude's slope, {delay_ms:+.0f} ms, "
        yield f"gyro {axis.axis}: {figures}{axis.verdict}"
    if not units.gyro:
        yield "gyro: not compared with the attitude, which takes some seconds of both, the gyro at 20 Hz or more"
    yield found.rotors
    if not found.no_flight:
        yield from _loads(found.loads)
        if found.trim is not None:
            trim = ", ".join(f"{axis} {value:+.3f}" for axis, value in found.trim.items())
            yield f"trim: {trim} of the hover command; payload, balance point and wind are in it, too"
        yield f"VIBRATION: {_vibration(found.vibration)}"
        if found.line is not None:
            yield f"rotor line: {_line(found.line)}"
    yield "monitor"
    yield from (f"  {state.monitor:<16} {'; '.join(state.missing) or 'works'}" for state in found.monitors)
    lacking = any(why.startswith("no ") for state in found.monitors for why in state.missing)
    if found.link is not None and lacking and not found.asked:
        yield "ask the vehicle for what is missing (mavdiag inspect ENDPOINT --ask), or set parameters named above"
    yield CLOSING


def _link(found: Inspection) -> str:
    gyro, text = found.gyro, "no gyro"
    if gyro is not None and gyro.rate_hz is not None:
        jitter = "" if gyro.jitter_ms is None else f", jitter {gyro.jitter_ms:.2f} ms"
        long = f"{counted(found.gyro_gaps, 'gap')} too long to bridge, {found.lost_s:.1f} s in all"
        text = f"gyro at {gyro.rate_hz:.1f} Hz{jitter}, {long if found.gyro_gaps else 'no long gap'}"
    if found.link is None:
        return text
    received, lost, reordered, duplicated = found.link.values()
    share = 100.0 * lost / max(received + lost, 1)
    more = f"{duplicated} came twice, {reordered} out of order"
    return f"{text}; {received} messages, {lost} lost ({share:.2f} %), {more}"


def _clock(clock: Clock) -> str:
    ppm = clock.drift_ppm
    drift = "" if ppm is None else f", it runs {abs(ppm):.0f} ppm {'slower' if ppm > 0 else 'faster'} than ours"
    late = ", ".join(f"{name} {ms:+.0f} ms" for name, ms in clock.signals_ms.items() if abs(ms) >= 1.0)
    return f"transport delay varies by {clock.spread_ms:.1f} ms{drift}" + (f"; beside the gyro {late}" if late else "")


def _signals(found: Sequence[Summary]) -> list[str]:
    lines = [f"{'signal':<20}{'samples':>8}{'rate Hz':>9}{'jitter ms':>10}{'gap s':>8}  range of each column"]
    for signal in found:
        ends = zip(signal.lowest, signal.highest, strict=True)
        each = ("no number" if low is None or high is None else f"{low:.3g}..{high:.3g}" for low, high in ends)
        counted = ((text, len(list(alike))) for text, alike in itertools.groupby(each))
        ranges = [text if count == 1 else f"{text} x{count}" for text, count in counted]
        timing = ((signal.rate_hz, 9, 1), (signal.jitter_ms, 10, 2), (signal.longest_gap_s, 8, 3))
        row = "".join("-".rjust(width) if x is None else f"{x:{width}.{places}f}" for x, width, places in timing)
        names = [signal.signal, f"  {signal.unit}"] if signal.unit else [signal.signal]
        for name, text in itertools.zip_longest(names, ranges, fillvalue=""):
            middle = f"{signal.samples:>8}{row}" if name == signal.signal else ""
            lines.append(f"{name:<20}{middle:<35}  {text}".rstrip())
    return lines


def _loads(loads: Sequence[OutputLoad]) -> Iterator[str]:
    if not loads:
        yield "outputs: none in the log; no trim asymmetry by rotor and no saturation can be told"
        return
    level = 100 * sum(load.mean for load in loads) / len(loads)
    shares = ", ".join(f"{load.number}: {100 * load.over_mean:+.1f} %" for load in loads)
    yield f"motors beside their mean of {level:.0f} %: {shares}"
    ends = ((load.number, *end) for load in loads for end in (("upper", load.full_share), ("lower", load.idle_share)))
    told = [f"{n} at its {end} end for {100 * share:.1f} % of the flight" for n, end, share in ends if share > 0]
    yield f"saturation: {'; '.join(told) or 'no output reached an end'}"


def _vibration(found: Vibration | None) -> str:
    if found is None:
        return "not in the log"
    high = ", ".join(f"{axis} {level:.1f}" for axis, level in zip("xyz", found.high, strict=True))
    text = f"{high} m/s^2 (95 % of the time below)"
    if found.above_high > 0:
        return f"{text}; {100 * found.above_high:.1f} % above {VIBRATION_HIGH:.0f}, where ArduPilot expects trouble"
    share = f"{100 * found.above_usual:.1f} %" if found.above_usual > 0 else "never"
    return f"{text}; {share} above {VIBRATION_USUAL:.0f}, up to which ArduPilot accepts it"


def _line(found: RotorLine) -> str:
    told = "" if math.isnan(found.told_hz) else f"; the rotors turn at {found.told_hz:.0f} Hz by their own telemetry"
    if found.reason:
        return f"not heard: {found.reason}{told}"
    also = "".join(f", and at {n} times that" for n in found.harmonics)
    where = f"looked for from {found.from_hz:.0f} to {found.to_hz:.0f} Hz"
    return f"{found.hz:.0f} Hz, {found.db:.0f} dB above its neighbourhood{also} ({where}){told}"
