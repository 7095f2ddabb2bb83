"""`cairn camera calibrate` calibrates one camera or two; `cairn camera show` shows the result."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.commands import Answer, cairn
from vision.camera_file import read_camera
from vision.stereo import StereoRig

IMAGES = Path(__file__).parents[2] / "data" / "calibration"
NUMBERS = ("01", "03", "05", "09", "12")


def calibrate(
    *images: str | Path, out: Path, board: str = "9x6", more: tuple[str, ...] = ()
) -> Answer:
    return cairn(
        "camera", "calibrate", *map(str, images), "--board", board, "--square", "0.025",
        "--out", str(out), *more,
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with five pairs."""
    folder = tmp_path / "images"
    folder.mkdir()
    for side in ("left", "right"):
        for number in NUMBERS:
            shutil.copy(IMAGES / f"{side}{number}.jpg", folder)
    return folder


def test_one_camera_is_calibrated_and_written(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    answer = calibrate(*sorted(folder.glob("left*")), out=out)

    assert answer.code == 0
    assert "camera: error 0.1" in answer.out
    assert f"{folder / 'left03.jpg'}" in answer.out
    assert f"{out / 'camera.yaml'}, {out / 'calibration.png'} written" in answer.err
    info = read_camera(out / "camera.yaml")
    assert info.k[0] == pytest.approx(534.8, rel=0.01)
    with Image.open(out / "calibration.png") as picture:
        assert picture.size == (1500, 460)


@pytest.mark.parametrize("way", ["folder", "names", "options"])
def test_two_cameras_are_calibrated_as_a_pair(folder: Path, tmp_path: Path, way: str) -> None:
    out = tmp_path / "out"
    left, right = f"{folder}/left*.jpg", f"{folder}/right*.jpg"
    ways: dict[str, list[str | Path]] = {
        "folder": [folder],
        "names": [*sorted(folder.iterdir())],
        "options": ["--left", left, "--right", right],
    }

    told = calibrate(*ways[way], out=out, more=("--json",)).json

    assert told["pair"]["rms_px"] <= 0.25
    assert told["pair"]["baseline_m"] == pytest.approx(0.0832, rel=0.02)
    assert len(told["pair"]["errors_px"]) == len(NUMBERS)
    assert {name for name, of in told["cameras"].items() if of["rms_px"] <= 0.25} == {
        "left",
        "right",
    }
    assert told["files"][:2] == [str(out / "left.yaml"), str(out / "right.yaml")]
    rig = StereoRig.of(read_camera(out / "left.yaml"), read_camera(out / "right.yaml"))
    assert rig.baseline == pytest.approx(told["pair"]["baseline_m"])


def test_files_of_a_pair_may_have_one_name_in_folders_of_any_name(
    folder: Path, tmp_path: Path
) -> None:
    for side, other in (("left", "cam0"), ("right", "cam1")):
        (tmp_path / other).mkdir()
        for file in folder.glob(f"{side}*"):
            shutil.copy(file, tmp_path / other / file.name.removeprefix(side))

    answer = calibrate(
        "--left", tmp_path / "cam0", "--right", tmp_path / "cam1", out=tmp_path / "out"
    )

    assert answer.code == 0
    assert "pair: error 0." in answer.out


@pytest.mark.parametrize("kind", ["names", "folders"])
def test_numbers_of_cameras_tell_them_apart_as_well(
    folder: Path, tmp_path: Path, kind: str
) -> None:
    numbered = tmp_path / "numbered"
    for side, camera in (("left", "cam0"), ("right", "cam1")):
        for file in folder.glob(f"{side}*"):
            number = file.name.removeprefix(side)
            to = numbered / (f"{camera}_{number}" if kind == "names" else f"{camera}/{number}")
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, to)

    told = calibrate(numbered, out=tmp_path / "out", more=("--json",)).json

    assert told["pair"]["baseline_m"] == pytest.approx(0.0832, rel=0.02)
    assert len(told["pair"]["errors_px"]) == len(NUMBERS)


@pytest.mark.parametrize(
    ("out", "told"),
    [
        ("file", "--out {out}: {out} is a file, not a folder"),
        ("file/calibration", "--out {out}: {folder}/file is a file, not a folder"),
        ("/proc/calibration", "/proc/calibration cannot be made: No such file or directory"),
    ],
)
def test_where_nothing_can_be_written_is_told(
    folder: Path, tmp_path: Path, out: str, told: str
) -> None:
    (tmp_path / "file").touch()
    to = tmp_path / out

    answer = calibrate(*sorted(folder.glob("left*")), out=to)

    assert answer.code == 1
    assert told.format(out=to, folder=tmp_path) in answer.err
    assert answer.out == ""


