"""Tests of calibration files in the format of ROS."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from cairn import CairnError
from cairn.vision.camera_file import read_camera, write_camera
from tests.cairn.vision.cameras import info

# As camera_calibration writes it.
OF_ROS = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [438.78356, 0.0, 305.58871, 0.0, 437.30283, 243.73861, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.36161, 0.11653, 0.00102, -0.00039, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.65304, 0, 322.79767, 0, 0, 393.65304, 241.09085, 0, 0, 0, 1, 0]
"""


def test_written_calibration_is_read_back(tmp_path: Path) -> None:
    file = tmp_path / "right.yaml"
    known = info("right", d=np.array([-0.1, 1e-7, 0.1 + 0.2, 0.0, 0.0]))

    write_camera(file, known, "right")

    assert read_camera(file, "right_camera_optical_frame") == known
    keys = list(yaml.safe_load(file.read_text()))
    assert keys == list(yaml.safe_load(OF_ROS))


def test_file_written_by_ros_is_read(tmp_path: Path) -> None:
    file = tmp_path / "left.yaml"
    file.write_text(OF_ROS)

    camera = read_camera(file, "left_camera_optical_frame")

    assert (camera.width, camera.height, camera.distortion_model) == (640, 480, "plumb_bob")
    assert camera.header.frame_id == "left_camera_optical_frame"
    assert camera.k[0] == 438.78356
    assert camera.d.tolist() == [-0.36161, 0.11653, 0.00102, -0.00039, 0.0]
    assert camera.p[2] == 322.79767


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("image_width: 640\n", "", "image_width: field required"),
        ("image_width: 640", "image_width: -3", "image_width = -3"),
        ("image_width: 640", "image_width: wide", "image_width = wide"),
        (
            "-0.00039, 0.0]",
            "-0.00039]",
            r"distortion_coefficients.*rows \* cols = 5 numbers, not 4",
        ),
        ("243.73861, 0.0, 0.0, 1.0", "243.73861, .nan, 0.0, 1.0", "camera_matrix.data.6 = nan"),
        ("438.78356", "0.0", "k = .* focal lengths must be above 0"),
        ("plumb_bob", "bobbed", "distortion_model = 'bobbed' is not supported"),
        ("[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[2, 0, 0, 0, 1, 0, 0, 0, 1]", "r = .* is not a rotation"),
        (
            "rows: 3\n  cols: 4",
            "rows: 4\n  cols: 3",
            "projection_matrix is 4 x 3, but must be 3 x 4",
        ),
        ("camera_matrix:", "camera_matrix: [", "not a calibration in YAML"),
    ],
)
def test_damaged_file_is_rejected_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = tmp_path / "left.yaml"
    assert old in OF_ROS
    file.write_text(OF_ROS.replace(old, new))

    with pytest.raises(CairnError, match=rf"left.yaml(:\d+:\d+)?: .*{message}".replace("\n", "")):
        read_camera(file)


def test_missing_or_empty_file_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"no such calibration file; .*`cairn camera calibrate`"):
        read_camera(tmp_path / "none.yaml")
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(CairnError, match="it has no keys"):
        read_camera(tmp_path / "empty.yaml")


def test_unwritable_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"nowhere.*: the calibration cannot be written"):
        write_camera(tmp_path / "nowhere" / "left.yaml", info(), "left")
