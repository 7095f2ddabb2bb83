"""The robot is held back by what stands, and what cannot be is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.components.simulation.rays import clearance
from cairn.components.simulation.world import Contact, Slip, World
from cairn.components.simulation.world_file import Furniture, Person, VisibleObject
from tests.components.simulation.worlds import RADIUS, world_of

TABLE = {"name": "table", "x": 1.5, "y": 2.0, "size": [0.8, 0.8]}
CRATE = {"name": "crate", "x": 4.5, "y": 2.0, "size": [0.6, 0.6]}
ADA = {"name": "ada", "waypoints": [[3.0, 3.4], [5.0, 3.4]], "speed": 1.0}


def driven(world: World, seconds: float, forward: float, turn: float = 0.0) -> list[Contact]:
    contacts: list[Contact] = []
    for _ in range(round(seconds / 0.02)):
        contacts += world.drive(0.02, forward, turn)[1]
    return contacts


def test_a_wall_holds_the_robot_back_and_is_told_once() -> None:
    world = world_of()

    contacts = driven(world, 10.0, 0.5)

    assert [(one.what, one.speed) for one in contacts] == [("wall 1", 0.5)]
    assert 5.76 <= world.robot[0] <= 6.0 - RADIUS
    assert contacts[0].x == pytest.approx(world.robot[0])


def test_it_is_told_again_after_the_robot_was_clear() -> None:
    world = world_of()
    driven(world, 10.0, 0.5)
    away = driven(world, 1.0, -0.3)

    assert away == []
    assert len(driven(world, 3.0, 0.5)) == 1


def test_two_walls_of_a_corner_are_told_once_each() -> None:
    world = world_of(robot={"x": 5.7, "y": 3.7, "theta": math.pi / 4})
    told = [one.what for _ in range(5) for one in driven(world, 2.0, 0.3, 0.2)]

    assert sorted(told) == sorted(set(told))


def test_a_robot_that_is_held_back_says_that_it_does_not_follow_its_wheels() -> None:
    world = world_of(robot={"x": 5.75, "y": 2.0})
    driven(world, 1.0, 0.5)
    x, y, theta = world.robot

    assert world.drive(0.02, 0.5, 1.0) == (False, [])
    assert world.robot[:2] == (x, y)
    assert world.robot[2] == pytest.approx(theta + 0.02)


def test_beside_a_wall_nothing_is_touched() -> None:
    world = world_of(robot={"x": 1.0, "y": RADIUS + 1e-6, "theta": 0.0})

    assert driven(world, 4.0, 0.5) == []
    assert world.robot[0] == pytest.approx(3.0)


def test_nobody_gets_through_a_wall_however_fast() -> None:
    world = world_of()
    world.drive(1.0, 5.0, 0.0)

    assert world.robot[0] <= 6.0 - RADIUS


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_the_robot_overlaps_nothing_whatever_it_does(seed: int) -> None:
    random = np.random.default_rng(seed)
    world = world_of(Slip(0.01, 0.02, 0.01), furniture=[TABLE, CRATE], people=[ADA])
    for _ in range(60):
        forward, turn = random.uniform(-1, 1), random.uniform(-3, 3)
        for _ in range(10):
            world.drive(0.02, float(forward), float(turn))
            world.walk(0.02)
            x, y, _ = world.robot
            room, _ = clearance(x, y, world.scene.standing.segments, world.people)
            assert room >= RADIUS - 1e-9


def test_a_person_in_the_way_is_a_collision_with_their_name() -> None:
    world = world_of(people=[{"name": "bob", "waypoints": [[4.5, 2.0]]}])

    assert [one.what for one in driven(world, 4.0, 0.5)] == ["bob"]


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ((1.5, 2.0), "table"),  # inside a piece larger than the robot
        ((5.9, 2.0), "wall 1 is 0.10 m from there"),
        ((9.0, 2.0), "outside of the walls"),
        ((3.0, 3.4), "ada stands"),
    ],
)
def test_the_robot_is_not_carried_into_anything(place: tuple[float, float], why: str) -> None:
    world = world_of(furniture=[{**TABLE, "size": [2.0, 2.0]}], people=[ADA])
    before = world.robot

    with pytest.raises(CairnError, match=why):
        world.carry((*place, 0.0))
    assert world.robot == before


def test_things_are_not_put_onto_the_robot_people_or_each_other() -> None:
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
    with pytest.raises(CairnError, match="ada would stand on the robot"):
        world.move("ada", (3.2, 2.0, 0.0))
    with pytest.raises(CairnError, match="eve would stand on the robot"):
        world.add_person(Person(name="eve", waypoints=[(3.1, 2.1), (3.1, 3.0)]))
    with pytest.raises(CairnError, match=r"eve cannot walk .* table is in the way"):
        world.add_person(Person(name="eve", waypoints=[(0.5, 2.0), (2.5, 2.0)]))

    assert world.scene.pose_of("table") == (1.5, 2.0, 0.0)
    assert world.scene.version == 0


def test_what_is_there_and_what_is_not_is_told() -> None:
    world = world_of(furniture=[TABLE], people=[ADA])
    with pytest.raises(CairnError, match="there is no sofa; there are ada, table"):
        world.move("sofa", (1.0, 1.0, 0.0))
    with pytest.raises(CairnError, match="there is no sofa; there are ada, table"):
        world.remove("sofa")
    with pytest.raises(CairnError, match="there is a table already"):
        world.add_person(Person(name="table", waypoints=[(1.0, 1.0)]))
    with pytest.raises(CairnError, match="there is a ada already"):
        world.add(Furniture(name="ada", x=5, y=1, size=(0.3, 0.3)))
    world.add(VisibleObject(id=3, x=1.0, y=0.0, theta=1.6))
    with pytest.raises(CairnError, match="object_3 has the id 3 already"):
        world.add(VisibleObject(id=3, name="poster", x=2.0, y=0.0, theta=1.6))


def test_events_happen_when_they_are_due_in_the_order_of_time() -> None:
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

    assert world.happen(0.9) == []
    assert [one.told for one in world.happen(1.0)] == ["table is moved to (1.4, 1)"]
    assert [one.told for one in world.happen(2.5)] == ["table and crate change places"]
    assert world.scene.pose_of("crate")[:2] == (1.4, 1.0)
    assert [one.done for one in world.happen(9.0)] == [True, True, True]
    assert (world.robot[:2], world.scene.names) == ((5.0, 3.0), ["table"])
    assert [one.person.name for one in world.walkers] == ["eve"]
    assert world.happen(99.0) == []


def test_an_event_that_cannot_happen_is_told_with_its_reason() -> None:
    world = world_of(furniture=[TABLE], events=[{"at": 1, "move": "table", "to": {"x": 3, "y": 2}}])

    (told,) = world.happen(1.0)

    assert not told.done
    assert told.told == (
        "the event at 1 s cannot happen: table would stand on the robot; choose another place"
    )
