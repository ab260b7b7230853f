"""The daemon's settings: one validated value from a TOML file, the environment and the command line, which wins.

Each setting is one field, with its option of the command line where it has one; `detector/example.toml` documents it.
"""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Self

import typer
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator
from typer.models import OptionInfo

from detector.hooks import parse_hook
from detector.rules import AUTOMATIC, parse_modes, parse_rules
from detector.web.access import is_loopback
from mavdiag.errors import InputError, UsageError
from mavdiag.link.ports import Kind, parse_address
from mavdiag.link.profiles import profile_named
from mavdiag.link.wants import LEAST_HZ
from mavdiag.monitors import by_name
from mavdiag.storage import read_toml
from mavdiag.telemetry import axis_named

LONGEST_S = 3600.0  # of learning: the flight is kept in memory until then, a gigabyte of 1 kHz (our choice)
ENVIRONMENT = "MAVDIAG_DETECTOR_"  # prefix of the variables that set a setting; ..._CONFIG names the file
LOOPBACK = "127.0.0.1"
NOT_KEPT = "not kept: every start learns anew, broken or not; name a --save FILE"  # what is learned without one
ANY = {"0.0.0.0": LOOPBACK, "::": "::1"}  # who listens everywhere is asked on loopback

Megabytes = Annotated[float, Field(ge=0.01, le=1e6)]
SystemId = Annotated[int, Field(ge=1, le=255)]
Kept = Annotated[int, Field(ge=0, le=1000)]
Text = Annotated[str, Field(min_length=1)]


def _option(metavar: str | None, text: str, *names: str) -> Any:
    return typer.Option(*names, metavar=metavar, help=text)


_LEARN = "Learn a baseline first, from so much healthy flight."
_CONNECT = "udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P or /dev/ttyX,BAUD.  [default: udpin:127.0.0.1:14550]"
_LAYOUT = "Its rotor layout, as in `mavdiag identify`.  [default: what it shows]"
_FORWARD = "A further link that gets vehicle and alerts, e.g. a ground station; repeatable."
_HOOK = "exec:PROGRAM, http://..., mqtt://HOST/TOPIC: gets every alert's line of the journal; repeatable."
_BASELINES = "Folder of baselines: 3.json is system id 3's, 000000000051d205.json that of the autopilot with this uid."
_HISTORY = "Add every flight after its landing: SQLite, or postgresql://user@host/name; needs --flights."
_FLIGHTS = "Keeps the recordings of flights that are not in the history yet."
_ON_FAULT = "What to do about a fault, as 'gross loss: land; propeller fault after 10 s: rtl; suspected: text'."
_MODES = "Flight modes in which it may be done.  [default: those that fly by themselves or hold a place]"
_WEB = "Serve the live page; a bare port is on loopback, elsewhere it needs a token."


def _of_monitor(name: str) -> None:
    monitor, _, axis = name.partition(".")
    by_name(monitor)
    if axis:
        axis_named(axis)


CHECKS: Mapping[str, Callable[[str], object]] = {  # of settings that another module reads
    "hook": parse_hook,
    "suspect": _of_monitor,
    "on_fault": parse_rules,
    "on_fault_modes": parse_modes,
    "profile": profile_named,
}


class SessionSettings(BaseModel):
    """How a session works."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, coerce_numbers_to_str=True)

    learn: Annotated[float | None, Field(gt=0, le=LONGEST_S), _option("SECONDS", _LEARN)] = None
    negotiate: bool = True  # ask the autopilot for streams that are missing or too slow
    ask_hz: Annotated[float, Field(gt=0, le=10_000)] | None = None  # when learning; default: the profile's
    min_rate_hz: Annotated[float, Field(gt=0, le=10_000)] = LEAST_HZ  # of streams, but for a slower baseline's
    threshold_scale: Annotated[float, Field(ge=0.5, le=4)] = 1.0  # of all thresholds
    link_lost_s: Annotated[float, Field(ge=1, le=600)] = 3.0  # silence of a link that is lost: three heartbeats
    suspect: tuple[str, ...] = ()  # monitors ("fsd", "fsd.pitch") that only raise a suspicion
    texts_per_minute: Annotated[int, Field(ge=4, le=120)] = 30  # half for declared faults, half for the rest
    named_values_hz: Annotated[float, Field(gt=0, le=20)] = 5.0  # rate of the NAMED_VALUE_FLOATs
    on_fault: Annotated[str, _option("TABLE", _ON_FAULT)] = ""
    on_fault_modes: Annotated[str, _option("MODES", _MODES)] = AUTOMATIC


class VehicleSettings(BaseModel):
    """What is different for one vehicle of the link."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    baseline: Path  # file to judge it by


