"""Tests of listing image files and assigning them to cameras and pairs."""

from pathlib import Path

import pytest

from cairn import CairnError
from cairn.vision.image_files import assign_cameras, camera_of, images_in, natural_order, pair_files
from tests.wording import words_in_order

pytestmark = pytest.mark.images


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("left01.jpg", "left"),
        ("img_right_7.png", "right"),
        ("LeftImage3.png", "left"),
        ("frameRight.png", "right"),
        ("right/0001.png", "right"),
        ("left/right_of_it/0001.png", "right"),
        ("bright01.png", None),
        ("leftover.png", None),
        ("left_and_right.png", None),
        ("0001.png", None),
    ],
)
def test_name_determines_the_camera(name: str, side: str | None) -> None:
    assert camera_of(Path("data") / name) == side


def test_pairs_differ_in_the_side_and_are_in_natural_order() -> None:
    left = [Path(f"left{n}.png") for n in (10, 9, 1, 4)]
    right = [Path(f"right{n}.png") for n in (1, 10, 9, 5)]

    found = pair_files(left, right)

    assert [a.name for a, _ in found.pairs] == ["left1.png", "left9.png", "left10.png"]
    assert [b.name for _, b in found.pairs] == ["right1.png", "right9.png", "right10.png"]
    assert [path.name for path in found.unpaired] == ["left4.png", "right5.png"]


def test_pairs_of_several_folders_have_corresponding_folders() -> None:
    days = [Path(f"day{n}") for n in (1, 2)]
    left, right = ([day / f"{side}01.png" for day in days] for side in ("left", "right"))
    folders = [[day / side / "01.png" for day in days] for side in ("left", "right")]

    assert sorted(pair_files(left, right[:1]).pairs) == [(left[0], right[0])]
    assert pair_files(left, right[:1]).unpaired == (left[1],)
    assert sorted(pair_files(*folders).pairs) == list(zip(*folders, strict=True))


def test_ambiguous_files_of_one_camera_are_rejected() -> None:
    left = [Path("a/left01.png"), Path("a/left01.jpg")]

    with pytest.raises(
        CairnError, match=words_in_order("a/left01.png", "a/left01.jpg", "same name")
    ):
        pair_files(left, [Path("a/right01.png")])


def test_camera_folders_are_searched(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for number in (2, 10):
            (tmp_path / side / f"{number}.png").touch()
    (tmp_path / "left" / "notes.txt").touch()

    found = images_in(tmp_path)

    assert [str(path.relative_to(tmp_path)) for path in found] == [
        "left/2.png",
        "left/10.png",
        "right/2.png",
        "right/10.png",
    ]
    assert [camera_of(path) for path in found] == ["left", "left", "right", "right"]
    assert sorted(found, key=natural_order)[0].name == "2.png"


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("cam0_{}.png", "cam1_{}.png"),
        ("{}-camera1.png", "{}-camera2.png"),
        ("Cam_0/{}.png", "Cam_1/{}.png"),
        ("rig/cam2_{}.png", "rig/cam3_{}.png"),
    ],
)
def test_numbers_of_two_cameras_determine_left_and_right(left: str, right: str) -> None:
    ours, theirs = ([Path(name.format(n)) for n in (9, 10, 11)] for name in (left, right))

    sides = assign_cameras([*theirs, *ours])

    assert [path for path, side in sides.items() if side == "left"] == ours
    assert [path for path, side in sides.items() if side == "right"] == theirs
    assert pair_files(ours, theirs).pairs == tuple(zip(ours, theirs, strict=True))


@pytest.mark.parametrize(
    "names",
    [
        ["cam0.png", "cam1.png", "cam2.png"],  # a series
        ["cam0_1.png", "cam0_2.png"],
        ["webcam0_1.png", "webcam1_1.png"],
        ["cam0_1.png", "cam1_1.png", "1.png"],
        ["cam1/1.png", "cam1/2.png"],
    ],
)
def test_other_numbers_belong_to_one_camera(names: list[str]) -> None:
    assert set(assign_cameras(map(Path, names)).values()) == {None}


def test_words_take_precedence_over_numbers() -> None:
    names = ["cam0/right_1.png", "cam1/left_1.png", "cam1/other.png"]

    assert list(assign_cameras(map(Path, names)).values()) == ["right", "left", None]


def test_folders_of_three_cameras_are_rejected(tmp_path: Path) -> None:
    for number in range(3):
        (tmp_path / f"cam{number}").mkdir()
        (tmp_path / f"cam{number}" / "1.png").touch()

    with pytest.raises(CairnError, match=words_in_order("cam2", "more than two cameras")):
        assign_cameras(images_in(tmp_path))


def test_folder_without_images_is_reported(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="has no images"):
        images_in(tmp_path)
    with pytest.raises(CairnError, match="cannot be read"):
        images_in(tmp_path / "none")
