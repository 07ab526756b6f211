"""The lights of a scene as data: lengths in scene coordinates, centimetres; levels in lux."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from dasim.specification import Specification

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Lux = Annotated[float, Field(ge=1e-6, le=1e7)]  # from less than starlight to many suns


class Dome(Specification):
    """Even light from everywhere; ``lux`` is what an unshadowed surface receives."""

    kind: Literal["dome"]
    illuminant: str
    lux: Lux


class Lamp(Specification):
    """A round, flat lamp that faces its target; ``lux`` is what a surface there facing the lamp receives."""

    kind: Literal["lamp"]
    illuminant: str
    lux: Lux
    position_cm: Vector
    target_cm: Vector
    radius_cm: Positive

    @model_validator(mode="after")
    def _not_at_target(self) -> Lamp:
        if np.allclose(self.position_cm, self.target_cm):
            raise ValueError("position_cm and target_cm must differ")
        return self


Light = Annotated[Dome | Lamp, Field(discriminator="kind")]
