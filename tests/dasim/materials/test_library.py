"""Materials from visible to near-infrared, and materials made from photographs."""

from __future__ import annotations

import itertools
from pathlib import Path

import colour
import cv2
import numpy as np
import pytest
from pydantic import TypeAdapter

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.materials import library
from dasim.materials.library import NEAR_INFRARED_RULES, Blend, Coated, Diffuse, Glass, Metal, Mixture, Print, Texture
from dasim.scene import checks
from dasim.scene.specification import Scene
from dasim.spectra import illuminants
from dasim.spectra.grid import WAVELENGTH_NM

INK_LIMIT = 0.03  # of the paper, from 760 nm: cyan's long tail


def weighted(surface, y: int, x: int) -> list[tuple[float, np.ndarray]]:
    """Shares and reflectances of all components at a pixel of a texture."""
    if isinstance(surface, Diffuse):
        return [(1.0, surface.reflectance)]
    assert isinstance(surface, Mixture)
    share = float(surface.weight[y, x])
    first = [((1 - share) * w, curve) for w, curve in weighted(surface.first, y, x)]
    return first + [(share * w, curve) for w, curve in weighted(surface.second, y, x)]


def colour_of(surface, y: int, x: int) -> np.ndarray:
    return sum(share * curve for share, curve in weighted(surface, y, x))


@pytest.fixture
def photograph(tmp_path):
    """A picture of given 8-bit sRGB colours, one per column."""

    def write(*rgb: tuple[int, int, int]) -> Path:
        data = np.array([rgb, rgb], np.uint8)[..., ::-1]
        assert cv2.imwrite(str(tmp_path / "colours.png"), data)
        return tmp_path

    return write


def test_library_resolves_every_name(tmp_path):
    """Expectation: each name is a surface of the kind it is listed as; those that are diffuse have a reflectance."""
    kinds = {"diffuse": Diffuse, "metal": Metal, "glass": Glass, "coated": Coated}
    assert len(library.material_names()) == len(set(library.material_names())) >= 70
    for name in library.material_names():
        kind, source = library.kind_and_source(name)
        surface = library.surface(name, tmp_path)
        assert isinstance(surface, kinds[kind]) and len(source) > 10
        if kind == "diffuse":
            np.testing.assert_array_equal(surface.reflectance, library.reflectance(name))


def test_unknown_names_are_the_users_mistake(tmp_path):
    with pytest.raises(InputError, match=r"material 'bricks' is unknown; .*dasim list materials.*did you mean .brick"):
        library.reflectance("bricks")
    with pytest.raises(InputError, match="material 'gold' is not diffuse"):
        library.reflectance("gold")
    with pytest.raises(InputError, match=r"image 'me\.png': no such file in .* \(or 'skimage:NAME'"):
        library.surface(Blend(kind="blend", image="me.png", dark="soil", bright="sand"), tmp_path)
    with pytest.raises(InputError, match=r"image 'skimage:lena': .*; there are .*brick"):
        library.surface(Print(kind="print", image="skimage:lena"), tmp_path)
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match=r"image 'text\.png': .* cannot be read as a picture"):
        library.surface(Print(kind="print", image="text.png"), tmp_path)
    cv2.imwrite(str(tmp_path / "colours.png"), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(InputError, match=r"material 'golden' is unknown; .*did you mean .gold"):
        library.surface(Blend(kind="blend", image="colours.png", dark="golden", bright="sand"), tmp_path)


def test_blend_mixes_in_linear_light(photograph):
    """Set-up: black, white, and sRGB 188, whose luminance is 0.503 (IEC 61966-2-1).

    Expectation: the dark material, the bright one, and their mean: the same share at every wavelength.
    """
    folder = photograph((0, 0, 0), (255, 255, 255), (188, 188, 188))
    surface = library.surface(Blend(kind="blend", image="colours.png", dark="soil", bright="sand"), folder)
    soil, sand = library.reflectance("soil"), library.reflectance("sand")
    np.testing.assert_allclose(colour_of(surface, 0, 0), soil, rtol=1e-6)
    np.testing.assert_allclose(colour_of(surface, 0, 1), sand, rtol=1e-6)
    np.testing.assert_allclose(colour_of(surface, 0, 2), 0.497 * soil + 0.503 * sand, rtol=2e-3)
    red, green = photograph((255, 0, 0), (0, 255, 0)), None
    surface = library.surface(Blend(kind="blend", image="colours.png", dark="soil", bright="sand"), red)
    red, green = (np.ptp((colour_of(surface, 0, x) - soil) / (sand - soil)) for x in (0, 1))
    assert max(red, green) < 1e-5, "colours of the photograph do not tint the near-infrared"


def test_print_of_white_is_paper_and_of_black_is_carbon(photograph):
    folder = photograph((255, 255, 255), (0, 0, 0))
    surface = library.surface(Print(kind="print", image="colours.png", black_generation=1.0), folder)
    np.testing.assert_allclose(colour_of(surface, 0, 0), library.reflectance("white-paper"), rtol=1e-6)
    np.testing.assert_allclose(colour_of(surface, 0, 1), library.reflectance("carbon-black"), rtol=1e-5)


def test_print_vanishes_in_the_near_infrared_except_its_black(photograph):
    """Rationale: process inks are transparent there; what a colour picture shows in the near-infrared is its black.

    Expectation: without black ink any colour is paper beyond 760 nm, though it differs from paper where it is seen;
    with black ink, grey is darker there by that ink's share (0.6 of a coverage of 0.784).
    """
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (0, 255, 255), (255, 255, 0), (0, 0, 0), (128, 128, 128)]
    folder = photograph(*colours)
    near = WAVELENGTH_NM >= 760
    paper = library.reflectance("white-paper")
    plain = library.surface(Print(kind="print", image="colours.png", black_generation=0.0), folder)
    for x in range(len(colours)):
        spectrum = colour_of(plain, 0, x)
        assert np.abs(spectrum[near] / paper[near] - 1).max() < INK_LIMIT, colours[x]
        assert (spectrum[~near] / paper[~near]).min() < 0.6, colours[x]
    grey = colour_of(library.surface(Print(kind="print", image="colours.png"), folder), 0, 6)
    black = 0.6 * (1 - 0.2158605)  # sRGB 128 in linear light
    expected = (1 - black) * paper + black * library.reflectance("carbon-black")
    assert np.abs(grey[near] / expected[near] - 1).max() < INK_LIMIT


