"""The table of claims: everything ``dasim validate`` can measure, in the order of its report."""

from __future__ import annotations

from validation.claims.cost.compilation import compiled_kernels
from validation.claims.cost.cycles import against_cycles
from validation.claims.cost.datasets import dataset_speed
from validation.claims.cost.exposure import exposure
from validation.claims.cost.fewer_rays import fewer_rays
from validation.claims.cost.graphics_card import graphics_card
from validation.claims.cost.reconstruction import recon_large, recon_speed
from validation.claims.cost.sampling import desk_noise, noise_slope_off, noise_slope_wave, render_cost
from validation.claims.cost.scenes import interreflection, registration, scenes_speed
from validation.claims.depth.depth_maps import depth_maps
from validation.claims.depth.disks import yellow_disks
from validation.claims.depth.ground_truth import ground_truth
from validation.claims.depth.held_out import depth_held_out
from validation.claims.depth.light_levels import light_levels
from validation.claims.depth.rivals import rivals
from validation.claims.depth.scenes import depth
from validation.claims.depth.side_of_focus import side_of_focus
from validation.claims.depth.staircase import staircase, staircase_camera
from validation.claims.depth.steps import measured_steps
from validation.claims.light.balance import balance
from validation.claims.light.electrons import absolute_electrons, eq8_flat_field, hole_alpha_squared, light_loss
from validation.claims.light.field_colour import field_colour
from validation.claims.light.mixed import mixed_lights
from validation.claims.light.noise import photon_transfer
from validation.claims.light.pattern import fixed_pattern
from validation.claims.light.truth_noise import truth_noise
from validation.claims.optics.bank import bank
from validation.claims.optics.blur import blur_off
from validation.claims.optics.bundled_cameras import bundled_cameras
from validation.claims.optics.camera import depth_of_field, dynamic_range, kernels, response_curves
from validation.claims.optics.diffraction import airy_table, wave_energy, wave_sfr
from validation.claims.optics.edges import depth_step_furnace, silhouette
from validation.claims.optics.lens_errors import lens_errors
from validation.claims.optics.occlusion import occluding_edge
from validation.claims.optics.off_axis import off_axis
from validation.claims.optics.resolution import depth_resolution
from validation.claims.pictures.all_in_focus import all_in_focus, refocus
from validation.claims.pictures.colour import colour
from validation.claims.pictures.scene_pictures import scene_pictures
from validation.claims.pictures.sharp_held_out import sharp_held_out
from validation.claims.pictures.two_cameras import two_cameras
from validation.gates.outcome import Measurement

# Quick: less than about 20 s on two cores.
CLAIMS = {
    "radiometry": Measurement(absolute_electrons, quick=True),
    "photon-transfer": Measurement(photon_transfer, quick=True),
    "fixed-pattern": Measurement(fixed_pattern, quick=True),
    "light-loss": Measurement(light_loss, quick=True),
    "response-curves": Measurement(response_curves, quick=True),
    "depth-of-field": Measurement(depth_of_field, quick=True),
    "kernels": Measurement(kernels, quick=True),
    "dynamic-range": Measurement(dynamic_range, quick=True),
    "depth-resolution": Measurement(depth_resolution, quick=True),
    "hole-alpha-squared": Measurement(hole_alpha_squared, quick=True),
    "eq8-flat-field": Measurement(eq8_flat_field, quick=True),
    "blur-off": Measurement(blur_off, quick=True),
    "wave-sfr": Measurement(wave_sfr, quick=False),
    "wave-energy": Measurement(wave_energy, quick=True),
    "occluding-edge": Measurement(occluding_edge, quick=True),
    "depth-step-furnace": Measurement(depth_step_furnace, quick=False),
    "silhouette": Measurement(silhouette, quick=False),
    "bundled-cameras": Measurement(bundled_cameras, quick=False),
    "off-axis": Measurement(off_axis, quick=False),
    "lens-errors": Measurement(lens_errors, quick=True),
    "airy-table": Measurement(airy_table, quick=True),
    "noise-slope-off": Measurement(noise_slope_off, quick=False),
    "noise-slope-wave": Measurement(noise_slope_wave, quick=False),
    "fewer-rays": Measurement(fewer_rays, quick=False),
    "desk-noise": Measurement(desk_noise, quick=False),
    "render-cost": Measurement(render_cost, quick=False, alone=True),
    "against-cycles": Measurement(against_cycles, quick=False, alone=True),
    "ground-truth": Measurement(ground_truth, quick=True),
    "registration": Measurement(registration, quick=True),
    "interreflection": Measurement(interreflection, quick=False),
    "truth-noise": Measurement(truth_noise, quick=True),
    "mixed-lights": Measurement(mixed_lights, quick=False),
    "field-colour": Measurement(field_colour, quick=False),
    "colour": Measurement(colour, quick=False),
    "scenes-speed": Measurement(scenes_speed, quick=False, alone=True),
    "bank": Measurement(bank, quick=True),
    "staircase": Measurement(staircase, quick=False),
    "staircase-camera": Measurement(staircase_camera, quick=False),
    "recon-speed": Measurement(recon_speed, quick=False, alone=True),
    "recon-large": Measurement(recon_large, quick=False, alone=True),
    "depth": Measurement(depth, quick=False),
    "side-of-focus": Measurement(side_of_focus, quick=False),
    "depth-held-out": Measurement(depth_held_out, quick=False),
    "all-in-focus": Measurement(all_in_focus, quick=False),
    "sharp-held-out": Measurement(sharp_held_out, quick=False),
    "refocus": Measurement(refocus, quick=False),
    "depth-steps": Measurement(measured_steps, quick=False),
    "balance": Measurement(balance, quick=True),
    "light-levels": Measurement(light_levels, quick=False),
    "rivals": Measurement(rivals, quick=False),
    "depth-maps": Measurement(depth_maps, quick=False),
    "yellow-disks": Measurement(yellow_disks, quick=False),
    "scene-pictures": Measurement(scene_pictures, quick=False),
    "two-cameras": Measurement(two_cameras, quick=False),
    "exposure": Measurement(exposure, quick=False, alone=True),
    "compiled-kernels": Measurement(compiled_kernels, quick=False),
    "dataset-speed": Measurement(dataset_speed, quick=False, alone=True),
    "graphics-card": Measurement(graphics_card, quick=False, alone=True),
}
