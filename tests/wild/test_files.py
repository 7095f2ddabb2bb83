"""Maps, calibrations, robot descriptions, logs and zones of other programs; see README.md."""

from __future__ import annotations

import json
import math
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cairn.components.replay_devices.image_recording import holds_images
from cairn.components.replay_devices.open_recording import open_recording
from cairn.errors import CairnError
from cairn.limits.images import decode_image
from cairn.planar.grid import FREE, OCCUPIED
from cairn.planar.map_file import read_map
from cairn.planar.zones import zones_in
from cairn.tf.urdf import read_urdf
from cairn.vision.camera_file import read_camera
from cairn.vision.image_files import images_in

RING = [[0, 0], [2, 0], [2, 1], [0, 1], [0, 0]]


def urdf(joint: str, name: str = "laser") -> str:
    return f"""<robot name="r"><link name="base_link"/><link name="{name}"/>
<joint name="j" type="fixed">{joint}<child link="{name}"/></joint></robot>"""


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (urdf('<parent link="base_link"/>', "${prefix}laser"), r"expand it: `xacro FILE"),
        ('<robot name="r"><xacro:base/></robot>', r"it is a xacro file \(<xacro:base>\)"),
        (
            urdf('<parent link="base_link"/><origin xyz="0 0 0" quat="0 0 1 0"/>'),
            "its origin has quat; give its rotation as rpy",
        ),
        (
            urdf('<parent link="base_link"/><origin rpy="0 0 90"/>'),
            "an angle of more than a turn; give it in radians",
        ),
        (urdf(""), "joint j has no parent; add <parent link=...>"),
    ],
    ids=["name of xacro", "element of xacro", "quaternion", "degrees", "no parent"],
)
def test_robot_description_that_would_mislead_is_rejected(text: str, fault: str) -> None:
    with pytest.raises(CairnError, match=fault):
        read_urdf(text)


def map_of(folder: Path, image: bytes, **keys: str) -> Path:
    (folder / "m.png").write_bytes(image)
    values = {
        "image": "m.png", "resolution": "0.05", "origin": "[0, 0, 0]", "negate": "0",
        "occupied_thresh": "0.65", "free_thresh": "0.196",
    } | keys  # fmt: skip
    file = folder / "map.yaml"
    file.write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    return file


def png(pixels: Any) -> bytes:
    written = BytesIO()
    Image.fromarray(np.array(pixels, np.uint8)).save(written, "PNG")
    return written.getvalue()


def test_map_may_have_an_origin_as_python_prints_it(tmp_path: Path) -> None:
    file = map_of(tmp_path, png([[254, 0]]), origin="(-1.0, 2.0, 0.5)")

    assert read_map(file).frame.origin == (-1.0, 2.0, 0.5)
    for origin in ("[1, 2]", "{x: 1}", "(1, b, c)"):
        with pytest.raises(CairnError, match=r"origin = .*(must be \[x, y, yaw\]|could not)"):
            read_map(map_of(tmp_path, png([[0]]), origin=origin))


def test_transparent_pixels_of_a_map_are_mentioned(tmp_path: Path) -> None:
    notes: list[str] = []
    file = map_of(tmp_path, png([[[0, 0, 0, 255], [0, 0, 0, 0]]]))

    assert read_map(file, notes.append).values.tolist() == [[OCCUPIED, OCCUPIED]]
    assert "50% of the pixels are transparent" in notes[0]


@pytest.mark.parametrize(
    "head", [b"P5\r\n2 2\r\n255\r\n", b"P5\n# saver\r2 2\n255\n"], ids=["CRLF", "CR"]
)
def test_image_with_the_line_ends_of_other_systems_is_not_shifted(head: bytes) -> None:
    _, pixels = decode_image("map.pgm", head + bytes([254, 0, 205, 10]))

    assert pixels.tolist() == [[254, 0], [205, 10]]


