"""Airframes from TOML files: the file of a user, or one of those that are shipped in this folder (docs/airframe.md).

A rotor is either where it is (x_m, y_m, spin, in FRD from the centre of gravity, seen from above) or what its thrust
does (roll, pitch, yaw, in any scale). What a file leaves out is not known, and an unknown key is an error.
"""

from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Discriminator, Field, PositiveFloat, Tag, ValidationError

from mavdiag.airframe.airframe import Airframe, Scope
from mavdiag.airframe.balance import FASTEST_RPM
from mavdiag.airframe.layout import LAYOUTS, Place, RotorLayout, layout_at, layout_named, layout_of_effects
from mavdiag.errors import InputError, UsageError
from mavdiag.rows.gate import GateSpec, Height, Share, Span
from mavdiag.storage import parse_toml, read_toml
from mavdiag.units import RPM

#: Names of the airframes that are shipped.
BUILTIN = ("crazyflie", "qdrone2", "qdrone2-recorded")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _Place(_Table):
    x_m: Annotated[float, Field(ge=-100, le=100)]
    y_m: Annotated[float, Field(ge=-100, le=100)]
    spin: Literal["cw", "ccw"]


_Effective: TypeAlias = Annotated[float, Field(ge=-1e6, le=1e6)]


class _Effect(_Table):
    roll: _Effective
    pitch: _Effective
    yaw: _Effective


_Rotor: TypeAlias = Annotated[
    Annotated[_Place, Tag("place")] | Annotated[_Effect, Tag("effect")],
    Discriminator(lambda raw: "effect" if isinstance(raw, dict) and raw.keys() & {"roll", "pitch", "yaw"} else "place"),
]


class _Gate(_Table):
    min_height_m: Height | None = None
    min_thrust: Share | None = None
    need_armed: bool = True
    trim_start_s: Span = 3.0
    trim_end_s: Span = 0.0


class _File(_Table):
    name: Annotated[str, Field(min_length=1)]
    scope: Scope = "airframe"
    layout: str | None = None
    rotors: list[_Rotor] = []
    outputs: list[Annotated[int, Field(ge=1, le=32)]] | None = None
    mass_kg: PositiveFloat | None = None
    hover_rpm: Annotated[float, Field(gt=0, le=FASTEST_RPM)] | None = None
    imu_corner_hz: PositiveFloat | None = None
    gate: _Gate | None = None
    classifier: str | None = None


def airframe_from(text: str) -> Airframe:
    """Read the airframe that a user means: one of `BUILTIN`, or a TOML file. Raises UsageError if it is neither."""
    named = text in BUILTIN or not Path(text).is_file()
    return airframe_named(text) if named else load_airframe(Path(text))


def airframe_named(name: str) -> Airframe:
    """Read one of `BUILTIN`. Raises UsageError for another name."""
    if name not in BUILTIN:
        raise UsageError(f"no airframe {name!r}: give a TOML file or one of {', '.join(BUILTIN)}")
    file = resources.files("mavdiag.airframe") / f"{name}.toml"
    return _parse(parse_toml(file.read_text(encoding="utf-8"), file.name), file.name)


def with_layout(airframe: Airframe, name: str) -> Airframe:
    """The airframe with a known rotor layout. Raises UsageError if there is none of that name, or it has another."""
    layout = layout_named(name)
    if airframe.layout is not None and airframe.layout.signs != layout.signs:
        told = airframe.layout.name
        raise UsageError(f"airframe {airframe.name} has the layout {told}, not {name}: give one of them")
    return replace(airframe, layout=layout)


def load_airframe(path: Path) -> Airframe:
    """Read an airframe file. Raises InputError, naming the file and the key, if it cannot be used."""
    return _parse(read_toml(path), str(path))


def _parse(table: dict[str, Any], file: str) -> Airframe:
    about = ""
    try:
        found = _File.model_validate(table)
        about = "rotors" if found.rotors else "layout"
        layout = _layout(found)
        about = "outputs"
        return Airframe(
            **found.model_dump(include={"name", "scope", "mass_kg", "imu_corner_hz", "classifier"}),
            layout=layout,
            outputs=None if found.outputs is None else tuple(found.outputs),
            hover_rad_s=None if found.hover_rpm is None else found.hover_rpm * RPM,
            gate=None if found.gate is None else GateSpec(**found.gate.model_dump()),
        )
    except ValidationError as error:
        first = error.errors()[0]
        steps = [step for step in first["loc"] if step not in ("place", "effect")]
        key = ".".join(str(step + 1) if isinstance(step, int) else step for step in steps)  # rotors count from 1
        reason = "no such key" if first["type"] == "extra_forbidden" else first["msg"]
        raise InputError(f"{file}: {key}: {reason}") from error
    except UsageError as error:
        raise InputError(f"{file}: {about}: {error}") from error


def _layout(found: _File) -> RotorLayout | None:
    if found.layout is not None:
        if found.rotors:
            raise UsageError("give either rotors or the name of a layout, not both")
        return layout_named(found.layout)
    if not found.rotors:
        return None
    if found.name in LAYOUTS:
        raise UsageError(f"{found.name} is a known layout: give these rotors another name")
    places = [Place(one.x_m, one.y_m, one.spin) for one in found.rotors if isinstance(one, _Place)]
    effects = [(one.roll, one.pitch, one.yaw) for one in found.rotors if isinstance(one, _Effect)]
    if places and effects:
        raise UsageError("give all rotors as places or all as effects")
    return layout_at(found.name, places) if places else layout_of_effects(found.name, effects)
