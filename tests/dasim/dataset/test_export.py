"""Exports of datasets, read back by the libraries of their formats."""

from __future__ import annotations

import errno
import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import dasim
from dasim.camera.specification import CAMERA_DIR
from dasim.cli import run
from dasim.dataset import verify
from dasim.dataset.export import coco
from dasim.dataset.sample import key
from dasim.scene.classes import CLASSES
from tests.support.datasets import WALL, make_dataset, spec_file

BALL = """
[[objects]]
name = "ball"
shape = "sphere"
radius_cm = 4
position_cm = [3, 0, 40]
material = "grey-card"
"""
FROM_PYCOCOTOOLS = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
VIEW = """
[view]
position_cm = [4, 0, -5]
look_at_cm = [0, 0, 50]
"""


@pytest.fixture(scope="module")
def dataset(renderer, tmp_path_factory) -> Path:
    """Two scenes, one seen from the side, six captures: three focus distances with two f-numbers; a margin of 2 px."""
    folder = tmp_path_factory.mktemp("export")
    (folder / "side.toml").write_text(WALL.replace('"wall"\nfocus', '"side"\nfocus') + BALL + VIEW)
    more = (
        '[truth]\nmargin_px = 2\n[focus]\ndistance_m = {each = [0.05, 0.2, 0.8]}\n[[cameras]]\nname = "da-mobile"\n'
        '[cameras.vary]\n"sensor.pixel_pitch_um" = 50.0\n"lens.f_number" = {each = [1.8, 4.0]}\n'
    )
    top = 'splits = {train = 0.5, test = 0.5}\nlicence = "CC0-1.0"'
    spec = spec_file(folder, samples=12, files=["wall.toml", "side.toml"], more=more, top=top)
    spec.write_text(spec.read_text().replace("[32, 24]", "[40, 36]"))
    make_dataset(spec, folder / "ds")
    return folder / "ds"


@pytest.fixture(scope="module")
def samples(dataset):
    return list(dasim.open_dataset(dataset))


@pytest.fixture
def exported(dataset, tmp_path):
    """Function that exports the dataset with sharp pictures; returns the folder."""

    def make(form: str, *options: str) -> Path:
        picture = () if form == "hdf5" else ("--picture", "sharp")
        assert (
            run(["dataset", "export", str(dataset), "--as", form, "--out", str(tmp_path / form), *picture, *options])
            == 0
        )
        assert (tmp_path / form / "README.md").read_text().startswith("# tiny 1.0\n\nLicence: CC0-1.0.")
        return tmp_path / form

    return make


def projected(intrinsic, points_m):
    """Pixels [n, 2] of points [n, 3] in camera axes, for pixel centres at whole numbers."""
    places = points_m @ np.asarray(intrinsic).T
    return places[:, :2] / places[:, 2:]


def check_centres(sample, intrinsic, to_camera):
    """The ball's centre must be seen in the middle of its pixels, and lie a radius behind its nearest point."""
    number = sample.truth["objects"].index("ball") + 1
    assert (sample.truth["object_id"] != number).any()
    inside = sample.truth["object_id"] == number
    centre = np.asarray(to_camera) @ [0, 0, 0, 1]
    ((x, y),) = projected(intrinsic, centre[None, :3])
    rows, columns = np.nonzero(inside)
    height, width = inside.shape
    if rows.min() > 0 and rows.max() < height - 1 and columns.min() > 0 and columns.max() < width - 1:  # whole
        assert abs(columns.mean() - x) < 0.5 and abs(rows.mean() - y) < 0.5
    assert inside[round(y), round(x)]
    assert sample.truth["depth_m"][inside].min() == pytest.approx(centre[2] - 0.04, abs=2e-3)