class Settings(SessionSettings):
    """Everything that can be set."""

    connect: Annotated[str, _option("ENDPOINT", _CONNECT)] = "udpin:127.0.0.1:14550"  # the vehicle's link
    baseline: Annotated[Path | None, _option("FILE", "Judge by this baseline.")] = None
    baselines: Annotated[Path | None, _option("DIR", _BASELINES)] = None
    vehicles: Mapping[SystemId, VehicleSettings] = Field(default_factory=dict)  # by system id
    save: Annotated[Path | None, _option("FILE", "Keep what was learned; where it is there, judge by it.")] = None
    accept: bool = False  # whether a learned baseline of grade D is taken, too
    airframe: Annotated[str | None, _option("NAME|FILE.toml", "Rotors, mass, ... of what is learned about.")] = None
    layout: Annotated[str | None, _option("NAME", _LAYOUT, "--layout", "--frame")] = None
    name: Annotated[Text | None, _option("LABEL", 'Of what is learned.  [default: "vehicle" and its id]')] = None
    forward: Annotated[tuple[str, ...], _option("ENDPOINT", _FORWARD)] = ()
    keep_rates: Annotated[bool, _option(None, "Keep back their requests for other rates.", "--keep-rates")] = False
    journal: Annotated[Path | None, _option("FILE.jsonl", "Append every event as a line.")] = None
    journal_mb: Megabytes = 100.0  # size at which a new one is begun
    journal_keep: Kept = 9  # old ones that stay
    record: Annotated[Path | None, _option("FILE.tlog", "Append every frame that the link brings.")] = None
    record_mb: Megabytes = 1000.0  # size at which a new one is begun: some 3 h of 1 kHz
    record_keep: Kept = 9  # old ones that stay
    hook: Annotated[tuple[str, ...], _option("ADDRESS", _HOOK)] = ()
    history: Annotated[Text | None, _option("FILE|URL", _HISTORY)] = None
    flights: Annotated[Path | None, _option("DIR", _FLIGHTS)] = None
    metrics: Annotated[str | None, _option("HOST:PORT", "Serve Prometheus figures; a bare port is on loopback.")] = None
    web: Annotated[str | None, _option("HOST:PORT", _WEB)] = None
    web_token_file: Annotated[Path | None, _option("FILE", "Token of the live page: a file of mode 0600.")] = None
    web_names: tuple[Text, ...] = ()  # a proxy serves the page by these names and says who may: then without a token
    vehicle: Annotated[SystemId | None, _option("SYSID", "Watch this system id only.")] = None
    signing_key: Annotated[Path | None, _option("FILE", "Key of MAVLink 2 signing; refuse what is unsigned.")] = None
    max_vehicles: SystemId = 128  # further ones are not watched
    profile: Annotated[str | None, _option("NAME", "qdrone2, spec, ardupilot or px4.  [default: as sent]")] = None
    tick_s: Annotated[float, Field(ge=0.005, le=0.5)] = 0.05  # how often the daemon looks at its links

    @field_validator("*", mode="before")
    @classmethod
    def _named(cls, value: Any, info: ValidationInfo) -> Any:
        default = cls.model_fields[info.field_name or ""].default
        if value == "" and default is None:  # as a path: the present folder
            raise ValueError("is empty; name one, or leave it out")
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError("is a value, not true or false")
        return (value,) if isinstance(value, str) and isinstance(default, tuple) else value

    @field_validator(*CHECKS)
    @classmethod
    def _readable(cls, value: Any, info: ValidationInfo) -> Any:
        try:
            for text in value if isinstance(value, tuple) else () if value is None else (value,):
                CHECKS[info.field_name or ""](text)
        except UsageError as error:
            raise ValueError(str(error)) from error
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        every = self.baseline or self.learn or self.baselines
        if self.baseline is not None and self.learn is not None:
            raise ValueError("either --baseline FILE or --learn SECONDS, not both")
        if not every and not self.vehicles:
            raise ValueError("name a --baseline FILE, or --learn SECONDS of healthy flight")
        if not every and self.vehicle is not None and self.vehicle not in self.vehicles:
            raise ValueError(f"vehicle {self.vehicle} has no baseline here; name one in [vehicles.{self.vehicle}]")
        if self.ask_hz is not None and self.ask_hz < self.min_rate_hz:
            raise ValueError(f"ask_hz {self.ask_hz:g} is below min_rate_hz {self.min_rate_hz:g}: that would not do")
        for option in ("save", "airframe", "layout", "name"):
            if getattr(self, option) is not None and self.learn is None:
                raise ValueError(f"--{option} is about what --learn SECONDS learns; add --learn or leave it out")
        if (self.web_token_file is not None or self.web_names) and self.web is None:
            about = "--web-token-file and web_names are about the live page"
            raise ValueError(f"{about}; add --web HOST:PORT or leave it out")
        if (self.history is None) != (self.flights is None):
            raise ValueError("--history FILE|URL and --flights DIR go together")
        return self


def options() -> list[inspect.Parameter]:
    """The settings that have an option: each but flags and lists is a string until pydantic parses it."""
    found = []
    for name in (*Settings.__annotations__, *SessionSettings.__annotations__):
        field = Settings.model_fields.get(name)
        option = next((data for data in field.metadata if isinstance(data, OptionInfo)), None) if field else None
        if field is not None and option is not None:
            kind = list[str] if isinstance(field.default, tuple) else bool if field.annotation is bool else str
            annotation: Any = Annotated[kind | None, option]
            found.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation))
    return found


