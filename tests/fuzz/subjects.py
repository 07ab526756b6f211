"""What the fuzzer damages: small valid files of every kind, and the function or command that reads each."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import trimesh
from PIL import Image

import dasim
from dasim.camera import specification as cameras
from dasim.cli import run
from dasim.dataset.specification import load_spec
from dasim.files import banks, captures
from dasim.random_scenes.specification import load_random_scenes
from dasim.scene import mesh_merging, meshes
from dasim.scene.loading import SCENE_DIR
from dasim.values import Capture, PsfBank, Truth
from recon.files import dng, raw
from recon.files.reconstruction import load_reconstruction
from tests.support.datasets import SPEC, SQUARE, WALL
from validation.gates.comparison import load_results
from validation.gates.limits import load_gates
from validation.scores.depth_files import read_depth
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.specification import points

SIDE = 16
XML = (
    '<scene version="3.0.0">\n<integrator type="path"/>\n<sensor type="perspective"><float name="fov" value="45"/>\n'
    '<transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>\n'
    '<bsdf type="roughconductor" id="m"><float name="alpha" value="0.2"/></bsdf>\n'
    '<shape type="sphere"><point name="center" value="0, 0, 0"/><float name="radius" value="1"/><ref id="m"/></shape>\n'
    '<emitter type="constant"><rgb name="radiance" value="1, 1, 1"/></emitter>\n</scene>\n'
)
STUDY = Path(dasim.__file__).parents[1] / "validation" / "studies" / "bundled" / "lens.toml"


@dataclasses.dataclass(frozen=True)
class Subject:
    """Files to damage, and what reads them.

    Attributes:
        name: of the subject, which is also that of its folder
        files: names of the files that are damaged, relative to the folder
        read: function of the folder; it returns an exit status or nothing
    """

    name: str
    files: tuple[str, ...]
    read: Callable[[Path], object]


def _command(*arguments: str) -> Callable[[Path], int]:
    """A command of dasim, with DIR in its arguments for the folder."""
    return lambda folder: run([argument.replace("DIR", str(folder)) for argument in arguments])


def _points(folder: Path) -> None:
    points(load_study(str(folder / "study.toml")))


SUBJECTS = (
    Subject("camera", ("camera.toml",), _command("calibrate", "--camera", "DIR/camera.toml", "--print-distances")),
    Subject("scene", ("scene.toml",), lambda folder: dasim.load_scene(folder / "scene.toml")),
    Subject("mitsuba", ("scene.xml",), lambda folder: dasim.load_scene(folder / "scene.xml")),
    Subject("mesh", ("mesh.obj",), lambda folder: meshes.read(folder / "mesh.obj", 0.01, str(folder / "mesh.obj"))),
    Subject("glb", ("mesh.glb",), lambda folder: _coloured_mesh(folder / "mesh.glb")),
    Subject("random", ("random.toml",), lambda folder: load_random_scenes(folder / "random.toml")),
    Subject("dataset", ("spec.toml", "wall.toml"), lambda folder: load_spec(folder / "spec.toml")),
    Subject("study", ("study.toml",), _points),
    Subject("settings", ("settings.toml",), _command("recon", "--settings", "DIR/settings.toml", "--print-settings")),
    Subject("gates", ("gates.toml",), lambda folder: load_gates(folder / "gates.toml", ["score"])),
    Subject("results", ("results.json",), lambda folder: load_results(folder / "results.json")),
    Subject("bank", ("bank.npz",), lambda folder: banks.load_bank(folder / "bank.npz")),
    Subject("capture", ("meta.json", "raw.png"), lambda folder: captures.load_capture(folder)),
    Subject("truth", ("meta.json", "truth.exr"), lambda folder: captures.load_truth(folder)),
    Subject("reconstruction", ("meta.json", "recon.exr"), lambda folder: load_reconstruction(folder)),
    Subject("raw-png", ("raw.png",), lambda folder: raw.load_raw(folder / "raw.png", dasim.load_camera("da-mobile"))),
    Subject("raw-npy", ("raw.npy",), lambda folder: raw.load_raw(folder / "raw.npy", dasim.load_camera("da-mobile"))),
    Subject("raw-tiff", ("raw.tif",), lambda folder: raw.load_raw(folder / "raw.tif", dasim.load_camera("da-mobile"))),
    Subject("raw-lzw", ("raw.tif",), lambda folder: raw.load_raw(folder / "raw.tif", dasim.load_camera("da-mobile"))),
    Subject("raw-dng", ("raw.dng",), lambda folder: raw.load_raw(folder / "raw.dng", None)),
    Subject("map", ("map.npy",), lambda folder: read_depth(folder / "map.npy")),
)


def write(folder: Path) -> None:
    """Write the valid files of all subjects below a folder."""
    random = np.random.default_rng(0)
    for subject in SUBJECTS:
        (folder / subject.name).mkdir(parents=True)
    shutil.copy(cameras.CAMERA_DIR / "da-mobile.toml", folder / "camera" / "camera.toml")
    shutil.copy(SCENE_DIR / "desk.toml", folder / "scene" / "scene.toml")
    for picture in SCENE_DIR.glob("*.jpg"):
        shutil.copy(picture, folder / "scene")
    (folder / "mitsuba" / "scene.xml").write_text(XML)
    (folder / "mesh" / "mesh.obj").write_text("vt 0 0\nvt 1 0\nvt 1 1\n" + SQUARE.replace("f 1 3 2", "f 1/1 3/2 2/3"))
    _write_glb(folder / "glb" / "mesh.glb", random)
    (folder / "random" / "random.toml").write_text("depth_cm = [20, 80]\nobjects = [5, 9]\nlux = [100, 2000.0]\n")
    fields = {"samples": 4, "samples_per_shard": 2, "format": "webdataset", "files": '["wall.toml"]'}
    (folder / "dataset" / "spec.toml").write_text(SPEC.format(top="", more="", **fields))
    (folder / "dataset" / "wall.toml").write_text(WALL)
    shutil.copy(STUDY, folder / "study" / "study.toml")
    (folder / "settings" / "settings.toml").write_text("")
    (folder / "gates" / "gates.toml").write_text('["score.raw.all.level-median"]\nlimit = "< 0.5"\nwhy = "a test"\n')
    entry = {"id": "a.b", "value": 1.0, "limit": "<2", "unit": "1", "passed": True, "source": "", "spread": None}
    (folder / "results" / "results.json").write_text(json.dumps({"schema": 1, "claims": [entry]}))
    camera = cameras.cropped(cameras.load_camera("da-mobile"), SIDE, SIDE)
    _write_captures(folder, camera, random)
    kernel = random.random((1, 3, 4, 3, 3)).astype(np.float32)
    tables = np.array([0.4, 0.3, 0.2], np.float32), np.array([0, 2, 4], np.float32)
    unit = kernel / kernel.sum(axis=(-2, -1), keepdims=True)
    bank = PsfBank(
        kernel=unit,
        lights=("D65",),
        signature=random.random((1, 4)).astype(np.float32),
        depth_m=tables[0],
        blur_px=tables[1],
        camera=camera,
        diffraction="wave",
    )
    banks.save_bank(folder / "bank" / "bank.npz", bank)
    mosaic = random.integers(64, 1024, (SIDE, SIDE)).astype(np.uint16)
    cv2.imwrite(str(folder / "raw-png" / "raw.png"), mosaic)
    cv2.imwrite(str(folder / "raw-tiff" / "raw.tif"), mosaic)
    compressed = [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW]
    cv2.imwrite(str(folder / "raw-lzw" / "raw.tif"), mosaic, compressed)
    np.save(folder / "raw-npy" / "raw.npy", mosaic)
    dng.write_dng(folder / "raw-dng" / "raw.dng", Capture(mosaic, camera, exposure_s=0.01, gain=1.0, seed=0))
    np.save(folder / "map" / "map.npy", random.random((SIDE, SIDE)))


def _coloured_mesh(path: Path) -> meshes.Part:
    return mesh_merging.merge_with_colours(meshes.read(path, 0.01, str(path)), str(path))


def _write_glb(path: Path, random: np.random.Generator) -> None:
    """A square with pictures of its colours, its metallic share and roughness, and its normals."""
    pictures = [Image.fromarray(random.integers(0, 256, (side, side, 3)).astype(np.uint8)) for side in (8, 4, 6)]
    names = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture")
    material = trimesh.visual.material.PBRMaterial(
        metallicFactor=0.5, roughnessFactor=0.75, **dict(zip(names, pictures, strict=True))
    )
    square = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 2, 1], [0, 3, 2]], process=False)
    square.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]], material=material)
    path.write_bytes(square.export(file_type="glb"))


def _write_captures(folder: Path, camera: cameras.Camera, random: np.random.Generator) -> None:
    """A capture with its truth, and the folder of a reconstruction."""
    plane = random.random((SIDE, SIDE)).astype(np.float32)
    numbers = np.ones((SIDE, SIDE), np.uint32)
    truth = Truth(
        depth_m=plane,
        valid=numbers.astype(bool),
        normal=np.stack([plane] * 3, -1),
        object_id=numbers,
        material_id=numbers,
        blur_px=plane,
        level=plane,
        boundary=numbers.astype(bool),
        channels=("R", "G", "B", "IR"),
        mean_e=np.stack([plane] * 4, -1),
        sharp_e=np.stack([plane] * 4, -1),
        sharp_srgb=np.stack([plane] * 3, -1),
        objects=("wall",),
        materials=("brick",),
    )
    raw_dn = random.integers(0, 1024, (SIDE, SIDE)).astype(np.uint16)
    capture = Capture(raw_dn=raw_dn, camera=camera, exposure_s=0.01, gain=1.0, seed=0, illuminant="D65", provenance={})
    for name in ("capture", "truth"):
        shutil.rmtree(folder / name)
        captures.save_capture(folder / name, capture, truth)
    about = {"camera": camera.model_dump(mode="json"), "light": "D65", "settings": {}, "timings_s": {}}
    (folder / "reconstruction" / "meta.json").write_text(json.dumps(about))
    shutil.copy(folder / "truth" / "truth.exr", folder / "reconstruction" / "recon.exr")
