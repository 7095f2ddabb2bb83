"""Invalid world files are rejected with file, position, value and remedy."""

import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from cairn import CairnError
from cairn.components.simulation.world_checks import world_problems
from cairn.components.simulation.world_drawing import label_positions
from cairn.components.simulation.world_file import WorldFile, read_world
from tests.commands import cairn
from tests.components.simulation.worlds import RADIUS, box

WORLDS = Path(__file__).parents[3] / "deploy" / "worlds"
DESK = {"name": "desk", "x": 1.0, "y": 1.0, "size": [0.8, 0.6]}

LEFT = {"robot": {"x": 1.0, "y": 2.0}}
KNOT = [[0, 0], [1, 1], [1, 0], [0, 1]]

UNREADABLE: dict[str, tuple[str, str]] = {
    "syntax": ("walls: [", r":1:9: not YAML: expected"),
    "empty": ("", "with the keys walls and robot"),
    "a list": ("- 1", "with the keys walls and robot"),
    "a key twice": ("robot: {x: 1, y: 1}\nrobot: {x: 2, y: 2}", ":2:1: not YAML: the key robot is"),
    "no walls": ("robot: {x: 1, y: 1}", "walls: must be given"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_file_that_is_not_a_world_is_rejected_with_its_position(case: str, tmp_path: Path) -> None:
    text, message = UNREADABLE[case]
    file = tmp_path / "world.yaml"
    file.write_text(text)

    with pytest.raises(CairnError, match=message) as found:
        read_world(file)
    assert str(found.value).startswith(str(file))
    assert "\n" not in str(found.value)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown key": ({"color": "red"}, "color = 'red': unknown key; expected one of"),
    "a key misspelled": ({"furnitures": []}, "unknown key; did you mean furniture?"),
    "a key misspelled within": (
        {"events": [{"at": 1, "add_furniture": {**DESK, "sise": [1, 1]}}]},
        r"events\[0\].add_furniture.sise = .*; did you mean size",
    ),
    "a wall without its key": (
        {"walls": [[[0, 0], [1, 1]]]},
        r"walls\[0\] = .*: must be a mapping with the keys points, ",
    ),
    "a wall of one point": (
        {"walls": [{"points": [[0, 0]]}]},
        r"points = .*: must have at least 2 items, not 1$",
    ),
    "degrees": ({"robot": {"x": 1, "y": 1, "theta": "9deg"}}, "theta = '9deg': must be a number"),
    "a mirror": (
        {"walls": [{"points": [[0, 0], [1, 0]], "surface": "mirror"}]},
        "surface = 'mirror': must be 'plain', 'dark' or 'glass'",
    ),
    "not a number": ({"robot": {"x": float("nan"), "y": 1}}, "robot.x = 'nan': "),
    "furniture without shape": (
        {"furniture": [{"name": "desk", "x": 1, "y": 1}]},
        r"furniture\[0\]: give either outline or size",
    ),
    "a negative size": (
        {"furniture": [{**DESK, "size": [0.8, -1]}]},
        r"furniture\[0\].size\[1\] = '-1': must be greater than 0",
    ),
    "a name with spaces": ({"furniture": [{**DESK, "name": "my desk"}]}, r"furniture\[0\].name = "),
    "twin names": ({"furniture": [DESK, DESK]}, "name is not unique: desk"),
    "twin ids": (
        {"objects": [{"id": 1, "x": 0, "y": 1}, {"id": 1, "name": "b", "x": 0, "y": 2}]},
        "object id is not unique: 1",
    ),
    "an event without a kind": (
        {"events": [{"at": 1}]},
        r"events\[0\]: give exactly one of move, ",
    ),
    "an event in the past": ({"events": [{"at": -1, "remove": "a"}]}, r"events\[0\].at = '-1'"),
    "move without to": ({"events": [{"at": 1, "move": "a"}]}, "move needs the key to"),
}


@pytest.mark.parametrize("case", WRONG)
def test_invalid_value_is_rejected_with_its_key(case: str, tmp_path: Path) -> None:
    changed, message = WRONG[case]
    file = tmp_path / "world.yaml"
    file.write_text(yaml.safe_dump(box(**changed)))

    with pytest.raises(CairnError, match=message) as found:
        read_world(file)
    assert str(found.value).startswith(f"{file}: ")


def test_missing_file_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"none.yaml: no such world file"):
        read_world(tmp_path / "none.yaml")


