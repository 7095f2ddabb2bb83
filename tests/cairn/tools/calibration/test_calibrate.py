"""Tests of `cairn camera calibrate` and `cairn camera show`."""

import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from cairn import CairnError
from cairn.tools.calibration import images as calibration_images
from cairn.tools.calibration import plot
from cairn.tools.calibration.images import BoardCorners, CalibrationImages, find_images
from cairn.tools.calibration.result import calibrate_cameras
from cairn.vision.camera_file import read_camera
from cairn.vision.chessboard import Board
from cairn.vision.image_files import pair_files
from cairn.vision.stereo import StereoRig
from tests.commands import Answer, cairn
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = pytest.mark.images


IMAGES = Path(__file__).parents[3] / "data" / "calibration"
NUMBERS = ("01", "03", "05", "09", "12")
FEW = NUMBERS[:3]


class CachedSearch:
    """Caches what a search for boards finds: most tests show the same ten photographs."""

    def __init__(self, search: Callable[..., Any]) -> None:
        self._search = search
        self._known: dict[Any, Any] = {}

    def __call__(self, images: Any, board: Board, **how: bool) -> Any:
        """Return the same as the search, from the cache if it knows the images."""
        shown = images if isinstance(images, list) else [images]
        key = (board, *how.items(), *((one.shape, one.tobytes()) for one in shown))
        if key not in self._known:
            self._known[key] = self._search(images, board, **how)
        found = self._known[key]
        return found.copy() if isinstance(found, np.ndarray) else found


@pytest.fixture(autouse=True, scope="module")
def searched_once() -> Iterator[None]:
    """Search each image once: otherwise the search would dominate these tests.

    The search itself is tested in tests/cairn/vision.
    """
    with pytest.MonkeyPatch.context() as patched:
        for name in ("find_corners", "find_other_board"):
            search = CachedSearch(getattr(calibration_images, name))
            patched.setattr(calibration_images, name, search)
        yield


def calibrate(
    *images: str | Path, out: Path, board: str = "9x6", more: tuple[str, ...] = ()
) -> Answer:
    return cairn(
        "camera", "calibrate", *map(str, images), "--board", board, "--square", "0.025",
        "--out", str(out), *more,
    )  # fmt: skip


def pairs(folder: Path, numbers: Iterable[str]) -> Path:
    """Make a folder with these pairs."""
    folder.mkdir()
    for side in ("left", "right"):
        for number in numbers:
            shutil.copy(IMAGES / f"{side}{number}.jpg", folder)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with five pairs."""
    return pairs(tmp_path / "images", NUMBERS)


@pytest.fixture
def few(tmp_path: Path) -> Path:
    """Return a folder with the fewest pairs of a calibration."""
    return pairs(tmp_path / "few", FEW)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the result of five pairs; tests must not change it."""
    folder = tmp_path_factory.mktemp("calibrated")
    answer = calibrate(pairs(folder / "images", NUMBERS), out=folder / "out", more=("--json",))
    (folder / "result.json").write_text(answer.out, encoding="utf-8")
    return folder


