"""Types of the numbers in vehicle files: what each may be."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

__all__ = ["STRICT", "Finite", "NotNegative", "Positive", "PositiveVector", "Share", "Vector"]

Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share: TypeAlias = Annotated[float, Field(ge=0, lt=1)]
Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Vector: TypeAlias = tuple[Finite, Finite, Finite]
PositiveVector: TypeAlias = tuple[Positive, Positive, Positive]

STRICT: Literal["forbid"] = "forbid"  # a misspelt key in the file is an error, not a default
