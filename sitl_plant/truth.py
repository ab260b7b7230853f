"""What really happened in a flight, as JSON lines: for judging a detector, never sent to it.

{"record": "flight", ...}     once: the configuration
{"record": "state", ...}      every second of flight: truth, SI units, body FRD, world NED
{"record": "onset", ...}      when the fault begins
"""

import json

from sitl_plant.plant import STEP_NS, PlantConfig, PlantSamples

__all__ = ["Truth"]

STATE_EVERY_NS = 1_000_000_000


class Truth:
    """From samples to lines. started_unix_ns: wall clock at flight time 0; None if the flight was not in real time."""

    def __init__(self, config: PlantConfig, profile: str, rate_hz: float, started_unix_ns: int | None) -> None:
        self._config, self._profile, self._rate_hz = config, profile, rate_hz
        self._started_unix_ns = started_unix_ns
        self._onset_ns = round(config.onset_s * 1e9) if config.fault else None

    def head(self) -> str:
        """The first line."""
        config = self._config
        return json.dumps(
            {
                "record": "flight",
                "vehicle": config.vehicle.name,
                "drone": config.drone,
                "trajectory": config.trajectory,
                "nose": config.nose,
                "start": config.start,
                "fault": config.fault,
                "rotor": config.rotor if config.fault else None,
                "onset_s": config.onset_s if config.fault else None,
                "phenomenology": config.phenomenology,
                "seed": config.seed,
                "wind_m_s": config.wind_m_s,
                "payload_kg": config.payload.mass_kg,
                "turbulence_m_s": config.turbulence_m_s,
                "pickup_kg": config.pickup.payload.mass_kg if config.pickup else 0.0,
                "pickup_s": config.pickup.at_s if config.pickup else None,
                "outages_per_min": config.outages_per_min,
                "profile": self._profile,
                "rate_hz": self._rate_hz,
                "started_unix_ns": self._started_unix_ns,
            }
        )

    def step(self, samples: PlantSamples) -> list[str]:
        """The lines that fall into a block (n >= 1)."""
        lines = []
        for row, t_ns in enumerate(samples.t_ns.tolist()):
            if self._onset_ns is not None and t_ns - STEP_NS < self._onset_ns <= t_ns:
                lines.append(self._onset(t_ns))
            if t_ns % STATE_EVERY_NS == 0:
                lines.append(self._state(samples, row, t_ns))
        return lines

    def _onset(self, t_ns: int) -> str:
        unix_ns = None if self._started_unix_ns is None else self._started_unix_ns + t_ns
        return json.dumps(
            {
                "record": "onset",
                "t_s": t_ns * 1e-9,
                "fault": self._config.fault,
                "rotor": self._config.rotor,
                "unix_ns": unix_ns,
            }
        )

    def _state(self, samples: PlantSamples, row: int, t_ns: int) -> str:
        return json.dumps(
            {
                "record": "state",
                "t_s": t_ns * 1e-9,
                "fault_present": self._onset_ns is not None and t_ns >= self._onset_ns,
                "position_m": samples.position[row].tolist(),
                "velocity_m_s": samples.velocity[row].tolist(),
                "quaternion": samples.quaternion[row].tolist(),
                "omega_rad_s": samples.omega[row].tolist(),
                "rotor_speed_rad_s": samples.rotor_speed[row].tolist(),
                "battery_v": float(samples.battery_v[row]),
            }
        )