@pytest.fixture
def without_plot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the plot, which takes longer than the calibration."""
    monkeypatch.setattr(plot, "plot_calibration", lambda *_: None)


@pytest.mark.accuracy
def test_single_camera_is_calibrated(folder: Path, tmp_path: Path) -> None:
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
    result = json.loads((calibrated / "result.json").read_text(encoding="utf-8"))

    out = calibrated / "out"
    assert result["pair"]["rms_px"] <= 0.25
    assert result["pair"]["baseline_m"] == pytest.approx(0.0832, rel=0.02)
    assert len(result["pair"]["errors_px"]) == len(NUMBERS)
    assert {name for name, of in result["cameras"].items() if of["rms_px"] <= 0.25} == {
        "left",
        "right",
    }
    assert result["files"][:2] == [str(out / "left.yaml"), str(out / "right.yaml")]
    rig = StereoRig.of(read_camera(out / "left.yaml"), read_camera(out / "right.yaml"))
    assert rig.baseline == pytest.approx(result["pair"]["baseline_m"])


def as_folder(images: Path) -> CalibrationImages:
    return find_images([str(images)], [], [])


def as_files(images: Path) -> CalibrationImages:
    return find_images([str(file) for file in sorted(images.iterdir())], [], [])


def as_options(images: Path) -> CalibrationImages:
    return find_images([], [f"{images}/left*.jpg"], [f"{images}/right*.jpg"])


def as_folders_of_any_name(images: Path) -> CalibrationImages:
    for side, other in (("left", "a"), ("right", "b")):
        (images / other).mkdir()
        for file in images.glob(f"{side}*"):
            file.rename(images / other / file.name.removeprefix(side))
    return find_images([], [str(images / "a")], [str(images / "b")])


def as_numbered_cameras(images: Path) -> CalibrationImages:
    for side, camera in (("left", "cam0"), ("right", "cam1")):
        for file in images.glob(f"{side}*"):
            file.rename(images / f"{camera}_{file.name.removeprefix(side)}")
    return find_images([str(images)], [], [])


def as_folders_of_numbered_cameras(images: Path) -> CalibrationImages:
    for side, camera in (("left", "cam0"), ("right", "cam1")):
        (images / camera).mkdir()
        for file in images.glob(f"{side}*"):
            file.rename(images / camera / file.name.removeprefix(side))
    return find_images([str(images)], [], [])


@pytest.mark.parametrize(
    "arrange",
    [
        as_folder,
        as_files,
        as_options,
        as_folders_of_any_name,
        as_numbered_cameras,
        as_folders_of_numbered_cameras,
    ],
)
def test_images_of_a_pair_are_found_by_all_naming_schemes(
    few: Path, arrange: Callable[[Path], CalibrationImages]
) -> None:
    given = arrange(few)
    found = pair_files(given.left, given.right)

    assert [(a.read_bytes(), b.read_bytes()) for a, b in found.pairs] == [
        ((IMAGES / f"left{number}.jpg").read_bytes(), (IMAGES / f"right{number}.jpg").read_bytes())
        for number in FEW
    ]
    assert not found.unpaired


@pytest.mark.parametrize(
    ("out", "result"),
    [
        ("file", "--out {out}: {out} is a file, not a folder"),
        ("file/calibration", "--out {out}: {folder}/file is a file, not a folder"),
        ("/proc/calibration", "/proc/calibration cannot be made: No such file or directory"),
    ],
)
def test_unwritable_output_folder_is_reported(
    few: Path, tmp_path: Path, out: str, result: str
) -> None:
    (tmp_path / "file").touch()
    to = tmp_path / out

    answer = calibrate(*sorted(few.glob("left*")), out=to)

    assert answer.code == 1
    assert result.format(out=to, folder=tmp_path) in answer.err
    assert answer.out == ""


@pytest.mark.usefixtures("without_plot")
def test_images_without_board_or_counterpart_are_reported(folder: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(folder / "right03.jpg"), np.full((480, 640), 90, np.uint8))
    (folder / "right09.jpg").unlink()

    result = calibrate(folder, out=tmp_path / "out", more=("--json",)).json

    assert result["without_board"] == [str(folder / "right03.jpg")]
    assert (
        f"{folder / 'right03.jpg'}: the whole board is not visible, image excluded"
        in result["remarks"]
    )
    assert f"{folder / 'left09.jpg'}: the other image of this pair is missing" in result["remarks"]
    assert len(result["pair"]["errors_px"]) == 3
    assert len(result["cameras"]["left"]["errors_px"]) == 5


def test_images_from_one_viewpoint_are_rejected(tmp_path: Path) -> None:
    for number in range(3):
        shutil.copy(IMAGES / "left01.jpg", tmp_path / f"{number}.jpg")

    answer = calibrate(tmp_path, out=tmp_path / "out")

    assert answer.code == 1
    assert_words(answer.err, "rotated", "0 deg")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("without_plot")
def test_existing_calibration_is_replaced_only_with_force(
    calibrated: Path, few: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(calibrated / "out", out)
    shutil.copy(out / "left.yaml", out / "camera.yaml")
    before = (out / "left.yaml").read_bytes()
    camera = sorted(few.glob("left*"))

    answer = calibrate(few, out=out)
    assert_words(answer.err, "left.yaml", "--out", "--force")
    assert (out / "left.yaml").read_bytes() == before
    assert "camera.yaml exists already" in calibrate(*camera, out=out).err
    assert (out / "camera.yaml").read_bytes() == before

    assert calibrate(*camera, out=out, more=("--force",)).code == 0
    assert (out / "camera.yaml").read_bytes() != before
    assert (out / "left.yaml").read_bytes() == before
    sides = ("--left", f"{few}/left*", "--right", f"{few}/right*")
    assert calibrate(*sides, out=out, more=("--force",)).code == 0
    assert (out / "left.yaml").read_bytes() != before


@pytest.mark.accuracy
def test_smaller_board_than_stated_is_reported(tmp_path: Path) -> None:
    same = [Path(shutil.copy(IMAGES / "left01.jpg", tmp_path / f"{n}.jpg")) for n in range(3)]

    answer = calibrate(*same, out=tmp_path / "out", board="10x6")

    assert answer.code == 1
    assert re.search(
        "a board of 10x6 inner corners was found in 0 of 3 images, not in .*; a board of 9x6 was",
        answer.err,
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("board", "result"),
    sampled(
        [
            ("8x6", "the board has more than 8x6 inner corners: one of 9x6 was found"),
            ("nine", "--board nine: write it as COLUMNSxROWS"),
            ("2x9", "--board 2x9: a board has 3 to 100 inner corners each way"),
        ]
    ),
)
def test_wrong_board_is_reported(folder: Path, tmp_path: Path, board: str, result: str) -> None:
    answer = calibrate(*folder.glob("left*"), out=tmp_path / "out", board=board)

    assert answer.code == 1
    assert result in answer.err
    assert not (tmp_path / "out").exists()


def test_unusable_inputs_are_rejected_with_reason(few: Path, tmp_path: Path) -> None:
    left = sorted(few.glob("left*"))
    small, text = tmp_path / "small.png", tmp_path / "text.png"
    cv2.imwrite(str(small), np.zeros((240, 320), np.uint8))
    text.write_text("no image")
    out = tmp_path / "out"

    for images, result in (
        (left[:2], "2 images of a camera; a calibration needs at least 3"),
        ([], "no images are given"),
        ([*left, small], f"{small} is 320 x 240 pixels, other images are 640 x 480"),
        ([*left, text], f"{text}: not an image of a known format"),
        ([*left, tmp_path / "none.jpg"], "none.jpg: no such file or folder"),
        ([f"{tmp_path}/none*.jpg"], "no file matches this pattern"),
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
        assert result in answer.err
        assert not out.exists()


def test_calibration_is_shown(calibrated: Path) -> None:
    left, right = calibrated / "out" / "left.yaml", calibrated / "out" / "right.yaml"

    shown = cairn("camera", "show", str(left), str(right))
    result = cairn("camera", "show", str(left), "--json").json

    assert "a stereo pair with a baseline of 0.083" in shown.out
    assert result[str(left)]["view_deg"][0] == pytest.approx(63, abs=5)
    assert "left and right are swapped" in cairn("camera", "show", str(right), str(left)).err


def test_mixed_up_pairs_are_rejected(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for number, other in zip(NUMBERS, (*NUMBERS[1:], NUMBERS[0]), strict=True):
        shutil.copy(IMAGES / f"left{number}.jpg", folder)
        shutil.copy(IMAGES / f"right{other}.jpg", folder / f"right{number}.jpg")

    answer = calibrate(folder, out=tmp_path / "out")

    assert answer.code == 1
    assert "is too large for a calibration" in answer.err
    assert "taken at the same time" in answer.err
    assert not (tmp_path / "out").exists()


def test_camera_is_not_a_stereo_pair_with_itself(calibrated: Path) -> None:
    same = str(calibrated / "out" / "left.yaml")

    assert "no baseline" in cairn("camera", "show", same, same).err


@pytest.mark.parametrize("right", [(640, 360), (480, 480)])
def test_left_and_right_images_of_different_sizes_are_rejected(right: tuple[int, int]) -> None:
    board = Board(9, 6, 0.025)
    found = [BoardCorners(size, {}, []) for size in ((640, 480), right)]

    with pytest.raises(CairnError, match=rf"640 x 480 .* {right[0]} x {right[1]}"):
        calibrate_cameras(board, found, ([], []))
