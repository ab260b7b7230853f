"""The daemon's settings: one validated value from a TOML file and the command line, which wins.

Unknown keys are refused by name, so that a misspelt one is not silently without effect.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from mavdiag.errors import InputError, UsageError
from mavdiag.link.ports import parse_address
from mavdiag.link.profiles import profile_named
from mavdiag.storage import read_toml
from mavdiag.telemetry import Axis

__all__ = ["SessionSettings", "Settings", "load_settings", "split_metrics_address"]

LOOPBACK = "127.0.0.1"

Positive = Annotated[float, Field(gt=0)]


class SessionSettings(BaseModel):
    """How a session works."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    learn: Positive | None = None  # seconds of healthy flight to learn from, in place of a baseline
    negotiate: bool = True  # ask the autopilot for streams that are missing or too slow
    ask_hz: Positive | None = None  # rate to ask for when learning; default: the profile's
    min_rate_hz: Positive = 45.0  # slowest streams to work with; F1 needs 100, 50 and below degrade (METHOD section 4)
    link_lost_s: Positive = 3.0  # silence that means that the link is lost: three heartbeats
    clear_s: Positive = 5.0  # quiet time that ends an alert
    takeoff_s: Annotated[float, Field(ge=0)] = 3.0  # time after a take-off in which no alert is raised
    suspect: tuple[str, ...] = ()  # monitors ("fsd", "fsd.pitch") that only raise a suspicion
    texts_per_minute: Annotated[int, Field(ge=4, le=120)] = 30  # half for declared faults, half for the rest
    named_values_hz: Annotated[float, Field(gt=0, le=20)] = 5.0  # rate of the NAMED_VALUE_FLOATs
    named_values_axis: Axis = Axis.ROLL  # whose figures they carry


class Settings(SessionSettings):
    """Everything that can be set; most of it has a command-line option."""

    connect: str = "udpin:127.0.0.1:14550"  # the vehicle's link
    baseline: Path | None = None  # file to judge by
    save: Path | None = None  # file that keeps what was learned
    airframe: str | None = None  # what is learned about: a built-in name or a TOML file
    layout: str | None = None  # its rotor layout; default: by its parameters, else by its flight
    name: Annotated[str, Field(min_length=1)] | None = None  # its label; default: "vehicle" and its id
    forward: tuple[str, ...] = ()  # further links that get the vehicle's frames and the alerts
    journal: Path | None = None  # file for the events
    record: Path | None = None  # .tlog file for all frames received
    metrics: str | None = None  # address to serve figures on
    signing_key: Path | None = None  # file with the key of MAVLink 2 signing
    vehicle: Annotated[int, Field(ge=1, le=255)] | None = None  # the only system id to watch
    profile: str | None = None  # of the link; default: by what the vehicle sends
    tick_s: Annotated[float, Field(ge=0.005, le=0.5)] = 0.04  # how often the daemon looks at its links

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.baseline is not None and self.learn is not None:
            raise ValueError("either --baseline FILE or --learn SECONDS, not both")
        if self.baseline is None and self.learn is None:
            raise ValueError("name a --baseline FILE, or --learn SECONDS of healthy flight")
        for option in ("save", "airframe", "layout", "name"):
            if getattr(self, option) is not None and self.learn is None:
                raise ValueError(f"--{option} is about what --learn SECONDS learns; add --learn or leave it out")
        return self


def load_settings(path: Path | None, overrides: Mapping[str, object]) -> Settings:
    """Settings from a TOML file (None for none), and by key what the command line said (None: nothing).

    Raises UsageError, naming the key.
    """
    values = {} if path is None else _read(path)
    values |= {key: value for key, value in overrides.items() if value is not None}
    try:
        settings = Settings.model_validate(values)
    except ValidationError as error:
        raise UsageError(_reason(path, error)) from error
    for address in (settings.connect, *settings.forward):
        parse_address(address)
    if settings.profile is not None:
        profile_named(settings.profile)
    if settings.metrics is not None:
        split_metrics_address(settings.metrics)
    return settings


def split_metrics_address(text: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`; a bare port is on loopback. Raises UsageError.

    >>> split_metrics_address("9100")
    ('127.0.0.1', 9100)
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65_535:
        raise UsageError(f"malformed metrics address {text!r}: write HOST:PORT, or a port alone for loopback")
    return host.strip("[]") or LOOPBACK, int(port)


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_toml(path)
    except InputError as error:
        raise UsageError(f"{error}; check --config") from error


def _reason(path: Path | None, error: ValidationError) -> str:
    first = error.errors()[0]
    key = ".".join(str(step) for step in first["loc"])
    where = f"{path}: " if path is not None else ""
    if first["type"] == "extra_forbidden":
        return f"{where}unknown key {key!r}; known are {', '.join(Settings.model_fields)}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{where}{key}: {message}" if key else f"{where}{message}"
