"""The ray loop by what it calls: all of it runs on graphics cards, in few launches, and the host reads little.

No test needs a graphics card. They show that the loop has no step that needs a processor, neither speed nor pictures.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import dasim
from dasim.camera import specification as cameras
from dasim.render import (
    backend,
    control_variate,
    irradiance_tracing,
    passes,
    pinhole,
    plugin,
    ray_batches,
    ray_block,
    ray_loop,
    ray_pass,
    shared_kernels,
)
from dasim.render.wavelengths import pinhole_responses
from tests.support.called import Batch, Record, recorded

RENDER = Path(ray_loop.__file__).parent
# Modules whose functions trace rays, or are called where plugins of ours meet them.
LOOP = """blur_tables control_variate field_angle irradiance irradiance_tracing lamps light_paths light_spectra
mixture pattern_blur plugin pinhole pupil radial_blur radial_tables ray_batches one_surface ray_block ray_loop
ray_pass sobol splitting surrounding transport foreign/colours""".split()
# Of Dr.Jit, all of which both kinds of arrays have; and of Mitsuba, whose types are those of the variant.
DRJIT = """abs all any arange atan block_sum brev clip cos dispatch dot eval floor fma full gather isfinite lerp
make_opaque maximum minimum norm normalize opaque pi rcp reinterpret_array round rsqrt safe_acos safe_asin safe_sqrt
select sin sincos sqrt squared_norm while_loop width zeros FilterMode WrapMode""".split()
MITSUBA = """BSDFContext BSDFFlags Bool DirectionSample3f DiscreteDistribution DiscreteDistribution2D Emitter
EmitterFlags EmitterPtr Float Float16 Frame3f Normal3f PCG32 Point1f Point2f Point3f Ray3f RayDifferential3f RayFlags
Spectrum SurfaceInteraction3f TensorXf TensorXf16 Texture Texture1f Texture2f Texture2f16 Texture3f UInt32 UInt64
Vector3f has_flag sample_tea_32 warp""".split()
# What prepares scenes and tables, on the host in every variant.
PREPARATION = """Bitmap ObjectType Properties ScalarBoundingBox3f ScalarTransform4f Struct TraversalCallback load_dict
register_emitter register_texture traverse variant""".split()
OURS = {"dasim_mixture", "dasim_surrounding", "dasim_layout"}
PLUGINS = OURS | set(
    """scene path aov independent stratified multijitter perspective hdrfilm box rectangle disk sphere cylinder
    twosided diffuse plastic roughplastic conductor roughconductor dielectric thindielectric null blendbsdf bitmap
    uniform regular irregular area point constant envmap principled normalmap""".split()
)
# Most arrays that the host reads per batch, by function: sums of two for each of eight channels (of four: also of two
# for the control variate, and two for depth); of pixels that see several depths two for each channel and the depth, and
# the light of four channels; of the irradiance, four wavelengths, and six numbers of the surface; of a pinhole's rays
# two for each of three bands and four channels of two stops and for three channels of another camera, and their places.
READS = {"Block.sums": 18, "_read": 9, "_beyond": 4, "_traced": 10, "_node_sums": 36}
# At least, of each array that is read: at 4 samples per pixel a picture's halves have 2; those of nodes are read whole.
RAYS_PER_NUMBER = {"_node_sums": 1}
OTHERWISE = 2
KEPT = 36  # numbers per ray that a launch leaves in memory: 144 bytes
LAUNCHES = 40  # of all kinds per batch
LANES = 1 << 16  # a picture is one batch, and the pinhole's five: the frame, and each side of its margin


def faults(record: Record) -> list[str]:
    """What a record has that is not allowed, in one line each."""
    import drjit as dr
    import mitsuba as mi

    found = [f"plugin {name}" for name in sorted(record.plugins - PLUGINS)]
    own = {mi.Float.__module__, mi.Point2f.__module__}
    found += [
        f"array of {kind.__module__}.{kind.__name__}"
        for kind in record.classes
        if kind.__module__ not in own or dr.backend_v(kind) != dr.backend_v(mi.Float)
    ]
    found += ["texture of the graphics card"] * any(texture.use_accel() for texture in record.textures)
    for batch in record.batches:
        if len(batch.traced) != 1:
            found.append(f"{batch.function} traces {len(batch.traced)} times")
        rays, kept = max(batch.traced, default=(0, 0))
        if rays > backend.lanes() or kept > KEPT or batch.launches.total() > LAUNCHES:
            found.append(f"{batch.function}: {rays} rays, {kept} numbers per ray, {batch.launches.total()} launches")
        for (reader, size), _ in batch.reads.items():
            if reader not in READS or size * RAYS_PER_NUMBER.get(reader, OTHERWISE) > rays:
                found.append(f"{reader} reads {size} numbers of {rays} rays")
        for reader, most in READS.items():
            if sum(times for (name, _), times in batch.reads.items() if name == reader) > most:
                found.append(f"{reader} reads more than {most} arrays")
    return found


def test_a_capture_runs_on_graphics_cards(jit, monkeypatch):
    """Rationale: what a processor alone can do would stop the loop on a graphics card, or slow it to the host's pace.

    Set-up: all that a capture of ``desk`` traces: two stops twice, rays through a pinhole, more of them where
    they are noisy, and the irradiance, of the grid and of its refined cells.
    Expectation: plugins and arrays of every variant; a batch traces its rays in one launch, and as many as memory is
    planned for; the host reads sums of pixels and of nodes, and rays only of pixels that see several depths, of which
    there are some.
    """
    monkeypatch.setattr(backend, "LANES", LANES)
    monkeypatch.setattr(backend, "GPU_LANES", LANES)
    for module in (ray_loop, pinhole, irradiance_tracing):  # nothing is frozen on graphics cards
        monkeypatch.setattr(module, "frozen", lambda function: function)
    camera, scene = dasim.cropped(dasim.load_camera("da-mobile"), 32, 24), dasim.load_scene("desk")
    ours = (ray_loop, "_trace"), (pinhole, "_node_sums"), (irradiance_tracing, "_traced")
    with recorded(*ours) as record:
        dasim.simulate(scene, dasim.focused(camera, scene), spp=4)
    assert faults(record) == []
    assert Counter(batch.function for batch in record.batches) == {
        "_trace": 4 + 1,
        "_node_sums": 5,
        "_traced": 2 + 2,
    }
    assert {name for batch in record.batches for name, _ in batch.reads} == READS.keys()
    assert {"path", "dasim_mixture", "twosided"} < record.plugins


def test_surfaces_and_lights_of_random_scenes_are_plugins_of_every_variant(jit):
    """Set-up: one of each kind that random scenes have."""
    import mitsuba as mi

    with recorded() as record:
        for things in (shared_kernels._objects() | shared_kernels._lamps(), shared_kernels._sky()):
            mi.load_dict({"type": "scene"} | things, optimize=False)
    assert faults(record) == []
    assert {"dasim_surrounding", "envmap", "roughplastic", "roughconductor", "dielectric"} < record.plugins


def test_what_is_not_allowed_is_seen(jit):
    """Set-up: a loop with everything that is not allowed, and one that traces twice."""
    import drjit as dr
    import mitsuba as mi

    def loop(values, others):
        np.array(values)
        if dr.all(values > 0):
            mi.load_dict({"type": "volpath"})
        return values[0]

    steps = SimpleNamespace(loop=loop)
    with recorded((steps, "loop")) as record:
        texture = mi.Texture1f(mi.TensorXf(mi.Float([0, 1]), (2, 1)))
        steps.loop(dr.arange(mi.Float, 64) + 1, (texture, dr.scalar.Array2f(1, 2)))
    found = "; ".join(faults(record))
    for part in ("plugin volpath", "drjit.scalar.Array2f", "texture of the", "loop traces 0 times", "loop reads 64 "):
        assert part in found
    assert sorted(size for _, size in record.batches[0].reads.elements()) == [1, 64, 64]
    twice = Batch("trace", traced=[(64, 1)] * 2)
    assert faults(Record(batches=[twice])) == ["trace traces 2 times"]
    assert faults(Record(batches=[Batch("trace", traced=[(64, KEPT)])])) == []
    assert len(faults(Record(batches=[Batch("trace", traced=[(64, KEPT + 1)])]))) == 1


def calls(source: str) -> set[str]:
    """Names of Mitsuba (``mi.``) and Dr.Jit (``dr.``) in a module, and its other imports of them."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("mi", "dr"):
            names.add(f"{node.value.id}.{node.attr}")
        if isinstance(node, ast.Import):
            names |= {f"import {n.name} as {n.asname}" for n in node.names if n.name.startswith(("drjit", "mitsuba"))}
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("drjit", "mitsuba")):
            names.add(f"from {node.module}")
    return names


