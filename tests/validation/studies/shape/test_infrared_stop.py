"""The near-infrared stop of a camera, and the camera with another shape in its place."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.camera import stops
from validation.studies.shape import masks
from validation.studies.shape.infrared_stop import infrared_stop, with_disc, with_mask


def test_the_infrared_stop_is_the_hole_and_a_lens_for_visible_light_has_none(camera: dasim.Camera) -> None:
    assert infrared_stop(camera).name == "hole"
    visible = camera.model_copy(update={"stops": tuple(one for one in camera.stops if one.name != "hole")})
    with pytest.raises(dasim.InputError, match="no stop that passes 730 nm"):
        infrared_stop(visible)


def test_another_shape_keeps_the_bands_and_the_other_stops(camera: dasim.Camera) -> None:
    hole = infrared_stop(camera)
    mask = masks.disc(32, 0.3)
    for variant, area in ((with_disc(camera, 0.3), 0.09), (with_mask(camera, mask), masks.budget(mask))):
        changed = infrared_stop(variant)
        assert (changed.name, changed.passes_nm, changed.edge_width_nm) == (
            hole.name,
            hole.passes_nm,
            hole.edge_width_nm,
        )
        assert stops.open_area(changed) == pytest.approx(area, rel=1e-3)  # transmittances have four digits
        assert [one for one in variant.stops if one.name != hole.name] == [
            one for one in camera.stops if one.name != hole.name
        ]


def test_a_mask_that_is_closed_everywhere_is_refused(camera: dasim.Camera) -> None:
    with pytest.raises(dasim.InputError, match="closed everywhere"):
        with_mask(camera, np.zeros((16, 16)))
