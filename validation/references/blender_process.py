"""The process in which Blender's Cycles renders: ``python blender_process.py REQUEST.json OUT.npz``.

It imports ``bpy`` and NumPy alone, so that Blender shares no library with the simulator. The request is that of
:func:`validation.references.blender.renders`, which starts this process.

Tested in tests/validation/references/test_blender.py.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

SCALE = 10.0  # Blender's units per metre: its smallest lens has 1 mm, and so has its smallest sensor
TO_BLENDER = np.array([1.0, -1.0, -1.0]) * SCALE  # from x right, y down, z forward to x right, y up, z backward


def main(request: str, out: str) -> None:
    """Render what the request describes; the result has ``pictures`` [seed, h, w, 3] and ``processor_s`` [seed]."""
    import bpy

    wanted = json.loads(Path(request).read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _settings(scene, wanted["max_bounces"])
    _camera(scene, wanted["camera"])
    _lamp(scene, wanted["lamp"])
    textures = np.load(wanted["textures"])
    for number, board in enumerate(wanted["boards"]):
        _board(scene, np.array(board["corners_m"]), textures[board["texture"]], number)
    pictures, seconds = [], []
    with tempfile.TemporaryDirectory() as folder:
        for spp, seed in [(1, 0), *((wanted["spp"], seed) for seed in wanted["seeds"])]:  # the first one loads files
            picture, processor_s = _render(scene, spp, seed, Path(folder) / "picture.exr")
            pictures.append(picture)
            seconds.append(processor_s)
    np.savez(out, pictures=np.stack(pictures[1:]), processor_s=seconds[1:])


def _settings(scene: Any, max_bounces: int) -> None:
    """Path tracing on all processor threads: no denoiser, no adaptive sampling, no clamping, a box filter of a pixel.

    All other settings of Cycles, such as its light tree and its pattern of samples, are the default ones.
    """
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = cycles.diffuse_bounces = max_bounces
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.use_fast_gi = False
    scene.render.use_compositing = scene.render.use_sequencer = False
    output = scene.render.image_settings
    output.file_format, output.color_mode, output.color_depth = "OPEN_EXR", "RGB", "32"


def _camera(scene: Any, wanted: dict[str, float]) -> None:
    import bpy

    scene.render.resolution_x, scene.render.resolution_y = int(wanted["width_px"]), int(wanted["height_px"])
    scene.render.resolution_percentage = 100
    data = bpy.data.cameras.new("camera")
    # The field of view follows from the image distance, which Blender calls the focal length.
    data.lens = wanted["image_distance_m"] * 1e3 * SCALE
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = wanted["width_px"] * wanted["pixel_pitch_m"] * 1e3 * SCALE
    data.clip_start, data.clip_end = 1e-3, 1e4
    data.dof.use_dof = True
    data.dof.focus_distance = wanted["focus_distance_m"] * SCALE
    data.dof.aperture_fstop = wanted["image_distance_m"] / wanted["aperture_m"]
    data.dof.aperture_blades = 0
    scene.camera = _linked(scene, "camera", data)


def _lamp(scene: Any, wanted: dict[str, Any]) -> None:
    """A disc that faces its target, with the radiance [3] of its surface."""
    import bpy
    from mathutils import Vector

    radius = wanted["radius_m"] * SCALE
    data = bpy.data.lights.new("lamp", "AREA")
    data.shape, data.size = "DISK", 2 * radius
    radiance = np.array(wanted["radiance"])
    data.color = radiance / radiance.max()
    data.energy = radiance.max() * np.pi * (np.pi * radius**2)  # flux of a Lambertian disc: pi L times its area
    lamp = _linked(scene, "lamp", data)
    position, target = (np.array(wanted[key]) * TO_BLENDER for key in ("position_m", "target_m"))
    lamp.location = position
    lamp.rotation_mode = "QUATERNION"
    lamp.rotation_quaternion = Vector(target - position).to_track_quat("-Z", "Y")


def _board(scene: Any, corners_m: Any, texture: Any, number: int) -> None:
    """A Lambertian rectangle with a picture of its reflectance, [h, w, 3].

    ``corners_m`` [4, 3] are those of the picture: lower left, lower right, upper right, upper left.
    """
    import bpy

    name = f"board {number}"
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((corners_m * TO_BLENDER).tolist(), [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new()
    layer.data.foreach_set("uv", np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32))
    height, width = texture.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = texture[::-1]  # Blender's first row is the lowest
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    picture = tree.nodes.new("ShaderNodeTexImage")
    picture.image, picture.interpolation, picture.extension = image, "Linear", "EXTEND"
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Roughness"].default_value = 0.0  # Lambertian
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(picture.outputs["Color"], diffuse.inputs["Color"])
    tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    _linked(scene, name, mesh)


def _linked(scene: Any, name: str, data: Any) -> Any:
    import bpy

    item = bpy.data.objects.new(name, data)
    scene.collection.objects.link(item)
    return item


def _render(scene: Any, spp: int, seed: int, file: Path) -> tuple[Any, float]:
    """A picture in linear light, [h, w, 3], and the processor seconds of all threads that it took."""
    import bpy

    scene.cycles.samples, scene.cycles.seed = spp, seed
    scene.render.filepath = str(file)
    begin = resource.getrusage(resource.RUSAGE_SELF)
    bpy.ops.render.render(write_still=True)
    end = resource.getrusage(resource.RUSAGE_SELF)
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    picture = pixels.reshape(height, width, -1)[::-1, :, :3]
    bpy.data.images.remove(image)
    return picture, (end.ru_utime - begin.ru_utime) + (end.ru_stime - begin.ru_stime)


if __name__ == "__main__":
    main(*sys.argv[1:])