def test_demichel_shares_are_products_and_sum_to_one(photograph):
    """Expectation: nine areas (eight overprints and black) that cover the paper, each overprint the product of its
    inks' coverages (Demichel), written out here for coverages of 1 - 0.2159, 1 - 0.5029 and 1 - 0.8796.
    """
    folder = photograph((128, 188, 241))
    surface = library.surface(Print(kind="print", image="colours.png", black_generation=0.0), folder)
    shares = [share for share, _ in weighted(surface, 0, 0)]
    assert len(shares) == 9 and min(shares) >= 0
    assert sum(shares) == pytest.approx(1.0, abs=1e-6)
    linear = [0.2158605, 0.5028865, 0.8796224]
    expected = [np.prod(choice) for choice in itertools.product(*[(value, 1 - value) for value in linear])]
    np.testing.assert_allclose(sorted(shares), sorted([*expected, 0.0]), atol=1e-5)


def test_print_looks_like_its_photograph(photograph):
    """Expectation: each primary's print is brightest in its own third of the visible band."""
    folder = photograph((255, 0, 0), (0, 255, 0), (0, 0, 255))
    surface = library.surface(Print(kind="print", image="colours.png"), folder)
    thirds = [(600, 680), (520, 570), (420, 480)]
    for x in range(3):
        curve = colour_of(surface, 0, x)
        means = [curve[(WAVELENGTH_NM >= low) & (WAVELENGTH_NM <= high)].mean() for low, high in thirds]
        assert np.argmax(means) == x


# --- near-infrared rules -------------------------------------------------------------------------

COLOUR_LIMIT = 2.0  # CIEDE2000 of the achromatic rule: red loses what it would reflect beyond 650 nm
GREY_COLOUR_LIMIT = 0.2  # of greys: the basis sums to one, so only the table's own white is left
CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=3)), np.float32)[None]
NEAR = WAVELENGTH_NM >= 720


def perceived(reflectance: np.ndarray) -> np.ndarray:
    """CIELAB of a reflectance under D65, 1931 observer; white is the perfect diffuser."""
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    matching = np.stack([np.interp(WAVELENGTH_NM, observer.wavelengths, column) for column in observer.values.T])
    power = illuminants.illuminant("D65")
    white = matching @ power
    return colour.XYZ_to_Lab(matching @ (power * reflectance) / white[1], white[:2] / white.sum())


