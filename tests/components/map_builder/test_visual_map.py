"""The visual map removes what moved, registers where it is now, and keeps what stands still."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.map_builder.objects import Kind, State, Verdict
from cairn.components.map_builder.place import Place
from cairn.components.map_builder.visual_map import VisualMap
from tests.components.map_builder.evidence import HERE, THERE, sighting, surveyed


def kinds(visual_map: VisualMap, *frames: object) -> list[Kind]:
    return [change.kind for frame in frames for change in visual_map.apply([frame], 0.0).changes]  # type: ignore[list-item]


def test_agreement_makes_an_object_reliable() -> None:
    visual_map = VisualMap([surveyed()])

    for step in range(5):
        visual_map.apply([sighting(0.9, step)], 0.0)

    assert visual_map.objects[7].reliability == pytest.approx(0.98)
    assert visual_map.objects[7].evidence_count == 5


def test_sightings_from_one_pose_count_once() -> None:
    visual_map = VisualMap([surveyed()])

    for _ in range(50):
        visual_map.apply([sighting(0.1, 0, THERE), sighting(0.9, 0)], 0.0)

    assert visual_map.objects[7].evidence_count == 1


def test_a_moved_object_is_removed_and_registered_at_its_new_place() -> None:
    visual_map = VisualMap([surveyed()])
    agreed = [sighting(0.9, step) for step in range(3)]
    moved = [sighting(0.1, step, THERE) for step in range(3, 6)]
    seen_there = [sighting(0.9, step, THERE) for step in range(6, 12)]

    seen = kinds(visual_map, *agreed, *moved, *seen_there)

    known = visual_map.objects[7]
    assert seen[:2] == [Kind.REMOVED, Kind.REGISTERED]
    assert known.state is State.LIVE
    assert known.place is not None
    assert known.place.distance(THERE) < 0.05
    assert known.reliability > 0.5


def test_disagreements_that_stood_alone_count_once_others_bear_them_out() -> None:
    visual_map = VisualMap([surveyed()])
    agreed = [sighting(0.9, step) for step in range(4)]
    alone = [sighting(0.1, step, THERE, corroborated=False) for step in range(4, 6)]

    assert kinds(visual_map, *agreed, *alone) == []
    assert visual_map.objects[7].reliability > 0.95
    assert kinds(visual_map, sighting(0.1, 6, THERE)) == [Kind.REMOVED]


def test_disagreements_that_stood_alone_are_forgotten_when_it_agrees_again() -> None:
    visual_map = VisualMap([surveyed()])
    agreed = [sighting(0.9, step) for step in range(4)]
    errors = [
        *(sighting(0.1, step, THERE, corroborated=False) for step in (4, 5)),
        sighting(0.9, 6),
    ]

    assert kinds(visual_map, *agreed, *errors, sighting(0.1, 7, THERE)) == []
    assert visual_map.objects[7].reliability > 0.8


def test_a_removed_object_is_not_registered_by_the_frame_that_removed_it() -> None:
    visual_map = VisualMap([surveyed()])

    changes = visual_map.apply([sighting(0.1, 0, THERE)], 0.0).changes

    assert [c.kind for c in changes] == [Kind.REMOVED]
    assert visual_map.objects[7].reliability <= 0.1 + 1e-9
    candidate = visual_map.objects[7].candidate
    assert candidate is not None
    assert candidate.reliability == pytest.approx(0.1)


def test_a_candidate_that_keeps_moving_is_never_registered() -> None:
    visual_map = VisualMap([surveyed()])
    carried = [
        sighting(0.1, step, Place(3.0 + 1.0 * step, 1.0, 0.02, 0.0, 0.02)) for step in range(20)
    ]

    assert kinds(visual_map, *carried) == [Kind.REMOVED]
    assert visual_map.objects[7].state is State.RELOCATING


def test_an_object_that_is_now_here_now_there_is_two_that_look_alike() -> None:
    """Two posters of one kind, of which one was taught: each is seen in turn."""
    visual_map = VisualMap([surveyed()])
    reasons = []
    for step in range(60):
        place = HERE if step // 10 % 2 == 0 else THERE
        agrees = visual_map.objects[7].place is not None and (
            visual_map.objects[7].place.distance(place) < 0.3
        )
        frame = [sighting(0.9 if agrees else 0.1, step, Place(place.x, place.y, 0.02, 0.0, 0.02))]
        reasons += [(c.kind, c.reason) for c in visual_map.apply(frame, float(step)).changes]

    assert "two things look alike" in reasons[-1][1]
    assert [kind for kind, _ in reasons if kind is Kind.REGISTERED] == [Kind.REGISTERED] * 2
    assert visual_map.objects[7].state is State.RELOCATING


def test_after_ten_minutes_an_object_that_seemed_to_be_two_gets_a_place_again() -> None:
    visual_map = VisualMap([surveyed()])
    for step in range(60):
        place = HERE if step // 10 % 2 == 0 else THERE
        known = visual_map.objects[7].place
        agrees = known is not None and known.distance(place) < 0.3
        visual_map.apply([sighting(0.9 if agrees else 0.1, step, place)], float(step))
    before = visual_map.objects[7].state

    for step in range(60, 66):
        visual_map.apply([sighting(0.5, step, THERE)], 700.0)

    assert (before, visual_map.objects[7].state) == (State.RELOCATING, State.LIVE)


def test_an_object_removed_by_mistake_is_restored_to_its_surveyed_place() -> None:
    visual_map = VisualMap([surveyed()])
    near = Place(2.1, 1.1, 0.02, 0.0, 0.02)

    seen = kinds(
        visual_map, sighting(0.1, 0, near), *(sighting(0.5, step, near) for step in range(1, 5))
    )

    assert seen == [Kind.REMOVED, Kind.RESTORED]
    assert visual_map.objects[7].place == HERE


def test_an_object_that_the_map_lacks_is_learned_from_several_poses() -> None:
    visual_map = VisualMap([])

    assert kinds(visual_map, *(sighting(0.5, step, THERE) for step in range(2))) == []
    assert kinds(visual_map, sighting(0.5, 2, THERE)) == [Kind.REGISTERED]
    place = visual_map.objects[7].place
    assert place is not None
    assert place.distance(THERE) < 0.05


def test_unknown_objects_can_be_left_alone() -> None:
    visual_map = VisualMap([], learn_unknown=False)

    outcome = visual_map.apply([sighting(0.5, 0, THERE)], 0.0)

    assert outcome.after == (None,)
    assert visual_map.objects == {}


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 1.0),
            st.sampled_from([Verdict.FALSE_MATCH, Verdict.NOT_CONVERGED]),
        ),
        max_size=40,
    )
)
def test_nothing_is_judged_by_false_matches_or_a_lost_robot(
    frames: list[tuple[float, Verdict]],
) -> None:
    visual_map = VisualMap([surveyed()])

    for step, (similarity, verdict) in enumerate(frames):
        visual_map.apply([sighting(similarity, step, THERE, verdict, healthy=False)], 0.0)

    assert visual_map.objects[7] == surveyed()


def test_a_lost_robot_registers_nothing() -> None:
    visual_map = VisualMap([])

    for step in range(10):
        visual_map.apply([sighting(0.5, step, THERE, healthy=False)], 0.0)

    assert visual_map.objects == {}


def test_what_a_lost_robot_judged_is_taken_back() -> None:
    visual_map = VisualMap([surveyed()])
    for step in range(4):
        visual_map.apply([sighting(0.9, step)], 0.0)
    before = visual_map.objects[7]
    removed = kinds(visual_map, *(sighting(0.1, step, THERE) for step in range(4, 8)))
    assert removed[0] is Kind.REMOVED

    objects, changes = visual_map.take_back(-1.0)

    assert visual_map.objects[7] == before
    assert objects == [before]
    assert [c.kind for c in changes] == [Kind.RESTORED]


def test_what_was_judged_before_the_robot_was_lost_stays() -> None:
    visual_map = VisualMap([surveyed(7), surveyed(8)])
    visual_map.apply([sighting(0.1, 0, THERE)], 10.0)
    rightly = visual_map.objects[7]
    before = visual_map.objects[8]
    visual_map.apply([sighting(0.1, 1, THERE, object_id=8)], 20.0)
    assert {o.state for o in visual_map.objects.values()} == {State.RELOCATING}

    objects, changes = visual_map.take_back(15.0)

    assert objects == [before]
    assert [(c.object_id, c.kind) for c in changes] == [(8, Kind.RESTORED)]
    assert visual_map.objects == {7: rightly, 8: before}


def test_a_registration_taken_back_leaves_the_object_without_a_place() -> None:
    visual_map = VisualMap([surveyed()])
    assert kinds(visual_map, sighting(0.1, 0, THERE)) == [Kind.REMOVED]
    visual_map.apply([], 61.0)  # the removal is too long ago to be taken back
    seen = kinds(visual_map, *(sighting(0.5, step, THERE) for step in range(1, 4)))
    assert seen == [Kind.REGISTERED]

    _, changes = visual_map.take_back(-1.0)

    assert visual_map.objects[7].state is State.RELOCATING
    assert [(c.kind, c.new) for c in changes] == [(Kind.RESTORED, None)]


def test_a_registered_place_gets_better_with_agreeing_sightings() -> None:
    visual_map = VisualMap([])
    first = Place(3.8, 1.0, 0.04, 0.0, 0.04)
    for step in range(3):
        visual_map.apply([sighting(0.5, step, first)], 0.0)

    for step in range(3, 30):
        visual_map.apply([sighting(0.9, step, THERE)], 0.0)

    place = visual_map.objects[7].place
    assert place is not None
    assert place.distance(THERE) < 0.1


def test_a_surveyed_place_stays_as_surveyed() -> None:
    visual_map = VisualMap([surveyed()])

    for step in range(30):
        visual_map.apply([sighting(0.9, step, Place(2.2, 1.2, 0.02, 0.0, 0.02))], 0.0)

    place = visual_map.objects[7].place
    assert place is not None
    assert place.distance(HERE) < 0.05
