"""The commands list and camera: what is bundled, and the page of a camera.

Tested in tests/dasim/cli/test_list.py and tests/dasim/cli/test_camera.py.
"""

from __future__ import annotations

import inspect
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.cli import options

if TYPE_CHECKING:
    from dasim.camera.specification import Camera

KINDS = ("scenes", "cameras", "materials", "illuminants", "datasets", "claims", "studies", "methods", "presets")


def list_(
    kind: str = "",
    *,
    verbose: Annotated[bool, Parameter(negative="")] = False,
    plot: Annotated[bool, Parameter(negative="")] = False,
    out: Annotated[Path, Parameter(name="--out")] = Path("out/cameras"),
) -> int:
    """List bundled scenes, cameras, materials, illuminants, datasets, claims, studies, depth methods or presets.

    Args:
        kind: scenes, cameras, materials, illuminants, datasets, claims, studies, methods or presets
        verbose: print more detail
        plot: for cameras, also write the page of each camera, as 'dasim camera' does
        out: with --plot, output folder, with one folder per camera
    """
    if kind not in KINDS:
        what = f"list '{kind}' is unknown" if kind else "list: the kind is missing"
        raise InputError(f"{what}; allowed are {', '.join(KINDS)}{did_you_mean(kind, KINDS)}")
    if plot and kind != "cameras":
        raise InputError(f"--plot: applies to cameras, not to {kind}")
    if kind == "scenes":
        _list_scenes(verbose=verbose)
    elif kind == "cameras":
        _list_cameras(verbose=verbose, pages=out if plot else None)
    elif kind == "materials":
        _list_materials(verbose=verbose)
    elif kind == "illuminants":
        _list_illuminants(verbose=verbose)
    elif kind == "datasets":
        _list_datasets(verbose=verbose)
    elif kind == "claims":
        from validation.claims.table import CLAIMS

        list_claims(list(CLAIMS), verbose=verbose)
    elif kind == "studies":
        _list_studies(verbose=verbose)
    elif kind == "methods":
        _list_methods(verbose=verbose)
    else:
        _list_presets(verbose=verbose)
    return 0


def camera(
    name: str = "da-mobile",
    *,
    out: Annotated[Path | None, Parameter(name="--out")] = None,
    focus: float | None = None,
) -> int:
    """Print a camera's description and write its page: apertures with dimensions, kernels, transfer, responses, levels.

    The folder holds report.html, which contains everything and loads nothing from outside, the pictures as SVG and PNG,
    levels.csv and results.json.

    Args:
        name: a bundled name (see 'dasim list cameras') or a TOML file
        out: output folder, out/cameras/NAME by default; an earlier page there is replaced
        focus: focus distance in metres; the camera's by default
    """
    import dasim
    from dasim.files.folders import check_output

    view = dasim.load_camera(name)
    if focus is not None:
        view = dasim.refocused(view, focus)
    folder = Path("out/cameras") / Path(name).stem if out is None else out
    check_output(folder, "camera page")
    print(dasim.describe(view))
    _write_page(folder, view)
    return 0


def _write_page(folder: Path, view: Camera) -> None:
    """Write the page of a camera to a folder."""
    from validation.reports.camera import page

    with options.progress() as progress:
        page.write(folder, page.drawn(view, progress))
    print(f"page: {folder / 'report.html'}")


def _list_scenes(*, verbose: bool) -> None:
    from dasim.base.toml import parse_toml
    from dasim.scene.loading import SCENE_DIR, scene_descriptions
    from dasim.scene.specification import Scene

    for name, description in scene_descriptions().items():
        print(f"{name:<16}{description}")
        if verbose:
            print(f"{'':<16}{parse_toml(Scene, SCENE_DIR / f'{name}.toml')!r}")


def _list_cameras(*, verbose: bool, pages: Path | None) -> None:
    from dasim.camera import describe
    from dasim.camera import specification as cameras
    from dasim.files.folders import check_output

    for name in cameras.camera_names() if pages is not None else ():
        check_output((pages or Path()) / name, "camera page")
    for name in cameras.camera_names():
        loaded = cameras.load_camera(name)
        print(f"{name:<20}{loaded.description}")
        if verbose:
            print(textwrap.indent(describe.describe(loaded), "    ") + "\n")
        if pages is not None:
            _write_page(pages / name, loaded)


