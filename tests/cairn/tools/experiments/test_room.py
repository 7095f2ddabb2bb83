"""Moves drawn at random can be: along the walls, apart, and in sight."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.components.simulation.world_checks import world_problems
from cairn.components.simulation.world_file import Event, read_world
from cairn.tools.experiments.room import Room

ROOM = Path(__file__).parents[4] / "deploy" / "worlds" / "room.yaml"


@pytest.fixture(scope="module")
def room() -> Room:
    return Room(ROOM)


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 10_000), distance=st.sampled_from([None, 0.3, 1.0, 2.0]))
def test_objects_are_moved_as_asked_and_stay_apart(
    room: Room, seed: int, distance: float | None
) -> None:
    world = read_world(ROOM)
    events = room.moves(4, distance, 5.0, np.random.default_rng(seed))
    changed = world.model_copy(update={"events": [Event.model_validate(one) for one in events]})

    assert world_problems(changed, 0.22) == []
    assert len({event["move"] for event in events}) == 4
    names = {thing.display_name: (thing.x, thing.y) for thing in world.objects}
    places = dict(names)
    for event in events:
        to = (event["to"]["x"], event["to"]["y"])
        way = math.dist(to, names[event["move"]])
        assert way >= 0.6 if distance is None else way == pytest.approx(distance, abs=0.031)
        places[event["move"]] = to
        assert event["at"] == 5.0
    apart = [math.dist(a, b) for i, a in places.items() for j, b in places.items() if i < j]
    assert min(apart) >= 0.35


def test_the_same_seed_moves_the_same(room: Room) -> None:
    one, same, other = (room.moves(2, None, 1.0, np.random.default_rng(s)) for s in (1, 1, 2))

    assert one == same
    assert one != other


def test_moves_that_have_no_room_are_refused(room: Room) -> None:
    with pytest.raises(
        CairnError,
        match=r"of 10 objects only 0 can be moved by 30 m .* "
        "not 1;",
    ):
        room.moves(1, 30.0, 1.0, np.random.default_rng(0))


def test_the_robot_is_carried_to_where_it_can_drive(room: Room) -> None:
    for seed in range(5):
        x, y, _ = room.somewhere(0.3, np.random.default_rng(seed))
        changed = read_world(ROOM)
        event = Event.model_validate({"at": 1, "kidnap": {"x": x, "y": y}})
        assert world_problems(changed.model_copy(update={"events": [event]}), 0.22) == []
        assert 0.3 <= x <= 8.7
        assert 0.3 <= y <= 6.7
