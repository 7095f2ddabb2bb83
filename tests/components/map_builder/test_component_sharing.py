"""Tests of the component: robots with the same map exchange what they find out about landmarks."""

from dataclasses import replace
from pathlib import Path

import pytest

from cairn import LATCHED, CairnError
from cairn.components.map_builder.component import MapBuilder
from cairn.schemas.cairn_msgs import (
    LandmarkContribution,
    RecordContributor,
    SharedLandmarks,
    VisualMap,
    VisualMapChange,
    VisualObject,
)
from cairn.testing.lockstep import ComponentHarness, Lockstep
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.new_map import write_map
from cairn.visual_map.sqlite_file import digest_of
from tests.components.map_builder.evidence import surveyed
from tests.components.map_builder.test_component_landmarks import frame

FLEET = "/fleet/landmarks"


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.cairn"
    write_map(path, "a test", [surveyed(6), surveyed(7)])
    return path


def builder(
    world: Lockstep, map_file: Path, robot: str, topic: str = FLEET
) -> ComponentHarness[MapBuilder]:
    parameters = {
        "map_file": str(map_file),
        "working_copy": str(map_file.with_name(f"{robot}.cairn")),
        "share": True,
    }
    return ComponentHarness(
        MapBuilder,
        parameters,
        beside=world,
        robot=robot,
        topics={"shared": topic, "others": topic},
    )


def shown(it: ComponentHarness[MapBuilder]) -> list[tuple[object, ...]]:
    newest: VisualMap = it.take("visual_map")[-1]
    return [(o.object_id, o.x, o.y, o.reliability, o.state) for o in newest.objects]


def test_landmark_moved_in_front_of_one_robot_is_repaired_in_the_maps_of_all(
    map_file: Path,
) -> None:
    world = Lockstep(1000.0)
    robots = [builder(world, map_file, f"robot_{k}") for k in range(3)]

    robots[0].publish("object_evidence", frame(0, 0.1, 3.5))
    changes = robots[2].take("visual_map_changes")
    assert [one.kind for one in changes] == [VisualMapChange.REMOVED]
    assert changes[0].reason.startswith("robot_0 found at 1970-01-01 00:16:40")
    assert shown(robots[1])[1][-1] == VisualObject.RELOCATING

    for step in range(1, 4):
        robots[0].publish("object_evidence", frame(step, 0.9, 3.5))
    world.run_for(2.0)

    maps = [shown(robot) for robot in robots]
    assert maps[0] == maps[1] == maps[2]
    assert maps[0][1][-1] == VisualObject.LIVE
    assert maps[0][1][1] == pytest.approx(3.5, abs=0.05)
    # Committed before it was published.
    with open_landmarks(map_file.with_name("robot_1.cairn"), read_only=True) as store:
        assert [one[3] for one in store.history()][2:] == ["REMOVED", "REGISTERED"]


def test_robots_pass_on_what_a_robot_found_out_that_has_left(map_file: Path) -> None:
    world = Lockstep(1000.0)
    first, second = (builder(world, map_file, f"robot_{k}") for k in (1, 2))
    for step in range(4):
        first.publish("object_evidence", frame(step, 0.1 if step == 0 else 0.9, 3.5))
    first.request("deactivate")
    first.request("shutdown")
    world.run_for(60.0)

    third = builder(world, map_file, "robot_3")
    world.run_for(3.0)

    changes = third.take("visual_map_changes")
    assert [one.kind for one in changes] == [VisualMapChange.REGISTERED]
    assert changes[0].reason.startswith("robot_1 registered it at its new position")
    assert shown(second) == shown(third)


def test_lost_messages_are_sent_again(map_file: Path) -> None:
    world = Lockstep(1000.0)
    robots = [builder(world, map_file, f"robot_{k}") for k in (1, 2)]
    robots[1].request("deactivate")  # it receives nothing now
    for step in range(4):
        robots[0].publish("object_evidence", frame(step, 0.1 if step == 0 else 0.9, 3.5))
    world.run_for(2.0)

    robots[1].request("activate")
    world.run_for(3.0)

    assert shown(robots[0]) == shown(robots[1])
    newest = [robot.take("shared")[-1] for robot in robots]
    assert newest[0].contributors == newest[1].contributors != ()
    world.run_for(20.0)
    assert not any(one.contributions for robot in robots for one in robot.take("shared"))


def test_hostile_contributions_are_rejected_and_counted(map_file: Path) -> None:
    world = Lockstep(1000.0)
    it = builder(world, map_file, "robot_1")
    good = LandmarkContribution(robot="robot_9", object_id=7, version=1, removed=True)
    hostile = (
        replace(good, robot="../etc"),
        replace(good, robot="robot_1 "),
        replace(good, version=0),
        replace(good, version=2**63),
        replace(good, log_odds=1e9),
        replace(good, began=5, began_by="robot_9"),
        replace(good, x=2e8, y=0.0, began=5, began_by="robot_9"),
        replace(good, x=0.0, y=0.0, began=10**18, began_by="robot_9"),  # years ahead
    )
    message = SharedLandmarks(robot="robot_9", map=digest_of(map_file), contributions=hostile)

    world.publish(FLEET, message, qos=LATCHED)
    world.run_for(2.0)

    assert it.take("visual_map_changes") == []
    assert it.take("shared")[-1].rejected == len(hostile)
    world.publish(FLEET, replace(message, contributions=(good,)))
    assert [one.kind for one in it.take("visual_map_changes")] == [VisualMapChange.REMOVED]


def test_robots_with_another_map_share_nothing(map_file: Path) -> None:
    world = Lockstep(1000.0)
    other = map_file.with_name("other.cairn")
    write_map(other, "another test", [surveyed(6), surveyed(7)])
    robots = [builder(world, map_file, "robot_1"), builder(world, other, "robot_2")]

    robots[0].publish("object_evidence", frame(0, 0.1, 3.5))
    world.run_for(3.0)

    assert robots[1].take("visual_map_changes") == []


def test_ports_on_different_topics_are_an_error(map_file: Path) -> None:
    parameters = {"map_file": str(map_file), "working_copy": f"{map_file}.copy", "share": True}

    with pytest.raises(CairnError, match="give both the same one, such as /fleet/landmarks"):
        ComponentHarness(MapBuilder, parameters)


def test_sharing_without_a_working_copy_is_an_error(map_file: Path) -> None:
    with pytest.raises(CairnError, match="share requires map_file and working_copy"):
        ComponentHarness(MapBuilder, {"map_file": str(map_file), "share": True})


def test_sharing_a_map_that_does_not_change_is_an_error(map_file: Path) -> None:
    parameters = {"map_file": str(map_file), "working_copy": f"{map_file}.copy", "share": True}

    with pytest.raises(CairnError, match="share requires update_objects: true"):
        ComponentHarness(MapBuilder, {**parameters, "update_objects": False})


def test_robot_with_a_name_that_another_one_has_is_warned(
    map_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = Lockstep(1000.0)
    builder(world, map_file, "robot_1")
    contributors = (RecordContributor(robot="robot_1", newest=7, count=1),)
    message = SharedLandmarks(robot="robot_1", map=digest_of(map_file), contributors=contributors)

    world.publish(FLEET, message, qos=LATCHED)

    assert "another robot has the name robot_1" in caplog.text
