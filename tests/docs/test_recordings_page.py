"""The commands of docs/how-to/recordings.md print what the page shows, and its Python code runs."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import from_ns
from cairn.planar.messages import pose_message
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.geometry_msgs import PoseStamped, PoseWithCovariance
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.schemas.sensor_msgs import Image
from cairn.schemas.std_msgs import Header
from tests.cairn.recording.recordings import BEGIN, SECOND, Sent, write_recording
from tests.commands import cairn

PAGE = "docs/how-to/recordings.md"


def drive() -> list[Sent]:
    sent = [Sent("/robot/map", 0, OccupancyGrid(), "/robot/map_builder", latched=True)]
    for k in range(60):
        at = k * SECOND // 10
        header = Header(stamp=from_ns(BEGIN + at), frame_id="map")
        pose = pose_message((math.sin(0.1 * k), 0.0, 0.0))
        estimate = LocalizationEstimate(
            header=header, located=k > 0, pose=PoseWithCovariance(pose=pose)
        )
        sent.append(Sent("/robot/truth", at, PoseStamped(header=header, pose=pose), "/robot/world"))
        sent.append(Sent("/robot/localization", at + 1, estimate, "/robot/localizer"))
        if k % 20 == 0:
            image = Image(
                header=header, height=16, width=16, encoding="mono8", step=16,
                data=np.zeros(256, np.uint8),
            )  # fmt: skip
            sent.append(Sent("/robot/left_image", at + 2, image, "/robot/camera"))
    return sent


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_recording(tmp_path / "run.mcap", drive(), chunk_size=1 << 20)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_commands_of_the_page_print_what_it_shows(
    folder: Path, page_blocks: Callable[[str], Any]
) -> None:
    shown = "".join(block.text for block in page_blocks(PAGE) if block.language == "console")
    printed = ""
    for line in shown.splitlines():
        if line.startswith("$ "):
            answer = cairn(*line.removeprefix("$ cairn ").split())
            assert answer.code == 0, answer.err
            printed += f"{line}\n{answer.out}"

    assert printed == shown


def test_python_code_of_the_page_runs(
    folder: Path, page_blocks: Callable[[str], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = [block.text for block in page_blocks(PAGE) if block.language == "python"]
    names: dict[str, Any] = {}

    exec(compile(code, PAGE, "exec"), names)

    assert len(capsys.readouterr().out.splitlines()) == 60
    assert [message.channel.topic for message in names["state"]] == ["/robot/map"]
