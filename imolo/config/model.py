"""The base of every configuration model: immutable, with units in the field descriptions, and no unknown keys."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[float, float, float]


class Model(BaseModel):
    """Immutable and strict about its keys; a default is written once, in the field that holds it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)
