"""Claim on occlusion: a defocused near edge over a far texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

import dasim
from dasim.camera import radiometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references import transfer
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.subjects import rendering

# Large pixels make diffraction small (lambda N is 0.03 px); a long lens still gives several pixels of blur.
PITCH_UM, FOCAL_MM, FOCUS_M = 50.0, 12.0, 0.4
SIZE_PX = (32, 24)
NEAR_BLUR_PX, FAR_BLUR_PX = 4.0, -1.5
CHANNEL, STOP = "G", 0  # the open stop alone: near-infrared through the hole would add light with another blur
NEAR_TURN_DEG, STRIPE_TURN_DEG = 10.0, 40.0
STRIPE_PX = 3.0  # width of a stripe in the picture
NEAR, DARK, BRIGHT = "grey-card", "carbon-black", "white-paper"
SPP, SEEDS = 1024, 12
QUADRATURE = 40_000  # points per pixel, over the product of pixel area and pupil disc
# The lamp is far behind the lens, on the side away from the near plane, whose shadow then falls outside the view.
LAMP_CM, LAMP_TARGET_CM, LAMP_RADIUS_CM = (600.0, 0.0, -2000.0), (0.0, 0.0, 40.0), 20.0


def occluding_edge(progress: ShareDone) -> Evidence:
    """The picture of a near edge over far stripes equals a brute-force integral over pixel area and pupil.

    Rationale: at a depth step, the near object hides the far one from some points of the pupil and not from others.
    Blurring the scene in layers gets this wrong, and so would rays weighted with the blur of the wrong depth.

    Set-up: a grey half-plane with a blur diameter of 4 px in front of black and white stripes with 1.5 px on the other
    side of the focal plane, both turned, lit by a distant lamp. The lens is 12 mm f/2.8 and the pixels measure 50 um,
    so that lambda N is 0.03 px and the picture is nearly geometric. The render is ``mean_e`` of ``dasim.simulate`` for
    a camera with the open stop alone, green, diffraction 'wave', 12 seeds of 1,024 samples per pixel. The reference
    uses numpy and thin-lens geometry alone: 40,000 rays per pixel (Roberts's R4 sequence over pixel area and pupil),
    each intersected with the half-plane and the stripes.

    Expectation: in pixels that see both planes, render and reference differ by noise alone. Student's t of their
    difference divides by the variance over seeds plus the square of the reference's error, which has two parts: that of
    the quadrature (from two halves of the points) and, for 'wave', that of neglected diffraction (the largest
    difference between the edge spread functions of wave optics and of geometry). The smallest p over pixels, corrected
    for their number (Sidak), is not significant, and neither is the p of the mean difference. The render with
    diffraction 'off' passes the same test, which shows that the reference is right.

    Limit: p of at least 0.01, and of at most 0.0001 against a picture blurred in layers, which shows the test's power.

    Source: thin-lens geometry; Roberts 2018, quasirandom sequences; Sidak 1967.
    """
    rendering.needs_wave()
    camera = edge_camera()
    reference, layered, both, quadrature = reference_picture(camera)
    diffraction = diffraction_error(camera)
    scene = edge_scene(camera)
    figures, pictures = [], []
    for model, changed in (("off", 0.0), ("wave", diffraction)):
        own_error = float(np.hypot(quadrature, changed))
        rendered = _renders(scene, camera, model)
        progress(0.5 if model == "off" else 1.0)
        rendered *= reference[~both].mean() / rendered[:, ~both].mean()  # absolute electrons are tested elsewhere
        t = t_values(rendered[:, both], reference[both], own_error)
        # Diffraction changes an edge antisymmetrically, so its effect on the mean falls with the number of pixels.
        mean_error = own_error / np.sqrt(t.size)
        t_mean = t_values(rendered[:, both].mean(axis=1), reference[both].mean(), mean_error)
        layers = smallest_p(t_values(rendered[:, both], layered[both], own_error))
        off = rendered[:, both].mean(axis=0) - reference[both]
        noise = rendered[:, both].std(axis=0, ddof=1) / np.sqrt(SEEDS)
        figures += [
            Figure(f"{model}.p", smallest_p(t), "1", "smallest p over pixels, corrected for their number"),
            Figure(f"{model}.p-of-mean", smallest_p(t_mean), "1", "p of the mean difference over these pixels"),
            Figure(f"{model}.mean-square-t", float(np.mean(t**2)), "1", "mean of t^2; 1.2 expected for noise alone"),
            Figure(f"{model}.bias", float(off.mean()), "1", "mean difference, relative to white paper"),
            Figure(f"{model}.worst", float(np.abs(off).max()), "1", "largest difference, relative to white paper"),
            Figure(
                f"{model}.noise",
                float(np.median(noise)),
                "1",
                "median standard error of a pixel, relative to white paper",
            ),
            Figure(
                f"{model}.p-of-layers",
                layers,
                "1",
                "smallest p against a picture blurred in layers, which is wrong: shows the power of the test",
            ),
        ]
        t_map = np.full(both.shape, np.nan)
        t_map[both] = t
        pictures.append((f"Reference, render with diffraction '{model}', and t", _plot(reference, rendered, t_map)))
    figures += [
        Figure("quadrature", quadrature, "1", "RMS quadrature error of the reference, relative to white paper"),
        Figure("diffraction", diffraction, "1", "largest effect of diffraction on an edge, as a share of its step"),
        Figure("pixels", float(both.sum()), "px", "pixels compared: those that see both planes"),
    ]
    return Evidence(figures, pictures)


def _renders(scene: dasim.Scene, camera: Camera, model: str) -> FloatArray:
    """Electrons per second in ``CHANNEL`` through ``STOP`` alone, [seed, h, w]."""
    camera = rendering.changed(camera, stops=[camera.stops[STOP].model_dump()])
    pictures = [rendering.capture_rate(scene, camera, SPP, seed, diffraction=model) for seed in range(SEEDS)]
    return np.stack(pictures)[..., CHANNELS.index(CHANNEL)]


def edge_camera() -> Camera:
    """The camera of this claim: a lens of 12 mm with 32 x 24 pixels of 50 um."""
    return rendering.changed(
        cameras.load_camera("da-mobile"),
        lens={"focal_length_mm": FOCAL_MM, "focus_distance_m": FOCUS_M},
        sensor={"width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "pixel_pitch_um": PITCH_UM},
    )


def _normal(turn_deg: float) -> FloatArray:
    return np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))])


def edge_scene(camera: Camera) -> dasim.Scene:
    """A grey sheet that covers the left half of the view and stripes behind it, all as planes without image texture."""
    near_m, far_m = (rendering.depth_m(camera, blur) for blur in (NEAR_BLUR_PX, FAR_BLUR_PX))
    wide_cm, high_cm = 3.2, 5.0  # covers the frame's left half at the near depth, blur included
    objects = [
        {
            "name": "near",
            "shape": "plane",
            "size_cm": [wide_cm, high_cm],
            "rotation_deg": [0, 0, NEAR_TURN_DEG],
            "position_cm": [*(-wide_cm / 2 * _normal(NEAR_TURN_DEG)), near_m * 100],
            "material": NEAR,
        }
    ]
    stripe_cm = STRIPE_PX * rendering.pixel_at_m(camera, far_m) * 100
    count = int(np.ceil(0.75 * np.hypot(*SIZE_PX) / STRIPE_PX))
    for k in range(-count, count):
        objects.append(
            {
                "name": f"stripe {k}",
                "shape": "plane",
                "size_cm": [stripe_cm, 2 * count * stripe_cm],
                "rotation_deg": [0, 0, STRIPE_TURN_DEG],
                "position_cm": [*((k + 0.5) * stripe_cm * _normal(STRIPE_TURN_DEG)), far_m * 100],
                "material": DARK if k % 2 else BRIGHT,
            }
        )
    lamp = {
        "kind": "lamp",
        "illuminant": "D65",
        "lux": 1000.0,
        "position_cm": list(LAMP_CM),
        "target_cm": list(LAMP_TARGET_CM),
        "radius_cm": LAMP_RADIUS_CM,
    }
    return rendering.make_scene(objects, [lamp])


def reference_picture(camera: Camera) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], float]:
    """The brute-force picture, a picture blurred in layers, the mask of pixels that see both planes, and an error.

    Pictures are [h, w], relative to white paper at the far plane on the axis. The error is the root mean square of the
    quadrature error over the mask.
    """
    from dasim.spectra import grid

    light = (
        illuminants.illuminant("D65") * radiometry.stop_response(camera, camera.stops[STOP])[CHANNELS.index(CHANNEL)]
    )
    bright, dark, near = (grid.integrate(light * library.reflectance(m)) for m in (BRIGHT, DARK, NEAR))
    image_m = 1 / (1 / (FOCAL_MM * 1e-3) - 1 / FOCUS_M)
    pixel = PITCH_UM * 1e-6 / image_m  # of the picture at 1 m
    root = 1.1673039782614187  # of x^5 = x + 1: Roberts's R4 sequence
    points = (0.5 + np.outer(np.arange(1, QUADRATURE + 1), root ** -np.arange(1.0, 5.0))) % 1.0
    radius_m = FOCAL_MM * 1e-3 / camera.lens.f_number / 2 * np.sqrt(points[:, 2])
    pupil = radius_m[:, None] * np.stack([np.cos(2 * np.pi * points[:, 3]), np.sin(2 * np.pi * points[:, 3])], axis=-1)
    near_m, far_m = (rendering.depth_m(camera, blur) for blur in (NEAR_BLUR_PX, FAR_BLUR_PX))
    stripe_m = STRIPE_PX * rendering.pixel_at_m(camera, far_m)
    unit = _illuminance(np.zeros(2), far_m)
    width, height = SIZE_PX
    halves, layered, covered = np.empty((2, height, width)), np.empty((height, width)), np.empty((height, width))
    for y, x in np.ndindex(height, width):
        focus = (points[:, :2] + (x - width / 2, y - height / 2)) * pixel * FOCUS_M

        def at(depth_m: float, focus: FloatArray = focus) -> FloatArray:
            return pupil + (focus - pupil) * (depth_m / FOCUS_M)

        on_near, on_far = at(near_m), at(far_m)
        hidden = on_near @ _normal(NEAR_TURN_DEG) <= 0
        stripe = np.floor(on_far @ _normal(STRIPE_TURN_DEG) / stripe_m).astype(int) % 2
        far_light = np.where(stripe == 0, bright, dark) * _illuminance(on_far, far_m)
        near_light = near * _illuminance(on_near, near_m)
        visible = np.where(hidden, near_light, far_light)
        halves[:, y, x] = visible.reshape(2, -1).mean(axis=1)
        covered[y, x] = hidden.mean()
        layered[y, x] = covered[y, x] * near_light.mean() + (1 - covered[y, x]) * far_light.mean()
    y, x = np.indices((height, width)) + 0.5
    cos4 = (1 + ((x - width / 2) ** 2 + (y - height / 2) ** 2) * pixel**2) ** -2.0
    halves, layered = halves * cos4 / (bright * unit), layered * cos4 / (bright * unit)
    both = (covered > 0) & (covered < 1)
    error = float(np.sqrt(np.mean((halves[0] - halves[1])[both] ** 2)) / 2)
    return halves.mean(axis=0), layered, both, error


def _illuminance(place_m: FloatArray, depth_m: float) -> FloatArray:
    """Relative illuminance, cos cos / distance^2, of surfaces that face the camera at x, y [..., 2] and a depth."""
    lamp, target = np.array(LAMP_CM) / 100, np.array(LAMP_TARGET_CM) / 100
    axis = (target - lamp) / np.linalg.norm(target - lamp)
    x, y, z = place_m[..., 0] - lamp[0], place_m[..., 1] - lamp[1], depth_m - lamp[2]
    squared = x**2 + y**2 + z**2
    return z * (x * axis[0] + y * axis[1] + z * axis[2]) / squared**2


def diffraction_error(camera: Camera) -> float:
    """Largest difference between the edge spread functions of wave optics and geometry, over both planes, at 550 nm."""
    image_mm = 1 / (1 / FOCAL_MM - 1e-3 / FOCUS_M)
    scale_px = 0.55 * image_mm * camera.lens.f_number / FOCAL_MM / PITCH_UM
    frequency = np.arange(0.001, 4.0, 0.002)  # cycles per pixel; beyond, the pixel's transfer function is negligible
    place = np.linspace(0.0, 4.0, 161)
    worst = 0.0
    for blur in (NEAR_BLUR_PX, FAR_BLUR_PX):
        wave = transfer.hopkins_otf(scale_px * frequency, blur / (8 * scale_px))
        change = (wave - transfer.disc_transfer(blur * frequency)) * np.sinc(frequency) / (np.pi * frequency)
        worst = max(worst, float(np.abs(np.sin(2 * np.pi * np.outer(place, frequency)) @ change * 0.002).max()))
    return worst


def t_values(rendered: FloatArray, reference: FloatArray, own_error: float) -> FloatArray:
    """Student's t of the mean over seeds of ``rendered`` [seed, ...] against a reference known to ``own_error``."""
    variance = rendered.var(axis=0, ddof=1) / len(rendered) + own_error**2
    return (rendered.mean(axis=0) - reference) / np.sqrt(variance)


def smallest_p(t: FloatArray) -> float:
    """The smallest two-sided p of values of t with ``SEEDS`` - 1 degrees of freedom, by Sidak's correction."""
    smallest = 2 * student.sf(np.abs(t).max(), SEEDS - 1)
    return float(-np.expm1(t.size * np.log1p(-smallest)))


def _plot(reference: FloatArray, rendered: FloatArray, t: FloatArray) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        images = (reference, rendered.mean(axis=0), t)
        for panel, image, title in zip(axes, images, ("reference", "render", "t"), strict=True):
            limits = {"cmap": "PuOr", "vmin": -5, "vmax": 5} if title == "t" else {"cmap": "gray", "vmin": 0, "vmax": 1}
            mapped = panel.imshow(image, interpolation="nearest", **limits)
            panel.set(title=title, xticks=[], yticks=[])
            if title == "t":
                panel.figure.colorbar(mapped, ax=panel)

    return plot(draw, columns=3, size=(3.6, 2.8))