def _list_materials(*, verbose: bool) -> None:
    from dasim.materials import library
    from dasim.render.reflection import normal_reflectance
    from dasim.spectra.grid import WAVELENGTH_NM

    columns_nm = (450, 550, 650, 750, 800)
    if verbose:
        print(
            f"reflectance (of metals, glass and coatings at normal incidence) at {', '.join(map(str, columns_nm))} nm"
        )
    for name in library.material_names():
        kind, source = library.kind_and_source(name)
        if not verbose:
            print(f"{name:<24}{kind}")
            continue
        curve = normal_reflectance(library.surface(name, Path(".")))
        values = " ".join(f"{curve[WAVELENGTH_NM == nm][0]:.2f}" for nm in columns_nm)
        print(f"{name:<24}{kind:<9}{values}  {source}")


def _list_illuminants(*, verbose: bool) -> None:
    from dasim.spectra import illuminants

    if verbose:
        print("name                  CCT K  near-IR  continuation beyond the table")
    for name in (*illuminants.ILLUMINANTS, *(illuminants.EXAMPLES if verbose else illuminants.PATTERNS)):
        if not verbose:
            print(name)
            continue
        about = illuminants.description(name)
        print(f"{about.name:<20}{about.cct_k:>7.0f}{about.near_infrared:>9.2f}  {about.beyond}")
    if verbose:
        print("CCT: of the spectrum above 400 nm; near-IR: 650-810 nm photons relative to D65 at equal illuminance\n")
        print("\n".join(f"also: {pattern}" for pattern in illuminants.PATTERNS))


def _list_datasets(*, verbose: bool) -> None:
    from dasim.dataset.specification import bundled_names, load_spec

    for name in bundled_names():
        spec = load_spec(name)
        print(f"{name:<20}{spec.description}")
        if verbose:
            splits = ", ".join(f"{split} {share:g}" for split, share in spec.splits.items())
            print(f"{'':<20}{spec.samples} samples of {spec.size_px[0]} x {spec.size_px[1]} pixels; {splits}")


def _list_studies(*, verbose: bool) -> None:
    from validation.studies.sweep.loading import load_study, names
    from validation.studies.sweep.specification import points

    for name in names():
        spec = load_study(name)
        print(f"{name:<20}{spec.question}")
        if verbose:
            print(f"{'':<20}{len(points(spec))} points, {spec.seeds} seeds, over {', '.join(spec.parameters)}")
    print(f"{'bound':<20}Cramer-Rao bound of depth for one camera ('dasim study bound')")
    print(f"{'shape':<20}search for the shape of the near-infrared stop ('dasim study shape')")


def _list_methods(*, verbose: bool) -> None:
    import recon
    from recon.settings import DEFAULT_PRESET, DESCRIPTIONS

    for name in recon.METHODS:
        default = " (the default)" if name == DEFAULT_PRESET else ""
        print(f"{name:<22}{DESCRIPTIONS[name]}{default}")
    print(f"{'learned':<22}a network that sees the mosaic, its noise and the hole's size (needs the extra 'learn')")
    if verbose:
        print("your own: package.module:function or file.py:function, from a Capture and a PsfBank to a DepthEstimate")


def _list_presets(*, verbose: bool) -> None:
    from recon.settings import DEFAULT_PRESET, DESCRIPTIONS, PAPER, PRESETS

    for name, settings in PRESETS.items():
        default = " (the default)" if name == DEFAULT_PRESET else ""
        print(f"{name:<22}{DESCRIPTIONS[name]}{default}")
        changed = [key for key in type(settings).model_fields if getattr(settings, key) != getattr(PAPER, key)]
        if verbose:
            listed = ", ".join(f"{key} = {getattr(settings, key)!r}" for key in changed)
            print(f"{'':<22}{listed or 'the defaults of all settings'}")
    if verbose:
        print("all settings with their meanings: dasim recon --preset NAME --print-settings")


def list_claims(names: list[str], *, verbose: bool) -> None:
    """Print the claims of some ids, a line each, or with all of their docstrings."""
    from validation.claims.table import CLAIMS
    from validation.gates.outcome import title

    for name in names:
        text = f"\n{inspect.getdoc(CLAIMS[name].run)}\n" if verbose else title(CLAIMS[name])
        print(f"{name:<20}{'quick' if CLAIMS[name].quick else '':<7}{text}")
