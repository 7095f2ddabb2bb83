"""Random moves are possible in the world: along the walls, apart, and visible."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.components.simulation.world_checks import world_problems
from cairn.components.simulation.world_file import Event, read_world
from cairn_lab.experiments.random_changes import RandomChanges

ROOM = Path(__file__).parents[3] / "deploy" / "worlds" / "room.yaml"


@pytest.fixture(scope="module")
def changes() -> RandomChanges:
    return RandomChanges(ROOM)


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 10_000), distance=st.sampled_from([None, 0.3, 1.0, 2.0]))
def test_objects_are_moved_by_the_specified_distance_and_stay_apart(
    changes: RandomChanges, seed: int, distance: float | None
) -> None:
    world = read_world(ROOM)
    events = changes.draw_moves(4, distance, 5.0, np.random.default_rng(seed))
    world_with_events = world.model_copy(
        update={"events": [Event.model_validate(one) for one in events]}
    )

    assert world_problems(world_with_events, 0.22) == []
    assert len({event["move"] for event in events}) == 4
    names = {thing.display_name: (thing.x, thing.y) for thing in world.objects}
    positions = dict(names)
    for event in events:
        to = (event["to"]["x"], event["to"]["y"])
        moved = math.dist(to, names[event["move"]])
        assert moved >= 0.6 if distance is None else moved == pytest.approx(distance, abs=0.031)
        positions[event["move"]] = to
        assert event["at"] == 5.0
    apart = [math.dist(a, b) for i, a in positions.items() for j, b in positions.items() if i < j]
    assert min(apart) >= 0.35


def test_same_seed_draws_the_same_moves(changes: RandomChanges) -> None:
    one, same, other = (
        changes.draw_moves(2, None, 1.0, np.random.default_rng(s)) for s in (1, 1, 2)
    )

    assert one == same
    assert one != other


def test_impossible_moves_are_rejected(changes: RandomChanges) -> None:
    with pytest.raises(
        CairnError,
        match=r"room\.yaml: only 0 of 10 objects can be moved by 30 m .*not 1;",
    ):
        changes.draw_moves(1, 30.0, 1.0, np.random.default_rng(0))


def test_kidnapped_robot_is_put_where_it_can_drive(changes: RandomChanges) -> None:
    for seed in range(5):
        x, y, _ = changes.draw_kidnap_pose(0.3, np.random.default_rng(seed))
        changed = read_world(ROOM)
        event = Event.model_validate({"at": 1, "kidnap": {"x": x, "y": y}})
        assert world_problems(changed.model_copy(update={"events": [event]}), 0.22) == []
        assert 0.3 <= x <= 8.7
        assert 0.3 <= y <= 6.7