def test_an_image_without_the_board_and_one_without_its_other_are_named(
    folder: Path, tmp_path: Path
) -> None:
    cv2.imwrite(str(folder / "right03.jpg"), np.full((480, 640), 90, np.uint8))
    (folder / "right09.jpg").unlink()

    told = calibrate(folder, out=tmp_path / "out", more=("--json",)).json

    assert told["without_board"] == [str(folder / "right03.jpg")]
    assert (
        f"{folder / 'right03.jpg'}: the board is not seen whole, image left out" in told["remarks"]
    )
    assert f"{folder / 'left09.jpg'}: there is no other image of this pair" in told["remarks"]
    assert len(told["pair"]["errors_px"]) == 3
    assert len(told["cameras"]["left"]["errors_px"]) == 5


def test_images_from_one_viewpoint_are_refused(tmp_path: Path) -> None:
    for number in range(3):
        shutil.copy(IMAGES / "left01.jpg", tmp_path / f"{number}.jpg")

    answer = calibrate(tmp_path, out=tmp_path / "out")

    assert answer.code == 1
    assert "turned by 0 deg at most between images: such images do not tell" in answer.err
    assert not (tmp_path / "out").exists()


def test_a_calibration_is_not_replaced_unasked(folder: Path, tmp_path: Path) -> None:
    assert calibrate(folder, out=tmp_path).code == 0

    assert (
        "left.yaml exists already. Give another --out, or --force"
        in calibrate(folder, out=tmp_path).err
    )
    assert calibrate(folder, out=tmp_path, more=("--force",)).code == 0


@pytest.mark.parametrize(
    ("board", "told"),
    [
        (
            "10x7",
            "a board of 10x7 inner corners is seen in 0 of 5 images, not in .*; one of 9x6 was",
        ),
        ("8x6", "the board has more than 8x6 inner corners: one of 9x6 was found"),
        ("nine", "--board nine: write it as COLUMNSxROWS"),
        ("2x9", "--board 2x9: a board has 3 to 100 inner corners each way"),
    ],
)
def test_a_wrong_board_is_told(folder: Path, tmp_path: Path, board: str, told: str) -> None:
    answer = calibrate(*folder.glob("left*"), out=tmp_path / "out", board=board)

    assert answer.code == 1
    assert re.search(told, answer.err)
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_calibrated_is_refused_in_a_sentence(folder: Path, tmp_path: Path) -> None:
    left = sorted(folder.glob("left*"))
    small, text = tmp_path / "small.png", tmp_path / "text.png"
    cv2.imwrite(str(small), np.zeros((240, 320), np.uint8))
    text.write_text("no image")
    out = tmp_path / "out"

    for images, told in (
        (left[:2], "2 images of a camera: a calibration needs 3 at least"),
        ([], "no images are given"),
        ([*left, small], f"{small} is 320 x 240 pixels, other images are 640 x 480"),
        ([*left, text], f"{text} is no image, or a truncated one"),
        ([*left, tmp_path / "none.jpg"], "none.jpg: no such file or folder"),
        ([f"{tmp_path}/none*.jpg"], "no file has such a name"),
        (["--left", folder], "--left is given without the other"),
        (
            [folder, "--left", tmp_path / "small.png", "--right", small, small],
            "small.png has neither left nor right",
        ),
        (
            ["--left", f"{folder}/right*", "--right", f"{folder}/left*"],
            "left and right are swapped",
        ),
    ):
        answer = calibrate(*images, out=out)
        assert answer.code != 0
        assert told in answer.err
        assert not out.exists()


def test_a_calibration_is_shown(folder: Path, tmp_path: Path) -> None:
    calibrate(folder, out=tmp_path)
    left, right = tmp_path / "left.yaml", tmp_path / "right.yaml"

    shown = cairn("camera", "show", str(left), str(right))
    told = cairn("camera", "show", str(left), "--json").json

    assert "a stereo pair with a baseline of 0.083" in shown.out
    assert told[str(left)]["view_deg"][0] == pytest.approx(63, abs=5)
    assert "left and right are swapped" in cairn("camera", "show", str(right), str(left)).err


def test_pairs_that_are_mixed_up_are_no_calibration(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for number, other in zip(NUMBERS, (*NUMBERS[1:], NUMBERS[0]), strict=True):
        shutil.copy(IMAGES / f"left{number}.jpg", folder)
        shutil.copy(IMAGES / f"right{other}.jpg", folder / f"right{number}.jpg")

    answer = calibrate(folder, out=tmp_path / "out")

    assert answer.code == 1
    assert "px of the pairs is no calibration" in answer.err
    assert "taken at the same moment" in answer.err
    assert not (tmp_path / "out").exists()


def test_a_camera_is_no_stereo_pair_with_itself(folder: Path, tmp_path: Path) -> None:
    calibrate(*sorted(folder.glob("left*")), out=tmp_path / "out")
    same = str(tmp_path / "out" / "camera.yaml")

    assert "no baseline" in cairn("camera", "show", same, same).err