def screen(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB, white D65."""
    return colour.XYZ_to_Lab(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ @ rgb, (0.3127, 0.3290))


@pytest.mark.parametrize("rule", NEAR_INFRARED_RULES)
def test_every_rule_mixes_shares_of_spectra_between_0_and_1(rule):
    image = np.random.default_rng(0).random((3, 4, 3)).astype(np.float32)
    surface = library.photograph_surface(image, rule, (2.0, 1.0))
    for y, x in itertools.product(range(3), range(4)):
        parts = weighted(surface, y, x)
        assert sum(share for share, _ in parts) == pytest.approx(1.0, abs=1e-5)
        assert min(share for share, _ in parts) >= -1e-6
        assert all(curve.min() >= 0 and curve.max() <= 1 for _, curve in parts)
    assert surface.repeat == surface.first.repeat == (2.0, 1.0)


def test_achromatic_rule_keeps_the_colour_and_is_grey_beyond():
    """Expectation: the photograph's colour under D65; beyond 680 nm the luminance at every wavelength."""
    image = np.random.default_rng(1).random((1, 40, 3)).astype(np.float32) ** 2
    grey = np.linspace(0.02, 1, 8, dtype=np.float32)[None, :, None].repeat(3, axis=-1)
    for pixels, limit in ((image, COLOUR_LIMIT), (grey, GREY_COLOUR_LIMIT)):
        surface = library.photograph_surface(pixels, "achromatic")
        for x in range(pixels.shape[1]):
            spectrum = colour_of(surface, 0, x)
            assert colour.delta_E(perceived(spectrum), screen(pixels[0, x]), method="CIE 2000") < limit, pixels[0, x]
            luminance = pixels[0, x] @ [0.2126, 0.7152, 0.0722]
            np.testing.assert_allclose(spectrum[WAVELENGTH_NM >= 680], luminance, atol=2e-3)


def test_dyed_rule_hides_every_colour_in_the_near_infrared():
    """Expectation: from 750 nm all eight corners of the cube reflect what undyed cotton does, black included; where
    they are seen, white is the fabric, black is dark, and each colour is nearest to its own of the screen's.
    """
    surface = library.photograph_surface(CORNERS, "dyed")
    spectra = [colour_of(surface, 0, x) for x in range(8)]
    fabric = library.reflectance("cotton-undyed")
    for spectrum in spectra:
        assert (spectrum / fabric)[WAVELENGTH_NM >= 750].min() > 0.95
    np.testing.assert_allclose(spectra[7], fabric, rtol=1e-6)
    assert spectra[0][WAVELENGTH_NM <= 670].max() < 0.06
    targets = [screen(corner) for corner in CORNERS[0]]
    for number, spectrum in enumerate(spectra):
        distances = [colour.delta_E(perceived(spectrum), target, method="CIE 2000") for target in targets]
        assert np.argmin(distances) == number, distances


def test_print_rule_is_the_material_print(photograph):
    folder = photograph((200, 90, 30), (10, 20, 30))
    by_kind = library.surface(Print(kind="print", image="colours.png"), folder)
    by_rule = library.surface(texture(kind="photo", rule="print", image="colours.png"), folder)
    for x in range(2):
        np.testing.assert_array_equal(colour_of(by_kind, 0, x), colour_of(by_rule, 0, x))


def test_rules_differ_where_it_matters():
    """Expectation: black in the near-infrared is dark as a print (its black ink is carbon) and as a pigment, bright
    as a dyed fabric.
    """
    black = np.zeros((1, 1, 3), np.float32)
    colours = {rule: colour_of(library.photograph_surface(black, rule), 0, 0)[NEAR] for rule in NEAR_INFRARED_RULES}
    assert colours["achromatic"].max() < 0.01 < colours["print"].mean() < 0.6 * colours["dyed"].mean()


@pytest.mark.parametrize(
    ("image", "rule", "message_part"),
    [
        (np.zeros((2, 2, 3)), "upsampled", "'upsampled' is unknown; .* 'print', 'dyed', 'achromatic'"),
        (np.zeros((2, 2)), "dyed", r"\[h, w, 3\]"),
        (np.full((2, 2, 3), 1.2), "dyed", "from 0 to 1"),
        (np.full((2, 2, 3), np.nan), "dyed", "from 0 to 1"),
    ],
)
def test_photographs_that_are_none_are_refused(image, rule, message_part):
    with pytest.raises(InputError, match=message_part):
        library.photograph_surface(image, rule)


def test_16_bit_photographs_are_as_bright_as_8_bit_ones(tmp_path):
    values = np.array([[0, 60, 128, 200, 255]], np.uint8)
    cv2.imwrite(str(tmp_path / "eight.png"), values)
    cv2.imwrite(str(tmp_path / "sixteen.png"), values.astype(np.uint16) * 257)
    eight, sixteen = (
        library.surface(texture(kind="blend", image=f"{name}.png", dark="soil", bright="sand"), tmp_path).weight
        for name in ("eight", "sixteen")
    )
    np.testing.assert_allclose(eight, sixteen, atol=1e-6)


# --- mixtures, coats and spectra of one's own ----------------------------------------------------


def texture(**data) -> Texture:
    return TypeAdapter(Texture).validate_python(data)


def test_mix_lays_materials_over_each_other(tmp_path):
    """Set-up: a mask of 0, 128 and 255; a second layer with a uniform mask of 51 (a fifth) on top.

    Expectation: mask values are shares, without sRGB decoding; the last layer covers a fifth of everything.
    """
    cv2.imwrite(str(tmp_path / "mask.png"), np.array([[0, 128, 255]], np.uint8))
    cv2.imwrite(str(tmp_path / "even.png"), np.full((1, 3), 51, np.uint8))
    layers = [{"material": "sand", "mask": "mask.png"}, {"material": "leaf-green", "mask": "even.png"}]
    surface = library.surface(texture(kind="mix", base="soil", layers=layers), tmp_path)
    soil, sand, leaf = (library.reflectance(name) for name in ("soil", "sand", "leaf-green"))
    for x, share in enumerate((0.0, 128 / 255, 1.0)):
        expected = 0.8 * ((1 - share) * soil + share * sand) + 0.2 * leaf
        np.testing.assert_allclose(colour_of(surface, 0, x), expected, rtol=1e-5)


def test_parts_may_be_described_in_place(tmp_path):
    poster = {"kind": "photo", "rule": "dyed", "image": "skimage:coffee"}
    surface = library.surface(texture(kind="coated", base=poster, roughness=0.05), tmp_path)
    assert isinstance(surface, Coated) and isinstance(surface.base, Mixture)
    gilded = {"material": {"kind": "metal", "metal": "gold", "roughness": 0.3}, "mask": "pattern:checkerboard"}
    surface = library.surface(texture(kind="mix", base="porcelain", layers=[gilded]), tmp_path)
    assert isinstance(surface.first, Coated) and surface.second == Metal("Au", 0.3)


def test_spectrum_of_ones_own(tmp_path):
    """Expectation: linear interpolation between the points, from a file or in place; points outside the band are
    ignored.
    """
    points = [(380.0, 1.7), (390.0, 0.2), (600.0, 0.8), (900.0, 0.2)]
    rows = "".join(f"{nm}, {value}\n" for nm, value in points)
    (tmp_path / "mine.csv").write_text(f"# my paint\nwavelength_nm, reflectance\n{rows}")
    expected = np.interp(WAVELENGTH_NM, *np.transpose(points))
    for source in ({"file": "mine.csv"}, {"points": points}):
        surface = library.surface(texture(kind="spectrum", **source), tmp_path)
        np.testing.assert_allclose(surface.reflectance, expected, rtol=1e-12)


FULL = [(400, 0.5), (830, 0.5)]


@pytest.mark.parametrize(
    ("points", "message_part"),
    [
        ([(400, 0.5), (780, 0.5)], "from 400 to 780 nm, must cover 400 to 830 nm; .* nothing is extrapolated"),
        ([(420, 0.5), (830, 0.5)], "from 420 to 830 nm"),
        ([(400, 0.5), (600, 1.02), (830, 0.5)], "reflectance 1.02 at 600 nm; at most 1"),
        ([(400, 50), (600, 60), (830, 50)], "in percent"),
        ([(400, 0.5), (600, -0.01), (830, 0.5)], "reflectance -0.01 at 600 nm; it must not be negative"),
        ([(390, 1.2), (410, 0.9), (830, 0.5)], "at most 1 is possible"),
        ([(400, 0.5)], "two or more"),
        ([(400, 0.5), (400, 0.6), (830, 0.5)], "longer than the one before"),
    ],
)
def test_spectra_that_cannot_be_are_refused(tmp_path, points, message_part):
    with pytest.raises(InputError, match=message_part):
        library.surface(texture(kind="spectrum", points=points), tmp_path)


@pytest.mark.parametrize(
    ("content", "message_part"),
    [
        (None, "'mine.csv': cannot be read"),
        ("", "header wavelength_nm,reflectance"),
        ("nm,value\n400,0.5\n830,0.5\n", "header wavelength_nm,reflectance"),
        ("wavelength_nm,reflectance\n400,0.5,1\n830,0.5,1\n", "two numbers per line"),
        ("wavelength_nm,reflectance\n400,half\n", "two numbers per line"),
        ("wavelength_nm,reflectance\n400,nan\n830,0.5\n", "not finite"),
    ],
)
def test_files_of_spectra_that_are_none_are_refused(tmp_path, content, message_part):
    if content is not None:
        (tmp_path / "mine.csv").write_text(content)
    with pytest.raises(InputError, match=message_part):
        library.surface(texture(kind="spectrum", file="mine.csv"), tmp_path)


@pytest.mark.parametrize(
    ("data", "message_part"),
    [
        ({"kind": "metal", "metal": "gold", "roughness": 1.5}, ["m.roughness", "1.5"]),
        ({"kind": "metal", "metal": "adamant"}, ["m.metal", "'gold'"]),
        ({"kind": "glass", "refractive_index": 0.9}, ["m.refractive_index", "0.9"]),
        ({"kind": "coated", "base": "sand", "roughness": 0.9}, ["m.roughness", "0.9"]),
        ({"kind": "coated", "base": "gold"}, ["'m'", "diffuse materials", "not metal"]),
        ({"kind": "coated", "base": {"kind": "glass"}}, ["m.base", "'photo'"]),
        ({"kind": "coated", "base": 3}, ["m.base", "name or a table"]),
        ({"kind": "coated", "base": {"kind": "photo", "image": "x.png"}}, ["m.base", "rule", "'achromatic'"]),
        ({"kind": "coated", "base": {"kind": "print", "image": "x.png", "inks": 4}}, ["m.base.inks: unknown key"]),
        ({"kind": "photo", "image": "x.png"}, ["materials.m", "rule", "'print', 'dyed'"]),
        ({"kind": "photo", "image": "x.png", "rule": "rgb"}, ["m.rule", "'achromatic'"]),
        ({"kind": "mix", "base": "sand", "layers": []}, ["m.layers"]),
        ({"kind": "mix", "base": "sand", "layers": [{"material": "glass", "mask": "pattern:noise"}]}, ["'m'", "clear"]),
        ({"kind": "mix", "base": "sand", "layers": [{"material": "soil", "mask": "pattern:no"}]}, ["'m'", "stripes"]),
        ({"kind": "spectrum"}, ["materials.m", "either file"]),
        ({"kind": "spectrum", "points": FULL, "file": "x"}, ["materials.m", "either file"]),
        ({"kind": "spectrum", "points": [(400, 2.0), (830, 2.0)]}, ["'m'", "at most 1 is possible"]),
        ({"kind": "blend", "image": "no.png", "dark": "soil", "bright": "sand"}, ["'m'", "no.png", "no such file"]),
    ],
)
def test_what_is_wrong_with_a_material_is_named_in_one_line(tmp_path, data, message_part):
    """Expectation: InputError that names the material and the key, and says what is allowed."""
    lights = [{"kind": "dome", "illuminant": "D65", "lux": 1.0}]
    thing = {"name": "it", "shape": "plane", "size_cm": [1, 1], "position_cm": [0, 0, 9], "material": "sand"}
    with pytest.raises(InputError) as caught:
        scene = parse(Scene, {"name": "t", "lights": lights, "objects": [thing], "materials": {"m": data}}, "scene")
        checks.check(scene.model_copy(update={"folder": tmp_path}), "scene")
    message = str(caught.value)
    assert "\n" not in message
    for part in message_part:
        assert part in message, message


@pytest.mark.parametrize("shape", [{"shape": "plane", "size_cm": [1, 1]}, {"shape": "disc", "radius_cm": 1}])
def test_open_shapes_cannot_be_of_solid_glass(shape):
    lights = [{"kind": "dome", "illuminant": "D65", "lux": 1.0}]
    data = {"name": "t", "lights": lights, "materials": {"thin": {"kind": "glass", "thin": True}}}
    for material in ("glass-pane", "thin", "glass"):
        thing = {"name": "it", "position_cm": [0, 0, 9], "material": material, **shape}
        scene = parse(Scene, data | {"objects": [thing]}, "scene")
        if material != "glass":
            checks.check(scene, "scene")
            continue
        with pytest.raises(InputError, match=r"object 'it': a .* is open and cannot be of solid glass .*glass-pane"):
            checks.check(scene, "scene")
