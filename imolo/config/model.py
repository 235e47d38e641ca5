"""The base of every configuration model: immutable, with units in the field descriptions, and no unknown keys."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[float, float, float]


class Model(BaseModel):
    """Immutable and strict about its keys; a default is written once, in the field that holds it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)


@dataclass(frozen=True)
class Searched:
    """Metadata of a setting that a fit may search: in which range, and whether steps or ratios of it matter."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "log"
