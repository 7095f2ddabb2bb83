"""A robot maps a simulated room, works in it while a table is moved, and extends its map."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from cairn.components.slam.graph_file import read_graph
from cairn.components.slam.graph_history import GraphHistory, draw_state, read_log
from cairn.deployment.shipped import FOLDER
from cairn.planar.grid import OCCUPIED, OccupancyCells
from cairn.planar.map_file import read_map
from cairn.testing.lockstep import DeploymentHarness
from tests.commands import cairn

pytestmark = pytest.mark.slow

# In the frame of the map, which is that of the robot at its start: (1, 1) in the room.
ROUND = [[2, 0.2, 0], [5, 0.4, 1.5], [5.6, 3.2, 2], [4.2, 4.6, 3], [2, 4.2, 3.1], [0.5, 2, -1.5],
         [0, 0, 0]]  # fmt: skip
OLD, NEW = (3.4, 2.4), (4.6, 1.6)  # middle of the table


def world_file(
    folder: Path,
    name: str,
    event: dict[str, object] | None = None,
    table: object = None,
    start: dict[str, float] | None = None,
) -> Path:
    world = yaml.safe_load((FOLDER / "worlds" / "room.yaml").read_text("utf-8"))
    world["objects"] = []
    world["robot"].update(start or {})
    for thing in world["furniture"]:
        if thing["name"] == "table" and isinstance(table, dict):
            thing.update(table)
    if event is not None:
        world["events"] = [event]
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(world))
    return file


def run(folder: Path, deployment: str, overlays: list[str], **settings: object) -> None:
    folder.mkdir()
    values = {"report": str(folder), "finish": True, **settings}
    sets = [f"{key}={json.dumps(value)}" for key, value in values.items()]
    with DeploymentHarness(
        FOLDER / f"{deployment}.yaml",
        overlays=[FOLDER / f"{overlay}.yaml" for overlay in overlays],
        sets=sets,
    ) as harness:
        assert harness.run_to_end().normal


def obstacles_near(grid: OccupancyCells, place: tuple[float, float]) -> int:
    """Number of obstacle cells within 0.45 m of a place: those of a table of 1.6 m x 0.8 m."""
    rows, columns = np.nonzero(grid.values == OCCUPIED)
    x, y = grid.frame.origin[0], grid.frame.origin[1]
    size = grid.frame.resolution
    far = np.hypot(x + (columns + 0.5) * size - place[0], y + (rows + 0.5) * size - place[1])
    return int(np.count_nonzero(far < 0.45))


@pytest.mark.accuracy
def test_table_that_is_moved_while_the_robot_works_is_moved_in_its_graph(tmp_path: Path) -> None:
    there = {"x": 5.6, "y": 2.6, "theta": 1.2}
    before = world_file(tmp_path, "before")
    moving = world_file(tmp_path, "moving", {"at": 5.0, "move": "table", "to": there})
    after = world_file(tmp_path, "after", None, there, {"x": 6.5, "y": 4.2, "theta": 2.5})
    run(tmp_path / "map", "mapping", [], world=str(before), mission=ROUND)
    graph, grid = tmp_path / "map" / "map.graph", tmp_path / "map" / "map.yaml"
    assert obstacles_near(read_map(grid), OLD) > 5

    run(
        tmp_path / "work", "sim", ["lifelong"], world=str(moving), mission=ROUND * 3,
        map=str(grid), graph=str(graph), visual_map=None, permanent_s=40,
        start={"x": 0.0, "y": 0.0, "theta": 0.0},
    )  # fmt: skip

    changed = tmp_path / "work" / "map.graph"
    assert read_log(changed).version > 0
    with GraphHistory(changed) as history:
        drawn = draw_state(history.state(), 0.05).grid()
    assert obstacles_near(drawn, OLD) == 0
    assert obstacles_near(drawn, NEW) > 5

    # A robot that stands elsewhere in the changed room finds itself in the graph, and explores.
    run(
        tmp_path / "more", "mapping", [], world=str(after), explore="on_activation",
        extend=str(changed),
    )  # fmt: skip
    extended = read_graph(tmp_path / "more" / "map.graph")
    known = len(read_graph(changed).keyframes)
    assert len(extended.keyframes) > known
    assert extended.in_map().all(), "the robot was not found in the map"

    # The earlier map returns, with the grid map that the map builder uses.
    assert cairn("map", "rollback", str(changed), "0").code == 0
    restored = read_map(tmp_path / "work" / "map.yaml")
    assert obstacles_near(restored, OLD) > 5
    assert obstacles_near(restored, NEW) == 0
