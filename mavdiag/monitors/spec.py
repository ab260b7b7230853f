"""What every stored fit is: a frozen dataclass that pydantic checks, made in Python or read from JSON."""

from dataclasses import fields
from typing import Annotated, Any, TypeAlias, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass

from mavdiag.errors import InputError
from mavdiag.rows.quality import NotNegative as NotNegative

Positive: TypeAlias = Annotated[float, Field(gt=1e-100, lt=1e100)]  # its square is neither zero nor infinite
Period: TypeAlias = Annotated[float, Field(ge=1e-4, le=1)]  # [s], of rows: 10 kHz to 1 Hz
Span: TypeAlias = Annotated[float, Field(gt=0, le=600)]  # [s], of windows and memories: 20 times the longest
Delay: TypeAlias = Annotated[float, Field(ge=0, le=60)]  # [s], hundreds of times the longest of the rate filters

Made = TypeVar("Made", bound=type[Any])


@dataclass_transform(frozen_default=True, kw_only_default=True)
def spec(made: Made) -> Made:
    """A class as a frozen dataclass of finite numbers within their bounds.

    Made in Python, it raises InputError, naming its kind and the field; where it is read, pydantic's ValidationError.
    """
    config = ConfigDict(extra="forbid", allow_inf_nan=False)
    found: Any = dataclass(frozen=True, kw_only=True, slots=True, config=config)(made)
    plain = found.__init__

    def checked(self: Any, **given: Any) -> None:
        try:
            plain(self, **given)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False, include_input=False)[0]
            kind = next((one.default for one in fields(found) if one.name == "kind"), made.__name__)
            raise InputError(f"{kind}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error

    found.__init__ = checked
    return found  # type: ignore[no-any-return]
