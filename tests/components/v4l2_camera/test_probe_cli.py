"""`cairn driver probe camera` tries cameras and reports what they send."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import pytest

from cairn import CairnError
from cairn.components.v4l2_camera import probe_cli
from cairn.components.v4l2_camera.probe_cli import probe
from tests.commands import cairn
from tests.components.v4l2_camera.fake_cameras import (
    HEIGHT,
    LEFT,
    RIGHT,
    WIDTH,
    FakeCameras,
)
from tests.patience import LIMIT_S

IMAGES = 5
"""Images that each camera sends."""


class ImageClock:
    """The time of a probe, which is over once it has received a number of images."""

    def __init__(self, images: int) -> None:
        self._left = images + 1  # it also reads the time before the first one

    def monotonic(self) -> float:
        self._left -= 1
        return 0.0 if self._left >= 0 else LIMIT_S


@pytest.fixture
def pair(cameras: FakeCameras, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cameras whose images the probe receives, however long that takes."""
    now = time.monotonic_ns()
    for camera in [cameras.add(path) for path in (LEFT, RIGHT)]:
        for number in range(IMAGES):
            camera.send(99, captured=now - 40_000_000 * (IMAGES - number))
    monkeypatch.setattr(probe_cli, "time", ImageClock(2 * IMAGES))


@pytest.mark.usefixtures("pair")
def test_probe_of_a_pair_saves_its_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "it.png"

    probe(LEFT, right=RIGHT, seconds=LIMIT_S, width=WIDTH, height=HEIGHT, format_="GREY", out=out)

    values = capsys.readouterr().out
    assert "/dev/left: Fake usb-1\n  GREY 64 x 48, " in values
    assert "negotiated 25" in values
    assert "pairs, " in values
    for file in (out, tmp_path / "it_right.png"):
        saved = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert saved is not None
        assert saved.shape == (HEIGHT, WIDTH)
        assert (saved == 99).all()


def test_camera_without_images_is_an_error(
    cameras: FakeCameras, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras.add(LEFT)

    with pytest.raises(CairnError, match="not every camera sent an image"):
        probe(LEFT, seconds=0.5, width=WIDTH, height=HEIGHT)

    assert "0 images" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("video0",), "device = 'video0' does not name a camera"),
        (("--right", LEFT), "name the left one first"),
        ((LEFT, "--json"), "--json works for the list only"),
        ((LEFT, "--format", "H264"), "format should be 'auto', 'GREY', 'YUYV' or 'MJPG'"),
    ],
)
def test_wrong_arguments_are_rejected(arguments: tuple[str, ...], message: str) -> None:
    answer = cairn("driver", "probe", "camera", *arguments)

    assert answer.code == 1
    assert message in answer.err
