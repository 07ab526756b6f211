"""Path-traced captures that the networks are trained with: random scenes of the simulator, some behind thin rods.

Layered captures (:mod:`validation.training.layered`) take two processor seconds each, but lack the perspective of a
lens and its light at depth steps, and their rooms differ from those of the simulator. Path-traced captures take about
30 processor seconds each. No other part of the project uses their seeds and pictures: posters and cards show
photographs of :mod:`validation.training.photographs` and patterns of :mod:`validation.training.patterns`, and seeded
textures use seeds that no random scene draws. Shapes, measured reflectances, unseeded textures (weaves, stripes,
checks, leaf veins) and light are those of :class:`dasim.RandomScenes`, in wider ranges than in the sets for which
figures are stated.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import dasim
from dasim.base import atomic
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene, world_to_camera
from dasim.simulation.exposure import Shot
from dasim.values import Capture, Truth
from recon.picture import colour, mosaic
from validation.training import rooms
from validation.training.captures import CAMERAS, SIZE_PX, Setup
from validation.training.patterns import PLAIN, TEXTURED, pattern
from validation.training.photographs import photograph

FAMILIES = ("traced", "dim")
SEED = 261128
DIM = (0.04, 0.5)  # least and largest factor on the light
PICTURES, PICTURE_PX = 96, 256
FIRST_TEXTURE, TEXTURES = 100, 24  # seeds of textures; random scenes draw smaller ones
NOISE_SHARE = 0.5  # of rendering over the sensor's, at the median
RODS_SHARE = 0.25  # of scenes with thin rods, as of fences and stems, before the rest
ROD_PX, RODS_APART, MOST_RODS = (4.0, 25.0), (2.0, 8.0), 12  # thickness; distance over it; number of parallel ones
SEEDED = ("noise", "dead-leaves", "wood-grain", "petal", "skin")  # the number of the other textures is no seed
IMAGE = re.compile(r"^(?:pattern:([a-z-]+):\d+|skimage:\w+)$")  # name of a texture or of a photograph


def kept(family: str, number: int, folder: Path) -> tuple[Capture, Truth]:
    """The capture of one of the ``FAMILIES`` and a number, rendered into ``folder`` unless it is there.

    Both families show the same scenes; ``dim`` ones have less light, by a factor within ``DIM``.
    """
    path = folder / str(number)
    if not path.exists():
        shot = _rendered(number, _pictures(folder / "pictures"))
        dasim.save_capture(path, shot.capture, shot.truth)
    if family == "dim":
        scale = float(np.exp(np.random.default_rng((SEED, 2, number)).uniform(*np.log(DIM))))
        capture = dasim.load_capture(path)
        exposure = dasim.Exposure(time_s=capture.exposure_s, gain=capture.gain)
        shot = dasim.expose(path, scale=scale, exposure=exposure, seed=number)
        return shot.capture, shot.truth
    return dasim.load_capture(path), dasim.load_truth(path)


def setup_and_light(capture: Capture, setups: list[Setup]) -> tuple[Setup, int]:
    """The setup of a capture's camera, and the index of the light in its bank that white balance takes.

    Kernels are those of the setup's focus, on which they hardly depend at the same level.
    """
    setup = setups[[name for name, _, _ in CAMERAS].index(capture.camera.name)]
    raw_e, saturated = mosaic.linearise(capture)
    return setup, colour.choose_light(raw_e, saturated, capture.camera, setup.bank.lights, setup.bank.signature)


def _pictures(folder: Path) -> list[Path]:
    """Pictures instead of the bundled photographs, PNG files in a folder; those that exist are left as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"picture-{number}.png" for number in range(PICTURES)]
    for number, file in enumerate(files):
        if not file.exists():
            random = np.random.default_rng((SEED, number))
            look = rooms.FAMILIES[str(random.choice(["plain", "textured"]))]
            if number % 3:
                linear = photograph(random, PICTURE_PX, look)
            else:
                linear = pattern(random, TEXTURED if number % 2 else PLAIN)[:3]
            encoded = 255 * np.clip(linear / np.percentile(linear, 99), 0, 1) ** (1 / 2.2)
            with atomic.writing(file) as stream:
                stream.write(cv2.imencode(".png", np.moveaxis(encoded, 0, -1)[..., ::-1].astype(np.uint8))[1].tobytes())
    return files