def test_modules_of_the_loop_call_what_every_variant_has():
    """Expectation: no name beyond the list, in branches that a capture does not take either; no list beyond the names.

    Explicit classes of one kind of arrays (``drjit.llvm``, ``dr.scalar``) are none of them.
    """
    allowed = {f"dr.{name}" for name in DRJIT} | {f"mi.{name}" for name in MITSUBA + PREPARATION}
    allowed |= {"import drjit as dr", "import mitsuba as mi"}
    assert set.union(*(calls((RENDER / f"{name}.py").read_text()) for name in LOOP)) == allowed
    for line in ("from drjit.llvm import Float", "import drjit.llvm.ad as a", "dr.llvm.Float(1)", "dr.sync_thread()"):
        assert not calls(line) <= allowed


def test_plugins_are_built_for_cuda():
    """Set-up: Mitsuba's files of all plugins that the renderer names, but for those of :mod:`stock`, which is for
    ``scalar_spectral``. Every file holds the names of the variants that it was built for.
    """
    import mitsuba as mi

    if "cuda_ad_spectral" not in mi.variants():
        pytest.skip("this Mitsuba has no variants for graphics cards")
    sources = [path.read_text() for path in RENDER.rglob("*.py") if path.stem not in ("stock", "backend")]
    assert {name for source in sources for name in re.findall(r'"type": "(\w+)"', source)} <= PLUGINS
    folder = Path(find_spec("mitsuba").origin).parent / "plugins"
    for name in PLUGINS - OURS - {"scene"}:
        assert b"cuda_ad_spectral\0" in (folder / f"{name}.so").read_bytes(), name


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_tables_are_read_in_single_precision(jit, dimensions):
    """Rationale: the texture units of graphics cards interpolate in 256 steps."""
    assert not plugin.texture(np.zeros((2,) * dimensions + (1,))).use_accel()