IMPOSSIBLE: dict[str, tuple[dict[str, Any], str]] = {
    "furniture in furniture": (
        {"furniture": [DESK, {**DESK, "name": "shelf", "x": 1.5}]},
        r"shelf overlaps desk at \(1.25, 1.00\); move one of them",
    ),
    "furniture in a wall": (
        {"furniture": [{**DESK, "x": 0.2}]},
        r"desk overlaps wall 1 at \(0.00, 1.00\); move one of them",
    ),
    "a knot": (
        {"furniture": [{"name": "knot", "x": 1, "y": 1, "outline": KNOT}]},
        "the outline of knot crosses itself",
    ),
    "walls on one another": (
        {"walls": [*box()["walls"], {"points": [[1, 0], [2, 0]]}]},
        r"wall 1 and wall 2 overlap at \(1.50, 0.00\); leave one out",
    ),
    "a point twice": (
        {"walls": [*box()["walls"], {"points": [[1, 1], [1, 1]]}]},
        r"wall 2 has the point \(1, 1\) twice in a row; leave one out",
    ),
    "the robot inside furniture": (
        {"furniture": [{**DESK, "x": 3, "y": 2, "size": [2, 2]}]},
        r"robot: it cannot be at \(3.00, 2.00\): desk is 0.00 m from there",
    ),
    "the robot outside": ({"robot": {"x": 9, "y": 9}}, "outside the walls"),
    "an open world": (
        {"walls": [{"points": [[0, 0], [6, 0], [6, 4], [0, 4], [0, 1]]}]},
        r"the walls leave a gap of 1.00 m from \(0.00, 0.00\) to \(0.00, 1.00\); close it",
    ),
    "an open world with a door within": (
        {"walls": [
            {"points": [[0, 0], [6, 0], [6, 4], [0, 4], [0, 2]]},
            {"points": [[3, 0], [3, 1.5]]}, {"points": [[3, 2.5], [3, 4]]}], **LEFT},
        r"the walls leave a gap of 2.00 m from \(0.00, 0.00\) to \(0.00, 2.00\); close it$",
    ),
    "a wall that ends before another": (
        {"walls": [{"points": [[0, 0], [6, 0], [6, 4]]}, {"points": [[5, 4], [0, 4], [0, 0]]}]},
        r"the walls leave a gap of 1.00 m from .*\(6.00, 4.00\).*; close it$",
    ),
    "a world with two gaps": (
        {"walls": [{"points": [[0, 0], [6, 0], [6, 3]]}, {"points": [[6, 4], [0, 4], [0, 1]]}]},
        r"gap of 1.00 m from .*; close it; the walls leave a gap of 1.00 m from .*; close it$",
    ),
    "a wall that crosses itself": (
        {"walls": [{"points": [[0, 0], [6, 4], [6, 0], [0, 4], [0, 0]]}], **LEFT},
        r"wall 1 crosses itself at \(3.00, 2.00\); correct the order of its points",
    ),
    "a wall beside another": (
        {"walls": [*box()["walls"], {"points": [[1, 0.01], [4, 0.01]]}]},
        r"wall 2 runs less than 0.02 m beside wall 1 at \(2.50, 0.01\)",
    ),
    "furniture outside": (
        {"furniture": [{**DESK, "x": 9}]},
        r"desk cannot be at \(9.00, 1.00\): the position is outside the walls",
    ),
    "furniture that leans on the outside": (
        {"furniture": [{**DESK, "x": 6.4}]},
        r"desk cannot be at \(6.40, 1.00\): the position is outside the walls",
    ),
    "an event that puts furniture outside": (
        {"furniture": [DESK], "events": [{"at": 5, "move": "desk", "to": {"x": 9, "y": 2}}]},
        r"the event at 5 s cannot happen: desk cannot be at \(9.00, 2.00\)",
    ),
    "an object inside furniture": (
        {"furniture": [DESK], "objects": [{"id": 4, "x": 1.0, "y": 1.0}]},
        "object_4 at .* is hidden inside desk",
    ),
    "an object that faces outward": (
        {"objects": [{"id": 4, "x": 0, "y": 1.0, "theta": 3.1416}]},
        r"object_4 at \(0, 1\) is outside the walls or faces outward",
    ),
    "a person through furniture": (
        {"furniture": [DESK], "people": [{"name": "ada", "waypoints": [[1, 3], [1, 0.4]]}]},
        r"ada cannot walk from \(1, 3\) to \(1, 0.4\): desk is in the way",
    ),
    "a person on the robot": (
        {"people": [{"name": "ada", "waypoints": [[3.2, 2], [5, 2]]}]},
        r"ada begins at \(3.2, 2\), on the robot",
    ),
    "a person outside": (
        {"people": [{"name": "ada", "waypoints": [[8, 2]]}]},
        r"ada begins at \(8, 2\), outside",
    ),
    "an event about a missing thing": (
        {"events": [{"at": 5, "remove": "sofa"}]},
        "the event at 5 s cannot happen: sofa does not exist",
    ),
    "an event after which it is gone": (
        {"furniture": [DESK], "events": [
            {"at": 5, "move": "desk", "to": {"x": 2, "y": 3}}, {"at": 4, "remove": "desk"}]},
        "the event at 5 s cannot happen: desk does not exist",
    ),
    "an event without room": (
        {"furniture": [DESK], "events": [{"at": 5, "move": "desk", "to": {"x": 6, "y": 2}}]},
        "the event at 5 s cannot happen: desk overlaps wall 1",
    ),
    "a kidnapping into a wall": (
        {"events": [{"at": 5, "kidnap": {"x": 7, "y": 2}}]},
        "the event at 5 s cannot happen: the robot cannot be at",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_impossible_world_is_rejected(case: str, tmp_path: Path) -> None:
    changed, message = IMPOSSIBLE[case]
    file = tmp_path / "world.yaml"
    file.write_text(yaml.safe_dump(box(**changed)))

    assert re.search(message, "; ".join(world_problems(read_world(file), RADIUS)))
    answer = cairn("world", "check", str(file))
    assert answer.code == 1
    assert answer.err.startswith(f"cairn: {file}: ")


@pytest.mark.parametrize("name", ["room", "office", "hall"])
def test_worlds_of_this_repository_are_valid(name: str) -> None:
    assert world_problems(read_world(WORLDS / f"{name}.yaml"), RADIUS) == []


def test_walls_may_meet_at_any_angle_and_furniture_may_close_them() -> None:
    """A wall bent inward, a part of a circle, a narrow wedge, a door in the outer wall."""
    corners = [[0, 0], [6, 0], [6, 4], [3, 4], [3, 2]]
    arc = [[1.0 + 0.5 * math.cos(a / 9), 3.0 + 0.5 * math.sin(a / 9)] for a in range(40)]
    walls = [
        {"points": corners}, {"points": [[3, 4], [1, 4]]}, {"points": [[0, 4], [0, 0]]},
        {"points": arc}, {"points": [[6, 0], [4, 0.3]]},
    ]  # fmt: skip
    door = {"name": "door", "x": 0.5, "y": 4.0, "size": [1.0, 0.1]}
    world = WorldFile.model_validate(
        {"walls": walls, "furniture": [door], "robot": {"x": 2.0, "y": 1.0}}
    )

    assert world_problems(world, RADIUS) == []


@pytest.mark.parametrize(("until", "warned"), [(4.0, True), (3.6, True), (3.5, False)])
def test_check_warns_of_unreachable_areas(until: float, warned: bool, tmp_path: Path) -> None:
    file = tmp_path / "world.yaml"
    walls = [*box()["walls"], {"points": [[3, 0], [3, until]]}]
    file.write_text(yaml.safe_dump({"walls": walls, **LEFT}))

    answer = cairn("world", "check", str(file))

    assert answer.code == 0
    assert answer.out.startswith(f"{file}: 2 walls")
    assert ("12.0 m2 around (4.50, " in answer.err) == warned
    assert ("cannot be reached from the start by a robot of 0.22 m radius" in answer.err) == warned


def test_touching_is_not_overlapping() -> None:
    pair = [DESK, {**DESK, "name": "shelf", "x": 1.8}, {**DESK, "name": "box", "x": 0.4, "y": 2.0}]

    assert world_problems(WorldFile.model_validate(box(furniture=pair)), RADIUS) == []


def test_check_counts_and_draw_writes_a_picture(tmp_path: Path) -> None:
    file, picture = tmp_path / "world.yaml", tmp_path / "world.png"
    people = [{"name": "ada", "waypoints": [[1, 3], [5, 3]]}]
    file.write_text(yaml.safe_dump(box(furniture=[DESK], people=people)))

    assert cairn("world", "check", str(file)).out == (
        f"{file}: 1 walls, 1 pieces of furniture, 0 objects, 1 people, 0 events\n"
    )
    assert cairn("world", "draw", str(file), str(picture)).code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    wrong = cairn("world", "draw", str(file), str(tmp_path / "world.xyz"))
    assert wrong.code == 1
    assert "cannot be written" in wrong.err


def test_labels_are_beside_small_furniture_and_cover_nothing() -> None:
    legs: list[dict[str, Any]] = [
        {"name": f"table_leg{k}", "x": 2.0 + 0.4 * (k % 2), "y": 1.0 + 0.6 * (k // 2),
         "size": [0.05, 0.05]}
        for k in range(4)
    ]  # fmt: skip
    sofa = {"name": "sofa", "x": 4.0, "y": 3.0, "size": [1.5, 0.8]}
    world = WorldFile.model_validate(box(furniture=[*legs, sofa]))

    places = label_positions(world, 0.8)

    assert places["sofa"] == (4.0, 3.0)
    wide, high = 0.4, 0.08  # about the size of a label [m] at that scale
    for name, (x, y) in places.items():
        for leg in legs:
            assert abs(x - leg["x"]) > wide / 2 or abs(y - leg["y"]) > high / 2
        for other, (other_x, other_y) in places.items():
            assert other == name or abs(x - other_x) > wide or abs(y - other_y) > high


def test_events_within_closed_walls_can_happen() -> None:
    person = {"name": "ada", "waypoints": [[1.0, 1.0], [1.0, 3.0]]}
    events = [
        {"at": 1, "kidnap": {"x": 5.0, "y": 3.0}},
        {"at": 2, "move": "ada", "to": {"x": 2.0, "y": 1.0}},
    ]

    assert (
        world_problems(WorldFile.model_validate(box(people=[person], events=events)), RADIUS) == []
    )


def test_overlap_beyond_the_tolerance_is_rejected_for_thin_furniture_too() -> None:
    table = {"name": "table", "x": 1.0, "y": 1.0, "size": [1.0, 1.0]}
    chair = {"name": "chair", "x": 1.97, "y": 1.0, "size": [1.0, 1.0]}
    panel = {"name": "panel", "x": 1.45, "y": 1.0, "size": [0.03, 0.6]}

    for other in (chair, panel):
        world = WorldFile.model_validate(box(furniture=[table, other]))
        assert any("overlaps" in problem for problem in world_problems(world, RADIUS))
