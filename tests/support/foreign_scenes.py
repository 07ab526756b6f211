"""Mitsuba scenes from other sources, as text."""

from __future__ import annotations

POSE = '<lookat origin="1, 2, 4" target="0.1, 0.2, -0.3" up="0.2, 1, 0"/>'
ASLANT = '<sensor type="perspective"><transform name="to_world">' + POSE + "</transform></sensor>"


ROOM = """<scene version="3.0.0">
  <default name="red" value="0.6, 0.05, 0.05"/>
  <integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world">POSE</transform>
    <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="36"/></film>
  </sensor>
  <bsdf type="twosided" id="red wall"><bsdf type="diffuse"><rgb name="reflectance" value="$red"/></bsdf></bsdf>
  <bsdf type="diffuse" id="blue wall"><rgb name="reflectance" value="0.05, 0.1, 0.7"/></bsdf>
  <bsdf type="diffuse" id="grey"><spectrum name="reflectance" value="0.5"/></bsdf>
  <shape type="rectangle" id="left"><transform name="to_world"><rotate y="1" angle="90"/><translate x="-1"/></transform>
    <ref id="red wall"/></shape>
  <shape type="rectangle" id="back"><transform name="to_world"><translate z="-1"/></transform>
    <ref id="blue wall"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0.3" y="-0.2" z="0.1"/><float name="radius" value="0.3"/>
    <ref id="grey"/></shape>
  <shape type="shapegroup" id="group"><shape type="cube"><ref id="grey"/></shape></shape>
  <shape type="instance"><ref id="group"/>
    <transform name="to_world"><scale value="0.1"/><translate x="0.5" y="0.5"/></transform></shape>
  <shape type="ply" id="tent"><string name="filename" value="parts/tent.ply"/><ref id="grey"/></shape>
  <shape type="rectangle" id="lamp">
    <transform name="to_world"><rotate x="1" angle="90"/><translate y="1.5"/></transform>
    <emitter type="area"><rgb name="radiance" value="10, 9, 8"/></emitter></shape>
  <emitter type="point"><point name="position" x="0" y="0" z="2"/><rgb name="intensity" value="3"/></emitter>
</scene>""".replace("POSE", POSE)


def wall(inside: str = "", light: str = "", z: float = -4) -> str:
    """A wall across the view of a camera that looks along -z, and whatever else."""
    light = light or '<emitter type="constant"><spectrum name="radiance" value="1"/></emitter>'
    return (
        '<scene version="3.0.0"><sensor type="perspective"/>'
        '<shape type="rectangle"><transform name="to_world"><scale value="50"/><rotate y="1" angle="180"/>'
        f'<translate z="{-z}"/></transform>{inside}</shape>{light}</scene>'
    )
