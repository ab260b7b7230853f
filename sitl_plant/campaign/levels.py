"""The levels of a design's factors as a user gives them: "factor=level,level"."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from mavdiag.errors import UsageError
from sitl_plant.campaign.causes import causes_named
from sitl_plant.campaign.conditions import CONDITIONS, MANOEUVRES, parse_link
from sitl_plant.campaign.plan import Design

__all__ = ["with_conditions"]

# Factors whose levels are numbers, and their ranges.
RANGES = {"phenomenology": (0.0, 1.0), "wind": (0.0, 10.0), "payload": (0.0, 1000.0), "loss": (0.0, 0.9)}
EVERY = "all"  # every condition


def with_conditions(design: Design, filters: Sequence[str]) -> Design:
    """The design with the levels of some factors replaced, each given as "factor=level,level".

    Raises UsageError for an unknown factor or level.
    """
    changed: dict[str, Any] = {}
    for text in filters:
        factor, _, levels = (part.strip() for part in text.partition("="))
        wanted = tuple(level.strip() for level in levels.split(",") if level.strip())
        if not wanted:
            raise UsageError(f"--conditions {text}: give it as FACTOR=LEVEL,LEVEL")
        match factor:
            case "cause":
                changed[factor] = causes_named(wanted)
            case "manoeuvre":
                changed[factor] = _named(factor, wanted, MANOEUVRES)
            case "condition":
                names = tuple(CONDITIONS) if wanted == (EVERY,) else _named(factor, wanted, CONDITIONS)
                changed[factor] = tuple(dict.fromkeys(names))
            case "link":
                changed[factor] = wanted
                for one in wanted:
                    parse_link(one)
            case "rotor":
                changed[factor] = _rotors(wanted, len(design.vehicle.rotors))
            case number if number in RANGES:
                changed[factor] = _numbers(factor, wanted, *RANGES[number])
            case other:
                raise UsageError(
                    f"no factor {other!r}: give cause, rotor, manoeuvre, condition, link, {', '.join(RANGES)}"
                )
    return replace(design, **changed)


def _named(factor: str, wanted: tuple[str, ...], table: Mapping[str, object]) -> tuple[str, ...]:
    if unknown := set(wanted) - table.keys():
        raise UsageError(f"no {factor} {min(unknown)!r}: give one of {', '.join(table)}")
    return wanted


def _rotors(texts: Sequence[str], rotors: int) -> tuple[int, ...]:
    if not set(texts) <= {str(rotor) for rotor in range(1, rotors + 1)}:
        raise UsageError(f"rotor must be 1 to {rotors}, not {', '.join(texts)}")
    return tuple(int(text) for text in texts)


def _numbers(factor: str, texts: Sequence[str], low: float, high: float) -> tuple[float, ...]:
    values = tuple(_number(factor, text) for text in texts)
    if not all(low <= value <= high for value in values):
        raise UsageError(f"{factor} must be {low:g} to {high:g}, not {', '.join(texts)}")
    return values


def _number(factor: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{factor} must be a number, not {text!r}") from None