def test_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"pointer of Git LFS .*`git lfs pull`"):
        read_map(map_of(tmp_path, b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n"))


def test_calibration_of_opencv_is_read(tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 5.e+02, 0., 320., 0., 5.e+02, 240., 0., 0., 1. ]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
        "   data: [ -1.e-01, 1.e-02, 0., 0., 0. ]\n"
    )

    info = read_camera(file)

    assert (info.width, info.k[0], info.d[0]) == (640, 500.0, -0.1)


def test_calibration_as_a_message_is_read(tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(
        "height: 480\nwidth: 640\ndistortion_model: equidistant\nd: [0.1, 0, 0, 0]\n"
        "k: [500, 0, 320, 0, 500, 240, 0, 0, 1]\nr: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
        "p: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0]\n"
    )

    info = read_camera(file)

    assert (info.distortion_model, info.height, info.p[0]) == ("equidistant", 480, 500.0)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("cam0:\n  camera_model: pinhole\n", "is a camchain of Kalibr"),
        ("# oST version 5.0 parameters\n\n[image]\n\nwidth\n640\n", "give the ost.yaml"),
    ],
)
def test_calibration_of_another_format_is_named(tmp_path: Path, text: str, fault: str) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(text)

    with pytest.raises(CairnError, match=fault):
        read_camera(file)


def carmen(path: Path, step: str, ranges: str, head: bytes = b"") -> Path:
    lines = [
        f"ROBOTLASER1 0 -1.570796 3.141593 {step} 8.0 0.01 0 5 {ranges} 0 {k} 0 0 {k} 0 0 "
        f"0.5 0 0 0 0 {k}.0 host {k}.0"
        for k in range(5)
    ]
    path.write_bytes(head + "\n".join(lines).encode())
    return path


def test_carmen_log_with_the_number_of_steps_and_ranges_of_inf_is_read(tmp_path: Path) -> None:
    log = carmen(tmp_path / "run.log", "4.0", "1.0 inf nan 2.0 9.0", b"\xef\xbb\xbf")

    scans = open_recording(log).scans()

    assert scans is not None
    first = scans.messages[0]
    assert first.angle_increment == pytest.approx(math.pi / 4)
    assert first.ranges.tolist() == pytest.approx(
        [1.0, math.inf, math.nan, 2.0, math.inf], nan_ok=True
    )


def test_hidden_notes_of_macos_are_no_images(tmp_path: Path) -> None:
    for name in ("._f1.png", "f1.png"):
        (tmp_path / name).write_bytes(b"\0\5\x16\7")

    assert [file.name for file in images_in(tmp_path)] == ["f1.png"]
    (tmp_path / "f1.png").unlink()
    assert not holds_images(tmp_path)


def collection(geometry: dict[str, Any], **members: Any) -> bytes:
    feature = {
        "type": "Feature", "id": 1, "bbox": [0, 0, 2, 1], "geometry": geometry,
        "properties": {"zone": "keepout", "name": "stairs"},
    }  # fmt: skip
    return json.dumps({"type": "FeatureCollection", "features": [feature]} | members).encode()


@pytest.mark.parametrize(
    "geometry",
    [
        {"type": "Polygon", "coordinates": [RING], "bbox": [0, 0, 2, 1]},
        {"type": "Polygon", "coordinates": [[[x, y, 0.0] for x, y in RING]]},
        {"type": "MultiPolygon", "coordinates": [[RING]]},
    ],
    ids=["bbox", "heights", "one part"],
)
def test_zones_as_programs_of_maps_write_them_are_read(geometry: dict[str, Any]) -> None:
    (plain,) = zones_in(collection({"type": "Polygon", "coordinates": [RING]}))

    data = b"\xef\xbb\xbf" + collection(geometry, name="zones", bbox=[0, 0, 2, 1])

    assert zones_in(data) == (plain,)


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (
            collection({"type": "Polygon", "coordinates": [RING]}, crs={}),
            "coordinates of|of the ea",
        ),
        (collection({"type": "MultiPolygon", "coordinates": [[RING], [RING]]}), "several parts"),
        (collection({"type": "Polygon", "coordinates": [[[0, 0, 1]]]}), "has the height 1"),
    ],
)
def test_zones_that_mean_something_else_are_rejected(data: bytes, fault: str) -> None:
    with pytest.raises(CairnError, match=fault):
        zones_in(data)


def test_map_of_free_cells_stays_as_it_is(tmp_path: Path) -> None:
    assert read_map(map_of(tmp_path, png([[254, 0]]))).values.tolist() == [[FREE, OCCUPIED]]