def example_text() -> str:
    """The documented example of a configuration file."""
    return Path(__file__).with_name("example.toml").read_text(encoding="utf-8")


def collect_values(
    path: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, str]]:
    """What was said, by key, before it is validated; and where each was said, for an error ("" for an option).

    path: a TOML file, None for none, or for the one that the environment names. overrides: what the command line said
    (None: nothing). environ: empty values do not count. Raises UsageError, naming the key.
    """
    given = {name: text for name, text in environ.items() if name.startswith(ENVIRONMENT) and text.strip()}
    named = given.pop(f"{ENVIRONMENT}CONFIG", None)
    path = Path(named) if path is None and named else path
    try:
        values = {} if path is None else read_toml(path)
    except InputError as error:
        raise UsageError(f"{error}; check --config") from error
    where = dict.fromkeys(values, f"{path}: ")
    for name, text in given.items():
        key = name.removeprefix(ENVIRONMENT).lower()
        if key not in Settings.model_fields or key == "vehicles":
            known = ", ".join(known for known in Settings.model_fields if known != "vehicles")
            raise UsageError(f"{name}: there is no such setting; known are {known}")
        # Lists are parted by blanks: a serial address has a comma in it.
        values[key] = text.split() if isinstance(Settings.model_fields[key].default, tuple) else text.strip()
        where[key] = f"{name}: "
    said = {key: value for key, value in overrides.items() if value is not None}
    return values | said, where | dict.fromkeys(said, "")


def load_settings(
    path: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str] | None = None
) -> Settings:
    """Settings from a file, the environment and the command line, each winning over those before; as `collect_values`.

    Raises UsageError, naming the key.
    """
    values, where = collect_values(path, overrides, environ or {})
    try:
        settings = Settings.model_validate(values)
    except ValidationError as error:
        raise UsageError(_reason(error, where)) from error
    if settings.web is not None:
        page_address(settings.web, settings.web_token_file, settings.web_names)
    for one, other in combinations(_ends(settings), 2):
        hosts, listen = {one[1], other[1]}, one[4] + other[4]
        local = all(is_loopback(ANY.get(host, host)) for host in hosts)  # 127.0.0.1 and 127.0.0.2 are two ends of it
        here = len(hosts) == 1 or (hosts & ANY.keys() and (local or listen == 2)) or (local and "localhost" in hosts)
        if one[2:4] == other[2:4] and here and listen:
            how = "listen on one port" if listen == 2 else "lead to each other"
            raise UsageError(f"{one[0]} and {other[0]} {how}; give each its own")
    return settings


def _ends(settings: Settings) -> Iterator[tuple[str, str, int, bool, bool]]:
    """The ends here: name, host, port, whether by UDP, and whether it listens. A port of 0 is any that is free."""
    for name, said in (("metrics", settings.metrics), ("web", settings.web)):
        if said is not None and (place := split_address(said, name))[1]:
            yield f"--{name} {said}", *place, False, True
    for address in (settings.connect, *settings.forward):
        kind, host, port = parse_address(address)
        if kind is not Kind.SERIAL and port:
            yield address, host, port, kind in (Kind.UDP_IN, Kind.UDP_OUT), kind in (Kind.UDP_IN, Kind.TCP_SERVER)


def page_address(web: str, token_file: Path | None, names: Sequence[str] = ()) -> tuple[str, int]:
    """Host and port of the live page; names: of the hosts that it answers to.

    Raises UsageError where others reach it and neither a token is asked for nor a name.
    """
    host, port = split_address(web, "web")
    if token_file is None and not is_loopback(host) and not names:
        raise UsageError(f"--web {web}: others reach {host}; name a --web-token-file FILE, or 127.0.0.1")
    return host, port


def split_address(text: str, what: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`; a bare port is on loopback. what: it is of. Raises UsageError.

    >>> split_address("9100", "metrics")
    ('127.0.0.1', 9100)
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65_535:
        raise UsageError(f"malformed {what} address {text!r}: write HOST:PORT, or a port alone for loopback")
    return host.strip("[]") or LOOPBACK, int(port)


def _reason(error: ValidationError, where: Mapping[str, str]) -> str:
    first = error.errors()[0]
    steps = [str(step) for step in first["loc"] if step != "[key]"]
    place = where.get(steps[0], "") if steps else next((said for said in where.values() if said), "")
    key = ".".join(steps)
    if first["type"] == "extra_forbidden":
        known = Settings if len(steps) == 1 else VehicleSettings
        return f"{place}unknown key {key!r}; known are {', '.join(known.model_fields)}"
    message = first["msg"].removeprefix("Value error, ").partition(" for <class")[0]
    return f"{place}{key}: {message}" if key else f"{place}{message}"
