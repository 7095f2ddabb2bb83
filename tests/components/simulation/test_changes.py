"""Changes of the world and restarted components: all drivers follow."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, CairnError, to_ns
from cairn.components.simulation.base import SimulatedBase
from cairn.components.simulation.recognizer import SimulatedRecognizer
from cairn.components.simulation.scanner import SimulatedScanner
from cairn.planar.messages import planar_pose
from cairn.planar.poses import distance
from cairn.schemas.cairn_msgs import VisualMap
from tests.components.simulation.simulation_harness import EXACT, MOUNT, OBJECTS, TABLE, Simulation

Simulate = Callable[..., Simulation]


def test_sensors_see_moved_furniture_at_its_new_pose(simulate: Simulate) -> None:
    simulation = simulate(furniture=[TABLE], objects=OBJECTS)
    simulation.drive(0.5, 0, 0)
    simulation.take("scan"), simulation.take("objects")
    simulation.world.request("move", name="table", x=4.5, y=2.0, theta=0.0)
    simulation.drive(0.5, 0, 0)
    scan = simulation.take("scan")[-1]

    ahead = round((-0.2 - scan.angle_min) / scan.angle_increment)
    assert scan.ranges[ahead] == pytest.approx(4.1 - 3.1, abs=0.08)
    assert not any(seen.objects for seen in simulation.take("objects"))
    simulation.world.request("remove", name="table")
    simulation.world.request("move", name="object_1", x=5.0, y=2.5, theta=3.1416)
    simulation.drive(0.5, 0, 0)
    assert simulation.take("objects")[-1].objects[0].range == pytest.approx(2.06, abs=0.3)


@pytest.mark.parametrize(
    ("verb", "arguments", "message"),
    [
        ("move", {"name": "table", "x": 3, "y": 2}, "table would stand on the robot"),
        (
            "move",
            {"name": "sofa", "x": 3, "y": 2},
            "sofa does not exist; expected one of: obj",
        ),
        ("move", {"name": "table", "x": float("nan"), "y": 2}, "move: x = 'nan': "),
        ("move", {"name": "table"}, "move: x: must be given; y: must be given"),
        ("furniture", {"name": "b", "x": 1, "y": 1}, "furniture: give either outline or size"),
        (
            "object",
            {"id": 5, "x": 6, "y": 1, "texture": "no.png"},
            "object_5: .*no.png: cannot be read",
        ),
        (
            "object",
            {"id": 5, "x": 6, "y": 1, "texture": "/dev/zero"},
            "object_5: /dev/zero: cannot be read: it is a device; give a regular file",
        ),
        ("object", {"id": 5, "x": 6, "y": 1, "z": 2.5}, "object_5 goes from 2.35 m to 2.65 m"),
        ("kidnap", {"x": 0.1, "y": 2}, "wall 1 is 0.10 m from there"),
        ("person", {"name": "a", "waypoints": []}, "person: waypoints = "),
        ("dance", {}, "dance"),
    ],
)
def test_invalid_requests_are_rejected_with_the_reason(
    simulate: Simulate, verb: str, arguments: dict[str, Any], message: str
) -> None:
    simulation = simulate(furniture=[TABLE], objects=OBJECTS)

    with pytest.raises(CairnError, match=message):
        simulation.world.request(verb, **arguments)
    assert simulation.world.state == "active"


def test_kidnapping_moves_the_robot_but_not_its_odometry(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.drive(0.5, 0, 0)
    simulation.world.request("kidnap", x=1.0, y=1.0, theta=1.0)
    simulation.drive(0.5, 0, 0)

    last = simulation.take("truth")[-1]
    assert last.header.frame_id == "map"
    assert planar_pose(last.pose) == pytest.approx((1.0, 1.0, 1.0))
    assert planar_pose(simulation.take("odom")[-1].pose.pose) == (0.0, 0.0, 0.0)


def test_events_happen_on_time_and_update_the_true_map(simulate: Simulate) -> None:
    event = {"at": 2.0, "move": "object_2", "to": {"x": 0.0, "y": 1.0}}
    simulation = simulate(objects=OBJECTS, events=[event])
    maps = simulation.lockstep.read("true_map", VisualMap)
    simulation.drive(4.0, 0, 0)

    first, second = maps.take()
    assert to_ns(second.header.stamp) == pytest.approx(3 * SECOND, abs=SECOND // 20)
    assert [thing.y for thing in first.objects] == [2.0, 2.0]
    assert [thing.y for thing in second.objects] == [2.0, 1.0]


def test_restarted_base_counts_from_its_origin_while_the_robot_stays(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.drive(2.0, 0.4, 0.0)
    simulation.base.request("shutdown")
    before = simulation.take("truth")[-1]
    simulation.add(SimulatedBase, **EXACT)
    simulation.take("odom")
    simulation.drive(0.2, 0.0, 0.0)

    assert planar_pose(simulation.take("odom")[0].pose.pose) == (0.0, 0.0, 0.0)
    now = simulation.take("truth")[-1]
    assert distance(planar_pose(now.pose), planar_pose(before.pose)) < 0.05


def test_restarted_sensors_receive_the_world_geometry(simulate: Simulate) -> None:
    simulation = simulate(objects=OBJECTS)
    simulation.drive(0.5, 0, 0)
    simulation.scanner.request("shutdown")
    simulation.recognizer.request("shutdown")
    simulation.take("scan"), simulation.take("objects")
    simulation.add(SimulatedScanner, mount=MOUNT)
    simulation.add(SimulatedRecognizer, detection_probability=1.0)
    simulation.drive(0.5, 0, 0)

    assert np.isfinite(simulation.take("scan")[-1].ranges).mean() > 0.9
    assert simulation.take("objects")
