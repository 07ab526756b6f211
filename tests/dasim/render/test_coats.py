"""Light from bases beneath coats: which BSDFs count, the coat's transmittance, and pictures against path tracing."""

import numpy as np
import pytest

import dasim
from dasim.render import coats, passes, translate
from dasim.scene import specification as scenes

INDEX = 1.5
LAMP = {"kind": "lamp", "illuminant": "A", "lux": 400, "radius_cm": 3}
LAMP |= {"position_cm": (-40, -30, 10), "target_cm": (0, 0, 40)}
DOME = {"kind": "dome", "illuminant": "A", "lux": 300}
SIZE_PX = 48, 36


def bsdf(description):
    import mitsuba as mi

    return mi.load_dict(description)


def test_only_coats_over_one_base_are_found(jit) -> None:
    import drjit as dr
    import mitsuba as mi

    coat, matt = {"type": "roughplastic"}, {"type": "diffuse"}
    found = [coat, {"type": "plastic"}, {"type": "twosided", "bsdf": coat}]
    others = [
        matt,
        {"type": "twosided", "bsdf": matt},
        {"type": "twosided", "front": coat, "back": matt},
        {"type": "blendbsdf", "weight": 0.5, "first": coat, "second": matt},
        {"type": "principled"},
        {"type": "bumpmap", "texture": {"type": "checkerboard"}, "bsdf": coat},
        {"type": "roughconductor"},
    ]
    bsdfs = [bsdf(description) for description in [*found, *others]]
    spheres = {f"sphere-{number}": {"type": "sphere", "bsdf": each} for number, each in enumerate(bsdfs)}
    entries = coats.table(mi.load_dict({"type": "scene", **spheres}, optimize=False))
    result = [coats.coated(entries, mi.BSDFPtr(each), dr.full(mi.Bool, True))[0] for each in bsdfs]
    assert result == [True] * len(found) + [False] * len(others)


def test_transmittance_is_that_of_fresnel_equations(jit) -> None:
    """Unpolarised, at a smooth surface, over that at normal incidence."""
    import drjit as dr
    import mitsuba as mi

    cosine = np.array([1.0, 0.8, 0.5, 0.2])
    inside = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    parallel = (INDEX * cosine - inside) / (INDEX * cosine + inside)
    across = (cosine - INDEX * inside) / (cosine + INDEX * inside)
    passed = 1 - (parallel**2 + across**2) / 2
    plugin = bsdf({"type": "plastic", "int_ior": INDEX, "ext_ior": 1.0})
    for side in (1, -1):  # of the surface, as seen by a twosided one
        si = dr.zeros(mi.SurfaceInteraction3f, len(cosine))
        si.sh_frame, si.wi = mi.Frame3f(mi.Normal3f(0, 0, 1)), mi.Vector3f(0.6, 0.0, 0.8 * side)
        si.wavelengths = mi.Spectrum(550.0)
        way = mi.Vector3f(0.0, mi.Float(np.sqrt(1 - cosine**2)), side * mi.Float(cosine))
        twosided = bsdf({"type": "twosided", "bsdf": plugin})
        result = coats.transmittance(mi.BSDFPtr(twosided), si, way, mi.Bool(True))
        assert np.array(result) == pytest.approx(passed / passed[0], abs=1e-4)
    assert np.array(coats.transmittance(mi.BSDFPtr(plugin), si, way, mi.Bool(False))) == pytest.approx(1.0)


@pytest.fixture(scope="module")
def coated_room(make_scene):
    """A rough and a smooth ball and a slanted board, all coated, between a red floor and a textured wall."""
    coat = {"kind": "coated", "roughness": 0.2, "refractive_index": INDEX}
    print_ = {"kind": "print", "image": "skimage:chelsea"}
    return make_scene(
        {"name": "floor", "shape": "plane", "size_cm": (200, 200), "position_cm": (0, 8, 40)}
        | {"rotation_deg": (-90, 0, 0), "material": "checker-red"},
        {"name": "wall", "shape": "plane", "size_cm": (300, 300), "position_cm": (0, 0, 70), "material": "denim"},
        {"name": "rough", "shape": "sphere", "radius_cm": 5, "position_cm": (-9, 2.9, 42), "material": "rough"},
        {"name": "smooth", "shape": "sphere", "radius_cm": 5, "position_cm": (9, 2.9, 42), "material": "smooth"},
        {"name": "board", "shape": "plane", "size_cm": (9, 12), "position_cm": (0, 1.5, 46)}
        | {"rotation_deg": (0, 30, 0), "material": "board"},
        lights=(LAMP, DOME),
        materials={
            "rough": coat | {"base": "ink-yellow"},
            "smooth": coat | {"base": "ceramic-white", "roughness": 0.0},
            "board": coat | {"base": print_},
        },
    )


@pytest.mark.slow
def test_pictures_of_coats_are_those_of_path_tracing(jit, coated_room, wide, monkeypatch) -> None:
    """Rationale: the light of the base, from the irradiance field, and gloss, by rays, must add up to the light that a
    path tracer finds, with nothing counted twice and nothing left out.

    Expectation: means of 6 x 6 pixels agree within 1 % (root mean square), and those of the objects within 0.5 %; with
    16 samples, most pixels of the objects have a third of the noise. Without the transmittance of the coat towards the
    light, the objects get at least 1 % too much.
    """
    camera = wide(*SIZE_PX)
    world, spectrum = translate.load(coated_room), scenes.light_spectrum(coated_room)
    objects = np.array(dasim.simulate(coated_room, camera, spp=1).truth.object_id) > 2
    assert objects.mean() > 0.1

    def picture(field, spp, seed=3):
        return passes.pinhole_pass(world, camera, passes.Sampling(spp, seed), field)

    def field():
        return passes.irradiance_field(world, camera, spectrum, 0.0, 64, 1)

    right = field()
    traced, ours = picture(None, 2048), picture(right, 512)
    blocks = [part.reshape(6, 6, 8, 6, -1).mean(axis=(1, 3)) for part in (traced, ours)]
    assert np.sqrt(np.mean((blocks[1] / blocks[0] - 1) ** 2)) < 0.01
    assert ours[objects].mean(axis=0) == pytest.approx(traced[objects].mean(axis=0), rel=0.005)
    noise = [np.median(np.abs((picture(own, 16) / ours - 1)[objects])) for own in (None, right)]
    assert noise[1] < noise[0] / 3

    monkeypatch.setattr(coats, "transmittance", lambda *arguments: 1.0)
    assert picture(field(), 64)[objects].mean() > 1.01 * ours[objects].mean()
