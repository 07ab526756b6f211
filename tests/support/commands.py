"""A scene of the user's own, the bundled camera's file and arguments of small renders, for tests of the commands."""

from __future__ import annotations

from pathlib import Path

TINY = ("--size", "64x48", "--spp", "4")
RENDER = ("render", "desk", *TINY, "--out", "new")

SCENE = """
name = "mine"
focus_cm = 40
[[lights]]
kind = "lamp"
illuminant = "D65"
lux = 500
position_cm = [-20, -30, -10]
target_cm = [0, 0, 25]
radius_cm = 5
[[objects]]
name = "wall"
shape = "plane"
size_cm = [50, 40]
position_cm = [0, 0, 40]
material = "brick"
[[objects]]
name = "thing"
shape = "mesh"
file = "thing.obj"
position_cm = [0, 0, 20]
rotation_deg = [20, 30, 0]
material = "sand"
"""
CAMERA = Path(__file__).parents[2] / "dasim" / "cameras" / "da-mobile.toml"
