"""`cairn camera calibrate` calibrates one camera or two; `cairn camera show` shows the result."""

import json
import re
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from cairn.tools.calibration import cli
from cairn.tools.calibration.given import Given, sorted_out
from cairn.vision.camera_file import read_camera
from cairn.vision.image_files import paired
from cairn.vision.stereo import StereoRig
from tests.commands import Answer, cairn

pytestmark = pytest.mark.images


IMAGES = Path(__file__).parents[3] / "data" / "calibration"
NUMBERS = ("01", "03", "05", "09", "12")
FEW = NUMBERS[:3]


def calibrate(
    *images: str | Path, out: Path, board: str = "9x6", more: tuple[str, ...] = ()
) -> Answer:
    return cairn(
        "camera", "calibrate", *map(str, images), "--board", board, "--square", "0.025",
        "--out", str(out), *more,
    )  # fmt: skip


def pairs(folder: Path, numbers: Iterable[str]) -> Path:
    """The folder, made, with these pairs."""
    folder.mkdir()
    for side in ("left", "right"):
        for number in numbers:
            shutil.copy(IMAGES / f"{side}{number}.jpg", folder)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with five pairs."""
    return pairs(tmp_path / "images", NUMBERS)


@pytest.fixture
def few(tmp_path: Path) -> Path:
    """A folder with no more pairs than a calibration needs."""
    return pairs(tmp_path / "few", FEW)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What was written of five pairs, to be read only."""
    folder = tmp_path_factory.mktemp("calibrated")
    answer = calibrate(pairs(folder / "images", NUMBERS), out=folder / "out", more=("--json",))
    (folder / "told.json").write_text(answer.out, encoding="utf-8")
    return folder


@pytest.fixture
def without_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the picture is not the point: to draw it takes longer than to calibrate."""
    monkeypatch.setattr(cli, "draw_calibration", lambda *_: None)


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


def test_two_cameras_are_calibrated_as_a_pair(calibrated: Path) -> None:
    told = json.loads((calibrated / "told.json").read_text(encoding="utf-8"))

    out = calibrated / "out"
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


def as_folder(images: Path) -> Given:
    return sorted_out([str(images)], [], [])


def as_files(images: Path) -> Given:
    return sorted_out([str(file) for file in sorted(images.iterdir())], [], [])


def as_options(images: Path) -> Given:
    return sorted_out([], [f"{images}/left*.jpg"], [f"{images}/right*.jpg"])


def as_folders_of_any_name(images: Path) -> Given:
    for side, other in (("left", "a"), ("right", "b")):
        (images / other).mkdir()
        for file in images.glob(f"{side}*"):
            file.rename(images / other / file.name.removeprefix(side))
    return sorted_out([], [str(images / "a")], [str(images / "b")])


def as_numbered_cameras(images: Path) -> Given:
    for side, camera in (("left", "cam0"), ("right", "cam1")):
        for file in images.glob(f"{side}*"):
            file.rename(images / f"{camera}_{file.name.removeprefix(side)}")
    return sorted_out([str(images)], [], [])


def as_folders_of_numbered_cameras(images: Path) -> Given:
    for side, camera in (("left", "cam0"), ("right", "cam1")):
        (images / camera).mkdir()
        for file in images.glob(f"{side}*"):
            file.rename(images / camera / file.name.removeprefix(side))
    return sorted_out([str(images)], [], [])


@pytest.mark.parametrize(
    "way",
    [
        as_folder,
        as_files,
        as_options,
        as_folders_of_any_name,
        as_numbered_cameras,
        as_folders_of_numbered_cameras,
    ],
)
def test_images_of_a_pair_are_found_however_they_are_named(
    few: Path, way: Callable[[Path], Given]
) -> None:
    given = way(few)
    found = paired(given.left, given.right)

    assert [(a.read_bytes(), b.read_bytes()) for a, b in found.pairs] == [
        ((IMAGES / f"left{number}.jpg").read_bytes(), (IMAGES / f"right{number}.jpg").read_bytes())
        for number in FEW
    ]
    assert not found.alone


@pytest.mark.parametrize(
    ("out", "told"),
    [
        ("file", "--out {out}: {out} is a file, not a folder"),
        ("file/calibration", "--out {out}: {folder}/file is a file, not a folder"),
        ("/proc/calibration", "/proc/calibration cannot be made: No such file or directory"),
    ],
)
def test_where_nothing_can_be_written_is_told(
    few: Path, tmp_path: Path, out: str, told: str
) -> None:
    (tmp_path / "file").touch()
    to = tmp_path / out

    answer = calibrate(*sorted(few.glob("left*")), out=to)

    assert answer.code == 1
    assert told.format(out=to, folder=tmp_path) in answer.err
    assert answer.out == ""


@pytest.mark.usefixtures("without_picture")
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


@pytest.mark.usefixtures("without_picture")
def test_a_calibration_is_not_replaced_unasked(calibrated: Path, few: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(calibrated / "out", out)
    shutil.copy(out / "left.yaml", out / "camera.yaml")
    before = (out / "left.yaml").read_bytes()
    camera = sorted(few.glob("left*"))

    answer = calibrate(few, out=out)
    assert "left.yaml exists already. Give another --out, or --force" in answer.err
    assert (out / "left.yaml").read_bytes() == before
    assert "camera.yaml exists already" in calibrate(*camera, out=out).err
    assert (out / "camera.yaml").read_bytes() == before

    assert calibrate(*camera, out=out, more=("--force",)).code == 0
    assert (out / "camera.yaml").read_bytes() != before
    assert (out / "left.yaml").read_bytes() == before
    sides = ("--left", f"{few}/left*", "--right", f"{few}/right*")
    assert calibrate(*sides, out=out, more=("--force",)).code == 0
    assert (out / "left.yaml").read_bytes() != before


def test_a_board_that_is_smaller_than_told_is_told(few: Path, tmp_path: Path) -> None:
    answer = calibrate(*few.glob("left*"), out=tmp_path / "out", board="10x6")

    assert answer.code == 1
    assert re.search(
        "a board of 10x6 inner corners is seen in 0 of 3 images, not in .*; one of 9x6 was",
        answer.err,
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("board", "told"),
    [
        ("8x6", "the board has more than 8x6 inner corners: one of 9x6 was found"),
        ("nine", "--board nine: write it as COLUMNSxROWS"),
        ("2x9", "--board 2x9: a board has 3 to 100 inner corners each way"),
    ],
)
def test_a_wrong_board_is_told(folder: Path, tmp_path: Path, board: str, told: str) -> None:
    answer = calibrate(*folder.glob("left*"), out=tmp_path / "out", board=board)

    assert answer.code == 1
    assert told in answer.err
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_calibrated_is_refused_in_a_sentence(few: Path, tmp_path: Path) -> None:
    left = sorted(few.glob("left*"))
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
        (["--left", few], "--left is given without the other"),
        (
            [few, "--left", tmp_path / "small.png", "--right", small, small],
            "small.png has neither left nor right",
        ),
        (
            ["--left", f"{few}/right*", "--right", f"{few}/left*"],
            "left and right are swapped",
        ),
    ):
        answer = calibrate(*images, out=out)
        assert answer.code != 0
        assert told in answer.err
        assert not out.exists()


def test_a_calibration_is_shown(calibrated: Path) -> None:
    left, right = calibrated / "out" / "left.yaml", calibrated / "out" / "right.yaml"

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


def test_a_camera_is_no_stereo_pair_with_itself(calibrated: Path) -> None:
    same = str(calibrated / "out" / "left.yaml")

    assert "no baseline" in cairn("camera", "show", same, same).err
