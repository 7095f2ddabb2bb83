"""`cairn driver probe camera` tries cameras and tells what comes of them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from cairn import CairnError
from cairn.components.v4l2_camera.cli import probe
from tests.commands import cairn
from tests.components.v4l2_camera.fakes import HEIGHT, LEFT, RIGHT, WIDTH, FakeCamera, FakeCameras


@pytest.fixture
def pair(cameras: FakeCameras) -> Iterator[list[FakeCamera]]:
    """Two cameras that stream."""
    both = [cameras.add(path) for path in (LEFT, RIGHT)]
    over = threading.Event()

    def stream() -> None:
        while not over.wait(0.04):
            now = time.monotonic_ns()
            for camera in both:
                camera.send(99, taken=now)

    thread = threading.Thread(target=stream)
    thread.start()
    yield both
    over.set()
    thread.join()


@pytest.mark.usefixtures("pair")
def test_a_pair_is_tried_and_its_pictures_saved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "it.png"

    probe(LEFT, right=RIGHT, seconds=0.5, width=WIDTH, height=HEIGHT, format_="GREY", out=out)

    told = capsys.readouterr().out
    assert "/dev/left: Fake usb-1\n  GREY 64 x 48, " in told
    assert "the camera agreed to 25" in told
    assert "pairs, " in told
    for file in (out, tmp_path / "it_right.png"):
        saved = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert saved is not None
        assert saved.shape == (HEIGHT, WIDTH)
        assert (saved == 99).all()


def test_a_camera_that_gives_nothing_is_told_of(
    cameras: FakeCameras, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras.add(LEFT)

    with pytest.raises(CairnError, match="no picture came of every camera"):
        probe(LEFT, seconds=0.5, width=WIDTH, height=HEIGHT)

    assert "0 pictures" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("video0",), "device = 'video0' is no name of a camera"),
        (("--right", LEFT), "name the left one first"),
        ((LEFT, "--json"), "--json is for the list"),
        ((LEFT, "--format", "H264"), "format should be 'auto', 'GREY', 'YUYV' or 'MJPG'"),
    ],
)
def test_what_cannot_be_asked_is_refused(arguments: tuple[str, ...], told: str) -> None:
    answer = cairn("driver", "probe", "camera", *arguments)

    assert answer.code == 1
    assert told in answer.err
