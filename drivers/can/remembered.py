"""Numbers that a decoder's memory may hold: what a damaged file holds instead must not stop it later."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

Count = Annotated[int, Field(ge=0, lt=2**63)]
TimeNs = Annotated[int, Field(ge=-(2**63), lt=2**63)]
RawNumber = Annotated[int, Field(ge=-(2**63), lt=2**64)]  # of a signal of up to 64 bits
RateHz = Annotated[float, Field(ge=0, allow_inf_nan=False)]
