"""Tests of maps that are extended by a recording of another place, or saved over themselves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from cairn import CairnError
from cairn.client import Robot
from cairn.components.slam.graph_file import GraphFile, read_graph, write_graph
from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.quality import quality_of
from cairn.planar.map_file import write_map
from cairn.planar.motion_model import COMMANDED
from cairn.tools.mapping.live import save_map
from tests.commands import cairn
from tests.components.slam.box_room import SECOND, drive
from tests.wording import assert_words

EARLIER = 45  # scans of the map that is extended


@pytest.fixture
def room() -> Mapper:
    """Return the map of a room with a box in it."""
    mapper = Mapper(10.0)
    drive(mapper, 0, EARLIER)
    return mapper


def write_log(path: Path, scans: int) -> None:
    """Write a log of a drive along a wall in the open."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 181)
    ranges = np.minimum(2.0 / np.maximum(np.abs(np.sin(angles)), 1e-3), 60.0)
    text = " ".join(f"{value:.2f}" for value in ranges)
    lines = []
    for k in range(scans):
        pose, end = f"{0.1 * k:.1f} 0 0", f"{1000.0 + 0.2 * k:.1f} host {1000.0 + 0.2 * k:.1f}"
        lines += [f"FLASER 181 {text} {pose} {pose} {end}", f"ODOM {pose} 0.5 0 0 {end}"]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.slow
@pytest.mark.parametrize("scans", [20, 100], ids=["smaller than the map", "larger"])
def test_recording_of_another_place_is_refused(room: Mapper, tmp_path: Path, scans: int) -> None:
    write_graph(tmp_path / "room.graph", room, "a test")
    write_log(tmp_path / "wall.log", scans)

    answer = cairn(
        "map", "build", str(tmp_path / "wall.log"), str(tmp_path / "both"),
        "--extend", str(tmp_path / "room.graph"),
    )  # fmt: skip

    assert answer.code == 1
    assert_words(answer.err, "no place of the map", "is recognized", "--extend")
    assert not list(tmp_path.glob("both.*"))


def test_extended_map_uses_the_uncertainty_of_commanded_odometry(
    room: Mapper, tmp_path: Path
) -> None:
    path = tmp_path / "room.graph"
    write_graph(path, room, "a test")
    certainties = []
    for mapper in (read_graph(path), read_graph(path, COMMANDED)):
        mapper.resume(here=False)
        for k in range(20):
            mapper.add_odometry((1000 + k) * SECOND, (0.1 * k, 0.0, 0.0))
        certainties.append(mapper.graph.edges[-1].information[2, 2])

    assert certainties[1] < 0.5 * certainties[0]


class SlamOfThisComputer:
    """Stands for a robot whose slam has saved its map in a folder."""

    def __init__(self, folder: Path, mapper: Mapper) -> None:
        drawing = MapGrid(0.1, 10.0)
        drawing.update(mapper.keyframes, mapper.graph.poses, mapper.in_map())
        write_map(folder / "map.yaml", drawing.counts.grid())
        self.file = GraphFile.create(folder / "map.graph", 10.0, "a test")
        self.file.save(mapper)
        self._reply = {
            "files": [str(folder / name) for name in ("map.yaml", "map.pgm", "map.graph")],
            "keyframes": len(mapper.keyframes),
            "quality": asdict(quality_of(mapper, drawing)),
        }

    def component_of(self, plugin: str) -> str:
        return plugin

    def request(self, *_: Any, **__: Any) -> dict[str, Any]:
        return self._reply


def test_map_is_not_saved_over_the_files_that_slam_is_writing_to(
    room: Mapper, tmp_path: Path
) -> None:
    slam = SlamOfThisComputer(tmp_path, room)
    robot = cast("Robot", slam)

    with pytest.raises(CairnError, match=r"map.graph is the file .* give another name"):
        save_map(robot, tmp_path / "map", force=True)

    assert save_map(robot, tmp_path / "copy", force=False).quality["keyframes"] == len(
        room.keyframes
    )
    drive(room, EARLIER, EARLIER + 10)
    slam.file.save(room)
    assert len(read_graph(tmp_path / "map.graph").keyframes) == len(room.keyframes)