def test_hdf5_has_all_that_the_dataset_has(exported, samples):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    folder = exported("hdf5")
    for sample in samples:
        with h5py.File(folder / f"{sample.split}.h5") as file:
            group = file[key(sample.index)]
            np.testing.assert_array_equal(group["raw_dn"][:], sample.raw_dn)
            assert json.loads(group["meta"][()]) == sample.meta and dict(file.attrs)["licence"] == "CC0-1.0"
            arrays = {name: value for name, value in sample.truth.items() if isinstance(value, np.ndarray)}
            assert set(group) == {"raw_dn", "meta", "objects", "materials", "classes", *arrays}
            for name in ("objects", "materials"):
                assert tuple(group[name].asstr()[:]) == tuple(sample.truth[name])
            assert tuple(group["classes"].asstr()[:]) == CLASSES
            for name, value in arrays.items():
                np.testing.assert_array_equal(group[name][:], value)
                assert group[name].dtype == value.dtype
            assert list(group.attrs["channels"]) == ["R", "G", "B", "IR"]
            # The matrix of meta.json has pixel centres at +0.5, and the frame a margin of 2 px.
            shift = np.array(sample.meta["intrinsic_matrix_px"]) - group.attrs["intrinsic_px"]
            np.testing.assert_allclose(shift, [[0, 0, 2.5], [0, 0, 2.5], [0, 0, 0]], atol=1e-9)


@FROM_PYCOCOTOOLS
def test_coco_is_read_by_pycocotools(exported, samples):
    """Expectation: masks, areas and boxes are those of the labels; categories mean the same in every dataset; the pose
    of the ball projects to its pixels.
    """
    reader = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    folder = exported("coco")
    seen = 0
    for split in ("train", "test"):
        index = reader.COCO(str(folder / "annotations" / f"instances_{split}.json"))
        assert [category["name"] for category in index.loadCats(index.getCatIds())] == list(CLASSES)
        for sample in (sample for sample in samples if sample.split == split):
            (image,) = index.loadImgs([sample.index])
            picture = cv2.imread(str(folder / split / image["file_name"]))[..., ::-1]
            np.testing.assert_array_equal(picture, np.rint(255 * np.clip(sample.truth["sharp_srgb"], 0, 1)))
            steps = cv2.imread(str(folder / split / image["depth_file_name"]), cv2.IMREAD_UNCHANGED)
            known = sample.truth["valid"]
            np.testing.assert_allclose(
                (steps * image["depth_scale_m"])[known], sample.truth["depth_m"][known], atol=5.1e-5
            )
            for item in index.loadAnns(index.getAnnIds(imgIds=[sample.index])):
                mask = index.annToMask(item).astype(bool)
                number = sample.truth["objects"].index(item["object_name"]) + 1
                np.testing.assert_array_equal(mask, sample.truth["object_id"] == number)
                rows, columns = np.nonzero(mask)
                x, y, width, height = item["bbox"]
                assert (x, y, x + width - 1, y + height - 1) == (columns.min(), rows.min(), columns.max(), rows.max())
                assert item["area"] == mask.sum()
                assert item["category_id"] == sample.truth["class_id"][mask][0]
                if item["object_name"] == "ball":
                    check_centres(sample, image["camera_matrix"], item["object_to_camera"])
                    seen += 1
    assert seen == 6


@FROM_PYCOCOTOOLS
@pytest.mark.parametrize("seed", range(4))
def test_run_lengths_are_those_of_pycocotools(seed):
    masks = pytest.importorskip("pycocotools.mask", reason="pycocotools is not installed")
    mask = np.random.default_rng(seed).random((7, 5)) < (0.0, 0.2, 0.6, 1.0)[seed]
    rle = masks.frPyObjects({"size": [7, 5], "counts": coco.run_lengths(mask)}, 7, 5)
    np.testing.assert_array_equal(masks.decode(rle).astype(bool), mask)


