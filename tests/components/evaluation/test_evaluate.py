"""`cairn evaluate navigation`, as a user runs it: goals reached in the room, and a report."""

import json
from pathlib import Path

from tests.commands import cairn

ROOT = Path(__file__).parents[3]


def test_a_robot_reaches_its_goals_though_it_is_carried_off(tmp_path: Path) -> None:
    answer = cairn(
        "evaluate",
        "navigation",
        "--world",
        str(ROOT / "deploy" / "worlds" / "room.yaml"),
        "--deployment",
        str(ROOT / "deploy" / "sim.yaml"),
        "--goals",
        "2",
        "--seeds",
        "3",
        "--kidnap",
        "--out",
        str(tmp_path / "out"),
        "--json",
    )

    assert answer.code == 0, answer
    summary = json.loads(answer.out)["summary"]
    assert (summary["goals"], summary["reached"], summary["collisions"]) == (2, 2, 0)
    assert (summary["kidnapped"], summary["kidnapped_reached"]) == (1, 1)
    runs = json.loads((tmp_path / "out" / "runs.json").read_text())["runs"]
    assert runs[0]["seed"] == 3
    assert runs[0]["error_median"] < 0.05
    for picture in ("tracks.png", "ways.png"):
        assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")


def test_a_world_that_cannot_be_is_told_of(tmp_path: Path) -> None:
    world = tmp_path / "world.yaml"
    world.write_text(
        "walls: [{points: [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]}]\n"
        "furniture:\n"
        "  - {name: table, x: 2, y: 2, size: [1, 1]}\n"
        "  - {name: desk, x: 2.4, y: 2, size: [1, 1]}\n"
        "robot: {x: 1, y: 1}\n"
    )

    answer = cairn(
        "evaluate",
        "navigation",
        "--world",
        str(world),
        "--deployment",
        str(ROOT / "deploy" / "sim.yaml"),
        "--out",
        str(tmp_path / "out"),
    )

    assert answer.code == 1
    assert "desk overlaps table at (2.20, 2.00); move one of them" in answer.err