def test_textures_share_the_memory_of_aligned_arrays(jit):
    """Rationale: the finer picture through a pinhole of a frame of 3 Mpx takes half a gigabyte."""
    if jit.startswith("cuda"):
        pytest.skip("textures are in the memory of the graphics card")
    values = plugin.aligned_zeros((3, 4, 2))
    table = plugin.texture(values)
    values += 5
    assert (np.array(table.tensor()) == 5).all()
    copy = plugin.aligned(values[:, 1:])
    assert copy.ctypes.data % 64 == 0 and not np.shares_memory(copy, values)


def test_kernels_do_not_depend_on_where_numpy_puts_arrays(jit, make_scene, da_mobile, lamp):
    """Rationale: where an array of the host happens to lie at a multiple of 64 bytes, Dr.Jit compiles other code for
    it, so that a scene needed a new kernel in one run and none in the next.

    Set-up: a card before a wall, seen through a lens with distortion: pixels of several depths, bent rays.

    Expectation: no kernel reads packets from an address of unknown alignment.
    """
    import drjit as dr

    if jit.startswith("cuda"):
        pytest.skip("graphics cards have copies of the host's arrays")
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40), "material": "sand"}
    card = {"name": "card", "shape": "plane", "size_cm": (6, 20), "position_cm": (-3, 0, 20), "material": "leaf-green"}
    camera = dasim.cropped(da_mobile, 32, 24)
    camera = camera.model_copy(update={"lens": camera.lens.model_copy(update={"distortion_per_mm": (-0.001,)})})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        dasim.simulate(make_scene(wall, card, lights=[lamp]), camera, spp=8)
        code = [entry["ir"].getvalue() for entry in dr.kernel_history() if "ir" in entry]
    packets = [line for kernel in code for line in kernel.splitlines() if re.search(r"= load <\d+ x", line)]
    assert len(packets) > 100
    assert [line for line in packets if line.split("align ")[1].startswith("1,")] == []