def test_bop_has_poses_depth_and_masks(exported, samples):
    """Expectation: what the format's description asks for. Points of the picture, taken to the scene by depth, matrix
    and pose, lie on the wall (z = 50 cm there) or on the ball, in every picture.
    """
    folder = exported("bop")
    numbered = {name: number for number, name in enumerate(dict.fromkeys(s.meta["sample"]["scene"] for s in samples))}
    images: dict[str, int] = {}
    objects = json.loads((folder / "objects.json").read_text())
    assert {item["name"] for item in objects.values()} == {"wall", "ball"} and len(objects) == 3
    assert objects["1"]["class"] in CLASSES
    for sample in samples:
        scene = sample.meta["sample"]["scene"]
        place, image = folder / sample.split / f"{numbered[scene]:06d}", images.get(scene, 0)
        images[scene] = image + 1
        camera = json.loads((place / "scene_camera.json").read_text())[str(image)]
        intrinsic = np.reshape(camera["cam_K"], (3, 3))
        rotation, shift = np.reshape(camera["cam_R_w2c"], (3, 3)), np.array(camera["cam_t_w2c"])
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        depth_mm = cv2.imread(str(place / "depth" / f"{image:06d}.png"), cv2.IMREAD_UNCHANGED) * camera["depth_scale"]
        y, x = np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]]
        seen = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(intrinsic).T * depth_mm[..., None]
        world = (seen - shift) @ rotation
        truths = json.loads((place / "scene_gt.json").read_text())[str(image)]
        infos = json.loads((place / "scene_gt_info.json").read_text())[str(image)]
        assert cv2.imread(str(place / "rgb" / f"{image:06d}.png")).shape == (32, 36, 3)
        for number, (truth, info) in enumerate(zip(truths, infos, strict=True)):
            mask = cv2.imread(str(place / "mask_visib" / f"{image:06d}_{number:06d}.png"), cv2.IMREAD_UNCHANGED) > 0
            assert mask.sum() == info["px_count_visib"] == info["px_count_valid"]
            if objects[str(truth["obj_id"])]["name"] == "wall":
                assert np.abs(world[mask][:, 2] - 500).max() < 0.2
            else:
                radius = np.linalg.norm(world[mask] - (30, 0, 400), axis=-1)
                assert np.abs(np.median(radius) - 40) < 0.2
                to_camera = np.eye(4)
                to_camera[:3, :3], to_camera[:3, 3] = (
                    np.reshape(truth["cam_R_m2c"], (3, 3)),
                    np.array(truth["cam_t_m2c"]) / 1e3,
                )
                check_centres(sample, intrinsic, to_camera)


