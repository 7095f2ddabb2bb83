"""Tests of `cairn recognize`."""

import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cairn.vision.camera_file import write_camera
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import add_views
from cairn.visual_map.sqlite_file import create
from tests.commands import cairn
from tests.components.object_recognizer.scenes import (
    BASELINE,
    FOCAL,
    SIZE,
    Thing,
    info,
    pair,
    photograph,
    picture_of,
)
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = pytest.mark.images


THINGS = [Thing(1, -0.3, 1.5), Thing(3, 0.35, 1.8)]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a map, a pair of images and calibrations; tests must copy it.

    The map has models of object 1 with its size and of object 3 without.
    """
    folder = tmp_path_factory.mktemp("prepared")
    create(folder / "a.cairn", "a test").close()
    add_views(folder / "a.cairn", "poster", [make_view(picture_of(1))], SIZE)
    add_views(folder / "a.cairn", "clock", [make_view(picture_of(3))])
    for name, image in zip(("left", "right"), pair(THINGS), strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), image)
    write_camera(folder / "left.yaml", info(), "left")
    write_camera(folder / "right.yaml", info(right=True), "right")
    return folder


@pytest.fixture(autouse=True)
def folder(prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run the commands in a copy of `prepared`."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAIRN_VISUAL_MAP", "a.cairn")
    return tmp_path


def test_detections_are_printed_and_drawn(folder: Path) -> None:
    found = cairn("recognize", "left.png", "--json", "--out", "found.png").json

    assert {one["name"]: one["object_id"] for one in found["objects"]} == {"poster": 1, "clock": 2}
    poster = next(one for one in found["objects"] if one["name"] == "poster")
    (x, y), *_ = poster["corners"]
    assert (x, y) == pytest.approx((320 + 500 * -0.5 / 1.5, 240 - 500 * 0.15 / 1.5), abs=2)
    assert poster["inliers"] > 20
    assert poster["alternatives"] == []
    assert [poster[key] for key in ("range", "bearing", "covariance", "position", "ranged_by")] == (
        [None] * 5
    )
    assert_words(" ".join(found["remarks"]), "no range", "--camera-info")
    drawn = np.asarray(cv2.imread("found.png"))
    assert (drawn[..., 0] != drawn[..., 2]).any()  # colors: outlines


def test_single_camera_ranges_by_size_and_a_pair_by_both(folder: Path) -> None:
    alone = cairn("recognize", "left.png", "--camera-info", "left.yaml", "--json").json
    both = cairn(
        "recognize", "left.png", "right.png", "--camera-info", "left.yaml",
        "--camera-info", "right.yaml", "--json",
    ).json  # fmt: skip

    by_size, by_both = ({one["name"]: one for one in f["objects"]} for f in (alone, both))
    assert by_size["poster"]["ranged_by"] == "size"
    assert by_size["clock"]["range"] is None
    assert "its size is not known" in by_size["clock"]["warning"]
    assert by_both["poster"]["ranged_by"] == "both"
    assert by_both["clock"]["ranged_by"] == "stereo"
    for one, thing in ((by_both["poster"], THINGS[0]), (by_both["clock"], THINGS[1])):
        assert one["range"] == pytest.approx(math.hypot(thing.x, thing.z), abs=0.05)
        assert one["bearing"] == pytest.approx(math.atan2(-thing.x, thing.z), abs=0.01)
        assert np.linalg.eigvalsh(np.reshape(one["covariance"], (2, 2))).min() > 0
    assert by_both["poster"]["covariance"][0] < by_size["poster"]["covariance"][0]

    printed = cairn("recognize", "left.png", "--camera-info", "left.yaml").out
    assert "m away, bearing +11.3" in printed


BOTH = ("--camera-info", "left.yaml", "--camera-info", "right.yaml")


@pytest.mark.parametrize(
    ("right", "words"),
    sampled(
        [
            ("black.png", "right image; too dark"),
            ("left.png", "right image; same; left"),
            ("elsewhere.png", "left image; right"),
            ("without.png", "objects; not found; right image"),
        ]
    ),
)
def test_useless_right_image_is_reported(folder: Path, right: str, words: str) -> None:
    cv2.imwrite("black.png", np.zeros((480, 640), np.uint8))
    cv2.imwrite("elsewhere.png", cv2.flip(photograph([Thing(7, 0.0, 0.9)]), 0))
    cv2.imwrite("without.png", photograph([]))
    cv2.imwrite("alone.png", photograph([Thing(1, 0.6, 4.0)]))
    left = "alone.png" if right == "without.png" else "left.png"

    answer = cairn("recognize", left, right, *BOTH, "--json")

    assert_words(answer.json["no_stereo"], *words.split("; "))
    assert any(answer.json["no_stereo"] in remark for remark in answer.json["remarks"])
    assert {one["ranged_by"] for one in answer.json["objects"]} <= {"size", None}
    assert f"no stereo: {answer.json['no_stereo']}" in cairn("recognize", left, right, *BOTH).err


def test_misaligned_rows_are_reported_and_stereo_is_not_used(folder: Path) -> None:
    right = cv2.imread("right.png", cv2.IMREAD_GRAYSCALE)
    cv2.imwrite("lower.png", np.roll(np.asarray(right), 3, axis=0))

    answer = cairn("recognize", "left.png", "lower.png", *BOTH, "--json").json

    assert_words(answer["no_stereo"], "rows", "not aligned")
    poster = next(one for one in answer["objects"] if one["name"] == "poster")
    assert poster["ranged_by"] == "size"
    assert poster["range"] == pytest.approx(math.hypot(0.3, 1.5), abs=0.1)
    assert_words(poster["warning"], "right image", "3 rows lower")


def test_calibration_ten_percent_off_is_reported_and_widens_the_covariance(folder: Path) -> None:
    write_camera(Path("right.yaml"), info(right=True, baseline=1.1 * BASELINE), "right")

    answer = cairn("recognize", "left.png", "right.png", *BOTH, "--json").json

    poster = next(one for one in answer["objects"] if one["name"] == "poster")
    off = abs(poster["range"] - math.hypot(0.3, 1.5))
    assert off < 3 * math.sqrt(poster["covariance"][0])
    assert_words(poster["warning"], "stereo", "size", "+10 %", "poster")


@pytest.mark.parametrize("suffix", ["jpg", "tif", "webp", "svg"])
def test_pictures_of_other_formats_are_drawn(folder: Path, suffix: str) -> None:
    answer = cairn("recognize", "left.png", "--out", f"found.{suffix}")

    assert answer.code == 0
    assert Path(f"found.{suffix}").stat().st_size > 1000


def test_correct_pair_gives_no_remarks(folder: Path) -> None:
    answer = cairn("recognize", "left.png", "right.png", *BOTH, "--json")
    assert (answer.json["no_stereo"], answer.json["remarks"]) == (None, [])


def test_swapped_images_of_distant_objects_are_rejected(folder: Path) -> None:
    for name, image in zip(("left", "right"), pair([Thing(1, 0.0, 4.0)]), strict=True):
        cv2.imwrite(f"{name}.png", image)

    assert "left and right are swapped" in cairn("recognize", "right.png", "left.png", *BOTH).err


@pytest.mark.parametrize(
    ("focal", "baseline", "why", "ranged"),
    sampled(
        [
            (10.0, 0.1, "-90 % for poster); correct the object's size with", False),
            (1.0, 2.0, "+100 % for poster); correct the object's size with", False),
            (1.0, 1.13, "+13 % for poster); correct the object's size with", True),
            (10.0, 1.0, "the calibration has a field of view of 7 deg", True),
        ],
        2,
    ),
)
def test_implausible_calibration_is_reported(
    folder: Path, focal: float, baseline: float, why: str, ranged: bool
) -> None:
    for side in ("left", "right"):
        wrong = info(side == "right", baseline=baseline * BASELINE, focal=focal * FOCAL)
        write_camera(Path(f"{side}.yaml"), wrong, side)

    printed = cairn("recognize", "left.png", "right.png", *BOTH, "--json").json

    poster = next(one for one in printed["objects"] if one["name"] == "poster")
    assert (poster["range"] is not None) is ranged
    assert any(why in remark for remark in printed["remarks"])
    assert (poster["warning"] is not None) is (why.endswith("with"))


def test_image_without_detection_is_not_an_error(folder: Path) -> None:
    cv2.imwrite("other.png", picture_of(9))
    for image in ("other.png", cv2.imwrite("black.png", np.zeros((480, 640))) and "black.png"):
        answer = cairn("recognize", str(image))
        assert (answer.code, answer.out.strip()) == (0, "nothing recognized")
        assert cairn("recognize", str(image), "--json").json["objects"] == []
    assert "it is too dark" in cairn("recognize", "black.png").err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing.png",), "missing.png; cannot be read"),
        (("left.png", "--map", "b.cairn"), "b.cairn; no such map file"),
        (("left.png", "--camera-info", "c.yaml"), "c.yaml; no such calibration"),
        (("left.png", "--camera-info", "left.yaml", "--out", "no/found.png"), "cannot be written"),
        (
            ("right.png", "left.png", "--camera-info", "left.yaml", "--camera-info", "right.yaml"),
            "swapped; right.png; right camera",
        ),
        (("left.png", "--out", "left.png"), "--out left.png; input image"),
        (
            ("left.png", "right.png", "--camera-info", "right.yaml", "--camera-info", "left.yaml"),
            "swapped",
        ),
        (
            ("small.png", "--camera-info", "left.yaml"),
            "small.png; 400 x 300; left.yaml; 640 x 480",
        ),
        (
            ("left.png", "small.png", "--camera-info", "left.yaml", "--camera-info", "right.yaml"),
            "small.png; 400 x 300; right.yaml; 640 x 480",
        ),
    ],
)
def test_invalid_arguments_are_rejected_with_reason(
    folder: Path, arguments: tuple[str, ...], words: str
) -> None:
    cv2.imwrite("small.png", picture_of(1))
    answer = cairn("recognize", *arguments)
    assert answer.code == 1
    assert_words(answer.err, *words.split("; "))


def test_damaged_map_is_rejected_by_name(folder: Path) -> None:
    data = Path("a.cairn").read_bytes()
    Path("a.cairn").write_bytes(data[: len(data) // 2])
    answer = cairn("recognize", "left.png")
    assert answer.code == 1
    assert "a.cairn" in answer.err