def _scene(number: int, files: list[Path]) -> tuple[Scene, Camera, dasim.Exposure]:
    """Scene, camera and exposure of a capture."""
    random = np.random.default_rng((SEED, 1, number))
    name = CAMERAS[random.choice(len(CAMERAS), p=[share for _, _, share in CAMERAS])][0]
    camera = dasim.cropped(dasim.load_camera(name), *SIZE_PX)
    near = float(np.exp(random.uniform(*np.log([5, 30]))))
    far = near * float(np.exp(random.uniform(*np.log([1.8, 6]))))
    lux = float(np.exp(random.uniform(*np.log([40, 3000]))))
    hard = random.random() < 0.3
    spec = dasim.RandomScenes(
        depth_cm=(round(near, 1), round(far, 1)),
        room_share=0.5,
        floating=bool(random.random() < 0.3),
        textured_share=round(float(random.uniform(0.35, 0.9)), 2),
        background_textured_share=0.6 if hard else 0.95,
        glossy_share=0.2 if hard else 0.1,
        metal_share=0.05 if hard else 0.02,
        glass_share=0.04 if hard else 0.01,
        lux=(lux, lux),
        textures=tuple(str(file) for file in files),
        gains={1.0: 3.0, 2.0: 1.0, 4.0: 1.0},
        auto_level=(0.3, 0.9),
    )
    drawn = _with_own_textures(dasim.random_scene(SEED, number, spec, camera), random)
    if random.random() < RODS_SHARE:
        drawn = _with_rods(drawn, camera, (near, float(np.sqrt(near * far))), random)
    return drawn, dasim.focused(camera, drawn), dasim.random_exposure(SEED, number, spec)


def _rendered(number: int, files: list[Path]) -> Shot:
    """The rendered capture of a number."""
    drawn, camera, exposure = _scene(number, files)
    return dasim.simulate(drawn, camera, number, spp="auto", noise_share=NOISE_SHARE, exposure=exposure)


def _with_rods(drawn: Scene, camera: Camera, depth_cm: tuple[float, float], random: np.random.Generator) -> Scene:
    """The scene with parallel rods across the frame at one depth, or with two sets that cross each other."""
    depth = float(np.exp(random.uniform(*np.log(depth_cm))))
    px = depth * camera.sensor.pixel_pitch_um * 1e-6 / camera.lens.focal_length_mm * 1e3  # of the frame, there, in cm
    thick = px * float(np.exp(random.uniform(*np.log(ROD_PX))))
    scene, to_scene = drawn.model_dump(mode="json", exclude_unset=True), np.linalg.inv(world_to_camera(drawn))
    material = str(random.choice(list(scene["materials"])))
    first = float(random.uniform(0, 180))
    for number, angle in enumerate([first, first + random.uniform(60, 120)][: 1 + int(random.integers(2))]):
        apart = thick * random.uniform(*RODS_APART)
        offsets = apart * (np.arange(random.integers(1, MOST_RODS + 1)) - random.uniform(0, MOST_RODS))
        for rod, offset in enumerate(offsets):
            turned = Rotation.from_matrix(to_scene[:3, :3]) * Rotation.from_euler("z", angle, degrees=True)
            middle = to_scene[:3, :3] @ [0, 0, depth] + turned.apply([0, offset, 0]) + 100 * to_scene[:3, 3]
            scene["objects"].append({
                "name": f"rod {number}-{rod}",
                "shape": "box",
                "size_cm": [1.5 * px * float(np.hypot(*SIZE_PX)), thick, thick],
                "position_cm": middle.tolist(),
                "rotation_deg": turned.as_euler("xyz", degrees=True).tolist(),
                "material": material,
            })  # fmt: skip
    return Scene.model_validate(scene)


def _with_own_textures(drawn: Scene, random: np.random.Generator) -> Scene:
    """The scene with other seeds of its textures, and without bundled photographs of structures."""

    def other(found: re.Match[str]) -> str:
        kind = found.group(1) or str(random.choice(SEEDED[:2]))
        if kind not in SEEDED:
            return found.group()
        return f"pattern:{kind}:{FIRST_TEXTURE + int(random.integers(TEXTURES))}"

    def replaced(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: replaced(part) for key, part in value.items()}
        if isinstance(value, list):
            return [replaced(part) for part in value]
        return IMAGE.sub(other, value) if isinstance(value, str) else value

    return Scene.model_validate(replaced(drawn.model_dump(mode="json", exclude_unset=True)))