def test_nyu_has_the_variables_of_the_original(exported, samples):
    """Expectation: scipy knows the version of the file; h5py reads the arrays in the reverse order of MATLAB's axes."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    matlab = pytest.importorskip("scipy.io.matlab")
    folder = exported("nyu")
    for split in ("train", "test"):
        assert matlab.matfile_version(str(folder / f"{split}.mat")) == (2, 0)
        some = [sample for sample in samples if sample.split == split]
        with h5py.File(folder / f"{split}.mat") as file:
            assert file["images"].shape == (len(some), 3, 36, 32) and file["images"].dtype == np.uint8
            assert file["depths"].attrs["MATLAB_class"] == b"single"
            for number, sample in enumerate(some):
                shown = np.rint(255 * np.clip(sample.truth["sharp_srgb"], 0, 1))
                np.testing.assert_array_equal(file["images"][number].transpose(2, 1, 0), shown)
                np.testing.assert_array_equal(file["depths"][number].T, np.nan_to_num(sample.truth["depth_m"]))
                np.testing.assert_array_equal(file["labels"][number].T, sample.truth["class_id"])
                np.testing.assert_array_equal(file["instances"][number].T, sample.truth["object_id"])
                assert file["focusDistances"][number] == sample.meta["camera"]["lens"]["focus_distance_m"]
            names = [file[at][:].tobytes().decode("utf-16-le") for at in file["names"][0]]
            scenes = [file[at][:].tobytes().decode("utf-16-le") for at in file["scenes"][0]]
        assert names == list(CLASSES) and scenes == [sample.meta["sample"]["scene"] for sample in some]


def test_stack_has_one_depth_for_all_its_pictures(exported, samples):
    """Rationale: a lens that focuses nearer shows less. Set-up: the sharp pictures, which show where things are at
    every focus. Expectation: they are much nearer to each other than those of the dataset.
    """
    folder = exported("stack")
    for scene in ("wall.toml", "side.toml"):
        some = [sample for sample in samples if sample.meta["sample"]["scene"] == scene]
        (place,) = folder.glob(f"*/{scene}")
        about = json.loads((place / "stack.json").read_text())
        pairs = [(item["focus_m"], item["f_number"]) for item in about["pictures"]]
        assert pairs == [(d, n) for d in (0.05, 0.2, 0.8) for n in (1.8, 4.0)]
        lens = some[0].meta["camera"]["lens"]
        assert about["focal_length_mm"] == lens["focal_length_mm"]
        # Thin lens: the image distance is d f / (d - f), and the picture's scale goes with it.
        f = lens["focal_length_mm"] * 1e-3
        image_m = [d * f / (d - f) for d, _ in pairs]
        assert [item["scale"] for item in about["pictures"]] == pytest.approx([image_m[0] / s for s in image_m])
        depth = np.load(place / "depth.npy")
        np.testing.assert_array_equal(depth, some[0].truth["depth_m"])
        np.testing.assert_allclose(np.loadtxt(place / "intrinsics.txt"), about["intrinsics"])
        pictures = [cv2.imread(str(place / item["file"])).astype(float) for item in about["pictures"]]
        assert pictures[0].shape == (*depth.shape, 3) == cv2.imread(str(place / "all-in-focus.png")).shape
        if scene == "side.toml":  # the wall alone shows no scale
            stored = [np.rint(255 * np.clip(s.truth["sharp_srgb"], 0, 1))[..., ::-1] for s in some]
            apart, before = (
                [float(np.abs(picture - pictures[0])[3:-3, 3:-3].mean()) for picture in shown]
                for shown in (pictures, stored)
            )
            assert apart[1] == before[1] and all(a < 0.6 * b for a, b in zip(apart[2:], before[2:], strict=True))


def test_aligned_pictures_are_those_of_the_other_pinhole():
    """A picture of a linear ramp through one matrix is the ramp through the other, to rounding."""
    from dasim.dataset.export.frames import Frame
    from dasim.dataset.export.stack import aligned

    far = np.array([[100.0, 0, 30.5], [0, 100.0, 20.25], [0, 0, 1]])
    near = np.array([[110.0, 0, 30.5], [0, 110.0, 20.25], [0, 0, 1]])
    y, x = np.mgrid[:40, :60]

    def ramp(matrix):
        place_x, place_y = (x - matrix[0, 2]) / matrix[0, 0], (y - matrix[1, 2]) / matrix[1, 1]
        return np.repeat((128 + 200 * place_x + 150 * place_y)[..., None], 3, -1)

    frame = Frame(None, "", "", np.rint(ramp(far)).astype(np.uint8), far, None, ())  # type: ignore[arg-type]
    assert np.abs(aligned(frame, near) - ramp(near))[2:-2, 2:-2].max() < 1.6
    assert aligned(frame, far) is frame.picture


def test_croissant_is_read_by_its_library(dataset, samples, capsys):
    """Expectation: mlcroissant accepts the description and yields the rows of the index; the dataset stays valid."""
    pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    assert run(["dataset", "export", str(dataset), "--as", "croissant"]) == 0
    program = (
        "import json, sys, mlcroissant\n"
        "described = mlcroissant.Dataset(jsonld=sys.argv[1])\n"
        "assert not described.metadata.ctx.issues.errors, described.metadata.ctx.issues.report()\n"
        "text = lambda value: value.decode() if isinstance(value, bytes) else value\n"
        "rows = [{name.split('/')[-1]: text(v) for name, v in r.items()} for r in described.records('samples')]\n"
        "print(json.dumps([[r['key'], r['split'], float(r['focus_m'])] for r in rows]))\n"
    )  # a process of its own: its libraries warn of each other
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, str(dataset / "croissant.json")],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        expected = [[key(s.index), s.split, s.meta["camera"]["lens"]["focus_distance_m"]] for s in samples]
        assert json.loads(done.stdout.splitlines()[-1]) == expected
        assert list(verify.problems(str(dataset))) == []
    finally:
        (dataset / "croissant.json").unlink()


def test_pictures_as_taken(dataset, tmp_path):
    """Expectation: the mosaic within the margin, developed for the light of the scene."""
    import recon
    from dasim.files.captures import capture_of

    arguments = ["dataset", "export", str(dataset), "--as", "coco", "--split", "test", "--out", str(tmp_path / "coco")]
    assert run(arguments) == 0
    sample = dasim.open_dataset(dataset, "test")[0]
    found = cv2.imread(str(tmp_path / "coco" / "test" / f"{key(sample.index)}.png"))[..., ::-1]
    shown = recon.develop(capture_of(sample.meta, sample.raw_dn, "sample"), lights=["D65"]).rgb[2:-2, 2:-2]
    assert np.abs(found / 255 - shown).max() < 0.51 / 255
    assert not (tmp_path / "coco" / "train").exists()


def test_a_full_disk_leaves_nothing(dataset, tmp_path, capsys, monkeypatch):
    """Set-up: the third depth picture cannot be written. Expectation: one line, status 2, and no folder."""
    written = []

    def fail_late(path, *rest):
        written.append(path)
        if len(written) == 3:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(coco, "write_depth", fail_late)
    options = ["--as", "coco", "--picture", "sharp", "--out", str(tmp_path / "new")]
    assert run(["dataset", "export", str(dataset), *options]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "No space left" in line]
    assert lines == [f"dasim: {tmp_path}/new: No space left on device"] and not list(tmp_path.iterdir())


def test_an_index_of_strangers_writes_nothing_outside(dataset, tmp_path, capsys):
    """Set-up: a split in the index is a path. Expectation: it is refused, since splits become folders."""
    parquet = pytest.importorskip("pyarrow.parquet")
    shutil.copytree(dataset, tmp_path / "ds")
    table = parquet.read_table(tmp_path / "ds" / "index.parquet")
    place = table.schema.get_field_index("split")
    parquet.write_table(
        table.set_column(place, "split", [["../../out"] * len(table)]), tmp_path / "ds" / "index.parquet"
    )
    for form in ("coco", "bop", "nyu", "stack", "hdf5"):
        assert run(["dataset", "export", str(tmp_path / "ds"), "--as", form, "--out", str(tmp_path / "new")]) == 2
        assert "a split '../../out', which does not exist" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ds"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--as", "tfds", "--out", "{new}/x"], "tfds"),
        (["--as", "coco", "--out", "{new}"], "exists; choose another name"),
        (["--as", "coco", "--out", "{new}/no/x"], "does not exist"),
        (["--as", "coco", "--out", "{new}/x", "--split", "val"], "no split 'val'"),
        (["--as", "croissant", "--out", "{new}/x"], "leave out --out and --split"),
        (["--as", "croissant", "--picture", "sharp"], "--picture: applies to coco, bop, nyu and stack"),
        (["--as", "hdf5", "--picture", "taken", "--out", "{new}/x"], "--picture: applies to"),
    ],
)
def test_mistakes_end_in_one_line(dataset, tmp_path, capsys, options, message):
    status = run(["dataset", "export", str(dataset), *(text.format(new=tmp_path) for text in options)])
    error = capsys.readouterr().err
    assert status == 2 and message in error and error.count("\n") == 1 and not list(tmp_path.iterdir())


def test_the_folder_by_default(dataset, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["dataset", "export", str(dataset), "--as", "coco", "--picture", "sharp", "--split", "test"]
    assert run(arguments) == 0 and (tmp_path / "out" / "tiny-coco" / "README.md").is_file()
    assert run(arguments) == 2
    assert "out/tiny-coco: exists; name another folder with --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("keep", "form", "message"),
    [
        (["blur"], "bop", "lacks depth, labels of the truth"),
        (["blur"], "nyu", "lacks depth"),
        (["labels"], "coco --picture sharp", "lacks sharp_srgb"),
        (["depth"], "stack", "has one focus and f-number"),
        (["depth"], "nyu", "32 x 24 pixels are too few"),
    ],
)
def test_what_a_dataset_lacks(renderer, tmp_path, capsys, keep, form, message):
    """Expectation: one line, and no folder, also where the lack shows in the middle of the work."""
    make_dataset(spec_file(tmp_path, samples=1, more=f"[truth]\nkeep = {keep}"), tmp_path / "ds")
    options = ["--as", *form.split(), "--out", str(tmp_path / "new")]
    assert run(["dataset", "export", str(tmp_path / "ds"), *options]) == 2
    assert message in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ds", "spec.toml", "wall.toml"]


def test_distortion_is_stated_and_no_pinhole_of_bop(jit, tmp_path, capsys):
    """Rationale: with a matrix alone, a reader of the export would misplace points by several pixels."""
    lens = "[lens]\ndistortion_per_mm = [0.015]\n"
    camera = (CAMERA_DIR / "da-mobile.toml").read_text().replace("[lens]\n", lens)
    (tmp_path / "bent.toml").write_text(camera)
    spec = spec_file(tmp_path, samples=1, files=["wall.toml"], more='[[cameras]]\nname = "bent.toml"\n')
    make_dataset(spec, tmp_path / "ds")
    options = ["dataset", "export", str(tmp_path / "ds"), "--out"]
    assert run([*options, str(tmp_path / "bop"), "--as", "bop"]) == 2
    assert "the lens of da-mobile has distortion_per_mm" in capsys.readouterr().err
    assert run([*options, str(tmp_path / "hdf5"), "--as", "hdf5"]) == 0
    assert "Distortion: the lens of da-mobile has" in (tmp_path / "hdf5" / "README.md").read_text()
