"""Contacts stop the robot, and impossible changes are rejected."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.components.simulation.ray_casting import clearance
from cairn.components.simulation.world import Contact, RobotBody, SlipConfig, World
from cairn.components.simulation.world_file import Furniture, Person, VisibleObject
from cairn.schemas.cairn_sim_msgs import MOST_OBJECTS
from tests.components.simulation.worlds import RADIUS, world_of
from tests.wording import assert_words, words_in_order

TABLE = {"name": "table", "x": 1.5, "y": 2.0, "size": [0.8, 0.8]}
CRATE = {"name": "crate", "x": 4.5, "y": 2.0, "size": [0.6, 0.6]}
ADA = {"name": "ada", "waypoints": [[3.0, 3.4], [5.0, 3.4]], "speed": 1.0}


def driven(world: World, seconds: float, forward: float, turn: float = 0.0) -> list[Contact]:
    contacts: list[Contact] = []
    for _ in range(round(seconds / 0.02)):
        contacts += world.drive(0.02, forward, turn)[1]
    return contacts


def test_wall_stops_the_robot_and_is_reported_once() -> None:
    world = world_of()

    contacts = driven(world, 10.0, 0.5)

    assert [(one.what, one.speed) for one in contacts] == [("wall 1", 0.5)]
    assert 5.76 <= world.robot[0] <= 6.0 - RADIUS
    assert contacts[0].x == pytest.approx(world.robot[0])


def test_contact_is_reported_again_after_the_robot_was_clear() -> None:
    world = world_of()
    driven(world, 10.0, 0.5)
    away = driven(world, 1.0, -0.3)

    assert away == []
    assert len(driven(world, 3.0, 0.5)) == 1


def test_contact_is_reported_again_after_the_robot_was_moved_along_the_wall() -> None:
    world = world_of()
    driven(world, 10.0, 0.5)
    x, y, _ = world.robot

    world.kidnap((x, y - 1.0, 0.0))

    assert [one.what for one in driven(world, 1.0, 0.5)] == ["wall 1"]


def test_both_walls_of_a_corner_are_reported_once_each() -> None:
    world = world_of(robot={"x": 5.7, "y": 3.7, "theta": math.pi / 4})
    message = [one.what for _ in range(5) for one in driven(world, 2.0, 0.3, 0.2)]

    assert sorted(message) == sorted(set(message))


def test_blocked_robot_does_not_follow_its_wheels() -> None:
    world = world_of(robot={"x": 5.75, "y": 2.0})
    driven(world, 1.0, 0.5)
    x, y, theta = world.robot

    assert world.drive(0.02, 0.5, 1.0) == (False, [])
    assert world.robot[:2] == (x, y)
    assert world.robot[2] == pytest.approx(theta + 0.02)


def test_driving_along_a_wall_is_not_a_contact() -> None:
    world = world_of(robot={"x": 1.0, "y": RADIUS + 1e-6, "theta": 0.0})

    assert driven(world, 4.0, 0.5) == []
    assert world.robot[0] == pytest.approx(3.0)


def test_robot_that_slips_sideways_is_held_by_a_wall() -> None:
    world = world_of()
    x, y, _ = world.robot

    world.drive(2.0, 0.0, 0.0, aside=0.1)
    assert world.robot[:2] == pytest.approx((x, y + 0.2))

    (contact,) = world.drive(60.0, 0.0, 0.0, aside=0.1)[1]
    assert contact.what.startswith("wall")


def test_robot_cannot_pass_a_wall_at_any_speed() -> None:
    world = world_of()
    world.drive(1.0, 5.0, 0.0)

    assert world.robot[0] <= 6.0 - RADIUS


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_robot_never_overlaps_anything(seed: int) -> None:
    random = np.random.default_rng(seed)
    world = world_of(
        SlipConfig(distance=0.01, turn=0.02, turn_per_meter=0.01),
        furniture=[TABLE, CRATE],
        people=[ADA],
    )
    for _ in range(60):
        forward, turn = random.uniform(-1, 1), random.uniform(-3, 3)
        for _ in range(10):
            world.drive(0.02, float(forward), float(turn))
            world.move_people(0.02)
            x, y, _ = world.robot
            room, _ = clearance(x, y, world.layout.solid_segments.segments, world.people)
            assert room >= RADIUS - 1e-9


def test_collision_with_a_person_has_the_persons_name() -> None:
    world = world_of(people=[{"name": "bob", "waypoints": [[4.5, 2.0]]}])

    assert [one.what for one in driven(world, 4.0, 0.5)] == ["bob"]


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ((1.5, 2.0), "table"),  # inside a piece larger than the robot
        ((5.9, 2.0), "wall 1 is 0.10 m from there"),
        ((9.0, 2.0), "outside the walls"),
        ((3.0, 3.4), "ada stands"),
    ],
)
def test_kidnapping_into_an_obstacle_is_rejected(place: tuple[float, float], why: str) -> None:
    world = world_of(furniture=[{**TABLE, "size": [2.0, 2.0]}], people=[ADA])
    before = world.robot

    with pytest.raises(CairnError, match=why):
        world.kidnap((*place, 0.0))
    assert world.robot == before


def test_things_cannot_be_put_onto_the_robot_people_or_each_other() -> None:
    world = world_of(furniture=[TABLE, CRATE], people=[ADA])
    refused = {
        (3.1, 2.0): "table would stand on the robot",
        (3.0, 3.5): "table would stand on ada|overlaps",
        (4.4, 2.1): "table overlaps crate at",
        (0.2, 2.0): "table overlaps wall 1 at",
    }
    for place, why in refused.items():
        with pytest.raises(CairnError, match=why):
            world.move("table", (*place, 0.0))
    with pytest.raises(CairnError, match="would stand on the robot"):
        world.add(Furniture(name="huge", x=3.0, y=2.0, size=(1.6, 3.0)))
    with pytest.raises(CairnError, match=words_in_order("ada", "robot")):
        world.move("ada", (3.2, 2.0, 0.0))
    with pytest.raises(CairnError, match=words_in_order("eve", "robot")):
        world.add_person(Person(name="eve", waypoints=[(3.1, 2.1), (3.1, 3.0)]))
    with pytest.raises(CairnError, match=words_in_order("eve", "table")):
        world.add_person(Person(name="eve", waypoints=[(0.5, 2.0), (2.5, 2.0)]))

    assert world.layout.pose_of("table") == (1.5, 2.0, 0.0)
    assert world.layout.version == 0


def test_unknown_name_is_rejected_with_the_known_names() -> None:
    world = world_of(furniture=[TABLE], people=[ADA])
    with pytest.raises(CairnError, match=words_in_order("sofa", "ada, table")):
        world.move("sofa", (1.0, 1.0, 0.0))
    with pytest.raises(CairnError, match=words_in_order("sofa", "ada, table")):
        world.remove("sofa")
    with pytest.raises(CairnError, match="table exists already"):
        world.add_person(Person(name="table", waypoints=[(1.0, 1.0)]))
    with pytest.raises(CairnError, match="ada exists already"):
        world.add(Furniture(name="ada", x=5, y=1, size=(0.3, 0.3)))
    world.add(VisibleObject(id=3, x=1.0, y=0.0, theta=1.6))
    with pytest.raises(CairnError, match=words_in_order("object_3", "id 3")):
        world.add(VisibleObject(id=3, name="poster", x=2.0, y=0.0, theta=1.6))


def test_no_more_objects_are_added_than_cameras_can_show() -> None:
    world = world_of()
    for number in range(1, MOST_OBJECTS + 1):
        world.add(VisibleObject(id=number, x=1.0, y=0.0, theta=1.6))

    with pytest.raises(CairnError, match=words_in_order("poster", "100 objects", "remove one")):
        world.add(VisibleObject(id=1000, name="poster", x=1.0, y=0.0, theta=1.6))


def test_events_happen_when_due_in_the_order_of_time() -> None:
    world = world_of(
        furniture=[TABLE, CRATE],
        events=[
            {"at": 3, "remove": "crate"},
            {"at": 1, "move": "table", "to": {"x": 1.4, "y": 1.0}},
            {"at": 2, "swap": ["table", "crate"]},
            {"at": 3, "kidnap": {"x": 5.0, "y": 3.0}},
            {"at": 3, "add_person": {"name": "eve", "waypoints": [[3.0, 0.5]]}},
        ],
    )

    assert world.run_due_events(0.9) == []
    assert [one.description for one in world.run_due_events(1.0)] == ["table was moved to (1.4, 1)"]
    assert [one.description for one in world.run_due_events(2.5)] == [
        "table and crate were swapped"
    ]
    assert world.layout.pose_of("crate")[:2] == (1.4, 1.0)
    assert [one.succeeded for one in world.run_due_events(9.0)] == [True, True, True]
    assert (world.robot[:2], world.layout.names) == ((5.0, 3.0), ["table"])
    assert [one.person.name for one in world.walkers] == ["eve"]
    assert world.run_due_events(99.0) == []


def test_impossible_event_is_reported_with_its_reason() -> None:
    world = world_of(furniture=[TABLE], events=[{"at": 1, "move": "table", "to": {"x": 3, "y": 2}}])

    (message,) = world.run_due_events(1.0)

    assert not message.succeeded
    assert_words(message.description, "1 s", "table", "robot", "another position")


def test_robots_hold_each_other_back() -> None:
    other = RobotBody("robot_2", (5.0, 2.0, math.pi), RADIUS)
    world = world_of(others=[other])

    contacts = driven(world, 10.0, 0.5)
    contacts += world.drive(0.5, 0.5, 0.0, "robot_2")[1]

    assert [(one.robot, one.what) for one in contacts] == [
        ("robot", "robot_2"),
        ("robot_2", "robot"),
    ]
    assert 2 * RADIUS <= math.dist(world.robot[:2], other.pose[:2]) < 2 * RADIUS + 0.01


def test_nothing_is_put_onto_a_further_robot() -> None:
    other = RobotBody("robot_2", (5.0, 2.0, 0.0), RADIUS)
    world = world_of(others=[other], furniture=[TABLE])

    with pytest.raises(CairnError, match="table would stand on robot_2"):
        world.move("table", (5.0, 2.0, 0.0))
    with pytest.raises(CairnError, match=r"the robot cannot be at .*: robot_2 stands"):
        world.kidnap((5.1, 2.0, 0.0))
    with pytest.raises(CairnError, match=r"robot_3 cannot be at .*: robot stands"):
        world_of(others=[RobotBody("robot_3", world.robot, RADIUS)])
