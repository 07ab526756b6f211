"""Lights of random scenes: lamps, a window, or daylight.

Tested in tests/dasim/random_scenes/test_scene.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.random_scenes.draws import Random, generator, rounded, weighted
from dasim.random_scenes.layout import Room
from dasim.random_scenes.specification import RandomScenes
from dasim.typing import FloatArray


def lights(seed: int, index: int, spec: RandomScenes, space: Room) -> list[dict[str, Any]]:
    """Draw the lights: lamps or a window with a weak dome of the first one's illuminant, or daylight.

    Lamps stand outside the picture, at least a third of the farthest depth from everything visible, so that no object
    near a lamp is much brighter than the others; where walls leave less room, they stand nearer (in some 4 % of scenes
    that reach from 20 cm to 20 m). Their levels are illuminances on a surface that faces them, on the
    optical axis at the middle of the range of inverse depth.
    """
    random = generator(seed, index, "light")
    lux = float(np.exp(random.uniform(*np.log(spec.lux))))
    fill = random.uniform(*spec.fill_share)
    kind, mixed = random.random(2)
    main = _illuminant(random, spec)
    near, far = spec.depth_cm
    target = space.frame.forward() * (2 / (1 / near + 1 / far))
    dome = {"kind": "dome", "illuminant": main, "lux": round(lux * fill, 3)}
    if kind < spec.outdoor_share:
        return [_outdoors(random, lux)]
    if kind < spec.outdoor_share + spec.window_share:
        side = 1 if random.random() < 0.5 else -1
        size = random.uniform(0.4, 0.8, 2) * far
        place = _lamp_place(random, space, float(np.hypot(*size)) / 2, (55.0, 80.0), side)
        window = {"kind": "panel", "size_cm": rounded(size), "illuminant": main, "lux": round(lux, 3)}
        return [window | {"position_cm": rounded(place), "target_cm": rounded(target)}, dome]
    count = int(random.integers(spec.lamps[0], spec.lamps[1] + 1))
    parts = np.sort(random.dirichlet(np.full(count, 2.0)))[::-1]
    result: list[dict[str, Any]] = []
    for number in range(count):
        lamp_random = generator(seed, index, "light", number + 1)
        radius = float(np.exp(lamp_random.uniform(np.log(0.02), np.log(0.12)))) * far
        place = _lamp_place(lamp_random, space, radius, (-75.0, 75.0), 1)
        illuminant = _illuminant(lamp_random, spec)
        lamp = {"kind": "lamp", "radius_cm": round(radius, 4), "lux": round(lux * float(max(parts[number], 0.02)), 3)}
        lamp |= {"illuminant": illuminant if number and mixed < spec.mixed_light_share else main}
        result.append(lamp | {"position_cm": rounded(place), "target_cm": rounded(target)})
    return [*result, dome]


def _illuminant(random: Random, spec: RandomScenes) -> str:
    """Draw an illuminant by its weight; the temperature of a blackbody is uniform in mired, rounded to 50 K."""
    name = str(weighted(random, spec.illuminants))
    low, high = spec.blackbody_k
    kelvin = 1 / random.uniform(1 / high, 1 / low)
    return f"blackbody-{int(np.clip(round(kelvin / 50) * 50, low, high))}K" if name == "blackbody" else name


def _lamp_place(random: Random, space: Room, radius: float, turns: tuple[float, float], side: int) -> FloatArray:
    """Draw the position [3], cm, of a lamp of ``radius``: outside the picture, above the floor, in front of the walls.

    ``turns`` is the range of its angle around the optical axis in degrees: 0 is above it, 90 to its right (``side`` 1)
    or left (``side`` -1).
    """
    far, frame = space.far, space.frame
    depth = random.uniform(-0.9, 0.3) * far
    turn = side * np.radians(random.uniform(*turns))
    away = random.uniform(0.1, 0.7) * far
    diagonal = float(np.hypot(frame.half_width, frame.half_height))
    sideways = np.array([np.sin(turn), -np.cos(turn), 0.0])  # in scene axes, without the camera's pitch
    for _ in range(2):
        least = max(depth, 0.0) * diagonal * 1.5 + radius + far / 3
        axis = frame.forward() * depth
        room_left = min(
            (0.95 * wall.distance - radius - float(wall.normal() @ axis)) / max(float(wall.normal() @ sideways), 1e-9)
            for wall in space.walls
        )
        if room_left > least:
            break
        depth = -abs(depth)  # no room beside the field of view: move behind the camera, where nothing is visible
    return axis + sideways * max(min(least + away, room_left), 0.0)


def _outdoors(random: Random, lux: float) -> dict[str, Any]:
    """Draw sun and clear sky, with the sun behind the camera, or an overcast sky; ten times the level of lamps."""
    azimuth = float(random.uniform(110.0, 250.0))
    if random.random() < 0.5:
        sun = {"kind": "daylight", "elevation_deg": int(random.integers(25, 66)), "azimuth_deg": round(azimuth, 2)}
        return sun | {"lux": round(10 * lux, 3), "ground_reflectance": 0.2}
    return {
        **{"kind": "sky", "illuminant": "D65", "distribution": "overcast"},
        **{"lux": round(10 * lux, 3), "ground_reflectance": 0.2},
    }