@pytest.mark.parametrize(("variant", "most"), [("cuda_ad_spectral", 1 << 23), ("llvm_ad_spectral", 1 << 19)])
def test_memory_is_bounded_by_the_rays_at_once(jit, monkeypatch, variant, most):
    """Expectation: batches of as many rays as the variant takes at once; a small frame has one."""
    monkeypatch.setattr("mitsuba.variant", lambda: variant)
    for pixels, batches in ((100, 1), (5 * most // 16, 5)):
        for spp in (16, np.full((1, pixels), 16)):
            parts = list(ray_batches._parts(spp, pixels))
            assert len(parts) == batches
            assert max(counts.sum() for _, counts in parts) <= most
            np.testing.assert_array_equal(np.concatenate([part for part, _ in parts]), np.arange(pixels))
            assert all((counts == 16).all() for _, counts in parts)


def test_pinhole_pictures_by_pixels_and_by_nodes_are_those_of_a_pinhole(make_scene, loaded, wide, jit):
    """Set-up: a wall of two materials, whose edge crosses the frame; three channels by nodes, two by pixels; a border.

    Expectation: nodes are the picture of a camera with smaller pixels, of pairs of them in the border; pixels are that
    of the camera. Both are those of separate rays, within 5 % at every pixel away from edge and border and 0.5 % in the
    mean; so are those of each half of the rays, within 1 % in the mean.
    """
    wall = {"shape": "plane", "size_cm": (400, 400), "material": "grey-card"}
    left = wall | {"name": "left", "position_cm": (-200, 0, 40), "material": "wood-light"}
    right = wall | {"name": "right", "position_cm": (200, 0, 40)}
    scene, camera, sampling = loaded(make_scene(left, right)), wide(12, 8), ray_batches.Sampling(32, 3)
    responses = pinhole_responses(camera)
    channels = pinhole.Channels((2, 1), [[1], [3]])
    pictures = pinhole.pictures(scene, camera, sampling, 4, None, responses, channels, border_px=2)
    assert [part.shape for part in pictures.nodes] == [(32, 48, 2), (32, 48, 1)]
    assert pictures.rate.shape == (2, 8, 12, 2)

    other, inner = ray_batches.Sampling(256, 2), np.s_[2:-2, 2:-2]
    ratios = ray_loop.ratios(scene, camera, None, other, None, None, responses).value[..., :3]
    rate = ray_loop.render(scene, camera, None, other, None, None, responses).value[..., [1, 3]]
    nodes = np.concatenate(pictures.nodes, axis=-1)
    means, beside = nodes.reshape(8, 4, 12, 4, 3).mean(axis=(1, 3)), np.abs(np.arange(8) - 3.5) > 1
    for found, true in ((means, ratios), (pictures.rate.mean(axis=0), rate)):
        np.testing.assert_allclose(found[inner][:, beside], true[inner][:, beside], rtol=0.05)
        assert found[inner].mean() == pytest.approx(true[inner].mean(), rel=0.005)
    for half in pictures.rate:
        np.testing.assert_allclose(half[inner].mean(axis=(0, 1)), rate[inner].mean(axis=(0, 1)), rtol=0.01)
    assert means.mean() == pytest.approx(ratios.mean(), rel=0.005)
    edge = np.abs(np.diff(nodes[8:-8, :, 0].mean(axis=0)))
    assert edge.argmax() == 23 and edge.max() > 10 * np.sort(edge)[-2]
    outside = np.ones((8, 12), bool)
    outside[inner] = False
    assert not pictures.rate[:, outside].any()
    pairs = nodes[:8].reshape(4, 2, 24, 2, 3)
    np.testing.assert_array_equal(pairs, np.broadcast_to(pairs[:, :1, :, :1], pairs.shape))


@pytest.mark.parametrize("cells", [4, 2])
def test_nodes_of_an_even_wall_are_even(make_scene, loaded, lamp, jit, monkeypatch, cells):
    """Rationale: the control variate compares single rays with nodes, whose few wavelengths differ from node to node.

    Set-up: a wall of one colour, whose reflectance rises steeply in near-infrared, under a lamp, by the bands of the
    hole; with and without the step that takes the mean error of each order of wavelengths out.

    Expectation: that step reduces the standard deviation of the nodes to less than half in each band, and changes
    neither the means of pixels nor the border.
    """
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 60)}
    scene = loaded(make_scene(wall | {"material": "cotton-green"}, lights=[lamp]))
    camera = cameras.cropped("da-mobile", 24, 16)
    monkeypatch.setattr(control_variate, "CELLS", cells)
    even = _fine(scene, camera)
    monkeypatch.setattr(pinhole, "without_dither", lambda *_: None)
    dithered = _fine(scene, camera)
    inner = (slice(even.margin_px * cells, -even.margin_px * cells),) * 2
    both = [fine.ratio[inner] for fine in (even, dithered)]
    pixels = [part.reshape(16, cells, 24, cells, 3).mean(axis=(1, 3)) for part in both]
    np.testing.assert_allclose(*pixels, rtol=1e-4, atol=1e-6)
    smaller, larger = (part.std(axis=(0, 1)) for part in both)
    assert (smaller < larger / 2).all()
    np.testing.assert_array_equal(*(fine.ratio[: 4 * cells] for fine in (even, dithered)))


