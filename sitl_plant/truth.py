"""What really happened in a flight, as JSON lines in a file (edge): for judging a detector, never sent to it.

{"record": "flight", ...}     once: the configuration
{"record": "state", ...}      every second of flight: truth, SI units, body FRD, world NED
{"record": "onset", ...}      when the fault begins, or a cause that was injected in flight
{"record": "clear", ...}      when all causes are taken away in flight; "wind", "battery": set anew
"""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

from mavdiag.errors import UsageError
from mavdiag.storage import begins, replacing
from sitl_plant.physics.faults import Injection, SensorFault
from sitl_plant.plant import STEP_NS, Change, PlantConfig, PlantSamples

STATE_EVERY_NS = 1_000_000_000


class Truth:
    """From samples to lines, in a file if there is one.

    started_unix_ns: wall clock at flight time 0; None if the flight was not in real time. A block that begins before
    the one before it is of a new flight, and gets a first line of its own.
    """

    def __init__(
        self, config: PlantConfig, profile: str, rate_hz: float, started_unix_ns: int | None, file: TextIO | None = None
    ) -> None:
        self._config, self._started_unix_ns, self._file, self._t_ns = config, started_unix_ns, file, math.inf
        self._link = {"profile": profile, "rate_hz": rate_hz}
        self._causes = list[Injection]()

    def write(self, samples: PlantSamples, changes: Sequence[Change] = ()) -> None:
        """Write the lines of a block (n >= 1). changes: `Plant.take_changes`, made before the block."""
        if self._file is None:
            return
        lines = [self._head()] if int(samples.t_ns[0]) < self._t_ns else []
        self._t_ns = int(samples.t_ns[-1])
        for t_ns, what in changes:
            if isinstance(what, Injection):
                self._causes.append(what)
            else:
                self._causes.clear()
                lines.append(self._line(what, t_ns, {}))
        for row, t_ns in enumerate(samples.t_ns.tolist()):
            for cause in self._causes:
                if t_ns - STEP_NS < _ns(cause.onset_s) <= t_ns:
                    rotor = None if isinstance(cause.cause, SensorFault) else cause.rotor
                    told: dict[str, object] = {"fault": cause.name, "rotor": rotor, "cause": asdict(cause.cause)}
                    lines.append(self._line("onset", t_ns, told))
            if t_ns % STATE_EVERY_NS == 0:
                present = any(_ns(cause.onset_s) <= t_ns for cause in self._causes)
                state = {"record": "state", "t_s": t_ns * 1e-9, "fault_present": present}
                columns = {"position_m": samples.position, "velocity_m_s": samples.velocity}
                columns |= {"quaternion": samples.quaternion, "omega_rad_s": samples.omega}
                columns |= {"rotor_speed_rad_s": samples.rotor_speed, "battery_v": samples.battery_v}
                lines.append(json.dumps(state | {name: column[row].tolist() for name, column in columns.items()}))
        self._file.writelines(f"{line}\n" for line in lines)
        self._file.flush()

    def slip(self, late_s: float) -> None:
        """What follows comes so much later by the wall clock: the flight's clock was set back."""
        self._started_unix_ns = self._started_unix_ns and self._started_unix_ns + round(late_s * 1e9)

    def _head(self) -> str:
        """The first line of a flight, which now begins."""
        config = self._config
        self._causes = list(config.all_injections()[:1]) if config.fault else []
        line: dict[str, object] = {"record": "flight", "vehicle": config.vehicle.name}
        plain = ("drone", "trajectory", "nose", "start", "fault", "phenomenology", "seed", "wind_m_s", "turbulence_m_s")
        line |= {name: getattr(config, name) for name in (*plain, "outages_per_min")}
        line |= {name: getattr(config, name) if config.fault else None for name in ("rotor", "onset_s")}
        carried = (config.pickup.mass_kg, config.pickup_s[0]) if config.pickup else (0.0, None)
        line |= {"payload_kg": config.payload.mass_kg, "pickup_kg": carried[0], "pickup_s": carried[1]}
        return json.dumps({**line, **self._link, "started_unix_ns": self._started_unix_ns})

    def _line(self, record: str, t_ns: int, values: dict[str, object]) -> str:
        unix_ns = None if self._started_unix_ns is None else self._started_unix_ns + t_ns
        return json.dumps({"record": record, "t_s": t_ns * 1e-9, **values, "unix_ns": unix_ns})


def _ns(t_s: float) -> float:
    return round(t_s * 1e9) if math.isfinite(t_s) else t_s


@contextmanager
def truth_file(path: Path | None, *, whole: bool = False) -> Iterator[TextIO | None]:
    """The open file, None for no file. Raises UsageError if it cannot be written, or is a file of another kind.

    whole: it replaces an old one as `replacing` does, and cannot be read before.
    """
    if path is None:
        yield None
        return
    if not begins(path, rb'\{"record"'):
        raise UsageError(f"{path}: holds something else, which would be lost; choose another --truth file")
    if whole:
        with replacing(path) as raw:
            yield TextIOWrapper(raw, "utf-8", write_through=True)
        return
    try:
        file = path.open("w", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}; choose another --truth file") from error
    with file:
        yield file