def _fine(scene, camera):
    also = cameras.load_camera("bayer-mobile")
    sampling = passes.Sampling(32, 5)
    return passes.sharp_pass(scene, camera, sampling, None, also, diffraction="wave", max_blur_px=2.0).fine["hole"]


@pytest.mark.parametrize("samples", [4, 16])
def test_wavelengths_of_a_pixel_have_no_bias_and_little_noise(make_scene, loaded, wide, jit, samples):
    """Rationale: every picture is a mean over wavelengths.

    Set-up: places of 4,096 pixels, of four wavelengths per sample, and functions that are smooth over them.

    Expectation: the mean of a function over a pixel's places is its integral, within the scatter over the pixels. In
    two neighbouring strata of N, places e before and after the middles have the errors of f'' e^2 / 2 and of the change
    of the slope, - f'' e / (2 N): with e even over 1 / N, a standard error of f'' / (sqrt(45) N^2), and none for lines.
    For x^2 independent places have one of 1 / (3 N^1.5), 4 and 9 times as large at 16 and 64 places.
    """
    import mitsuba as mi

    wall = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40), "material": "grey-card"}
    camera = wide(64, 64)
    shared = ray_pass.prepare(
        loaded(make_scene(wall)), camera, None, None, None, pinhole_responses(camera), False, None
    )
    lanes = ray_block.lanes_of(shared, ray_batches.block_of(np.arange(4096), np.full(4096, samples), 3).batch)
    first = ray_block.wavelength_places(shared, lanes, lanes.sample)
    places = np.stack([np.array(place, dtype=float) for place in ray_block._places(shared, mi.Float(first))], axis=-1)
    places = places.reshape(4096, -1)
    count = 4 * samples
    np.testing.assert_array_equal(np.sort((places * count).astype(int), axis=1), np.arange(count) + np.zeros((4096, 1)))
    for power, integral, curvature in ((1, 1 / 2, 0.0), (2, 1 / 3, 2.0)):
        error = (places**power).mean(axis=1) - integral
        assert abs(error.mean()) < 4 * error.std() / 64 + 1e-7
        assert error.std() == pytest.approx(curvature / (np.sqrt(45) * count**2), rel=0.1, abs=1e-6)
    np.testing.assert_allclose(np.histogram(places[:, 0] * count % 1, 8, (0, 1))[0], 512, atol=4 * np.sqrt(448))


@pytest.mark.parametrize("counts", [[16] * 5, [32] * 5, [112] * 5, [128] * 5, [8, 24, 16], [3, 3, 3]])
def test_sums_of_pixels_are_those_of_their_rays(jit, counts):
    """Set-up: as many rays of every pixel, in one chunk, few or many, or different numbers."""
    import mitsuba as mi

    counts = np.array(counts)
    values = np.random.default_rng(1).random(counts.sum()).astype(np.float32)
    chunk = int(np.gcd.reduce(np.append(counts, ray_batches.MOST_CHUNK)))
    block = ray_batches.Block(slice(0, len(counts)), counts, chunk, None)
    each = np.split(values.astype(float), np.cumsum(counts)[:-1])
    np.testing.assert_allclose(block.sums(mi.Float(plugin.aligned(values))), [part.sum() for part in each], rtol=1e-6)
