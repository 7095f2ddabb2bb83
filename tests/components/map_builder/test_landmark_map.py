"""Tests of the landmark map: moved landmarks are removed and registered, others stay."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.map_builder.landmark_map import LandmarkMap
from cairn.visual_map.landmarks import ChangeKind, EvidenceVerdict, LandmarkState, MapPosition
from tests.components.map_builder.evidence import HERE, THERE, observation, surveyed


def kinds(landmark_map: LandmarkMap, *frames: object) -> list[ChangeKind]:
    return [change.kind for frame in frames for change in landmark_map.apply([frame], 0.0).changes]  # type: ignore[list-item]


def test_agreement_increases_reliability() -> None:
    landmark_map = LandmarkMap([surveyed()])

    for step in range(5):
        landmark_map.apply([observation(0.9, step)], 0.0)

    assert landmark_map.landmarks[7].reliability == pytest.approx(0.98)
    assert landmark_map.landmarks[7].evidence_count == 5


def test_observations_from_one_pose_count_once() -> None:
    landmark_map = LandmarkMap([surveyed()])

    for _ in range(50):
        landmark_map.apply([observation(0.1, 0, THERE), observation(0.9, 0)], 0.0)

    assert landmark_map.landmarks[7].evidence_count == 1


def test_repeated_disagreement_from_one_pose_does_not_remove_a_landmark() -> None:
    landmark_map = LandmarkMap([surveyed()])
    agreed = [observation(0.9, step) for step in range(3)]

    changes = kinds(landmark_map, *agreed, *[observation(0.1, 3, THERE)] * 20)

    assert changes == []
    assert landmark_map.landmarks[7].evidence_count == 4


def test_moved_landmark_is_removed_and_registered_at_its_new_position() -> None:
    landmark_map = LandmarkMap([surveyed()])
    agreed = [observation(0.9, step) for step in range(3)]
    moved = [observation(0.1, step, THERE) for step in range(3, 6)]
    seen_there = [observation(0.9, step, THERE) for step in range(6, 12)]

    seen = kinds(landmark_map, *agreed, *moved, *seen_there)

    known = landmark_map.landmarks[7]
    assert seen[:2] == [ChangeKind.REMOVED, ChangeKind.REGISTERED]
    assert known.state is LandmarkState.LIVE
    assert known.position is not None
    assert known.position.distance(THERE) < 0.05
    assert known.reliability > 0.5


def test_uncorroborated_disagreements_count_once_corroborated() -> None:
    landmark_map = LandmarkMap([surveyed()])
    agreed = [observation(0.9, step) for step in range(4)]
    alone = [observation(0.1, step, THERE, corroborated=False) for step in range(4, 6)]

    assert kinds(landmark_map, *agreed, *alone) == []
    assert landmark_map.landmarks[7].reliability > 0.95
    assert kinds(landmark_map, observation(0.1, 6, THERE)) == [ChangeKind.REMOVED]


def test_uncorroborated_disagreements_are_forgotten_after_agreement() -> None:
    landmark_map = LandmarkMap([surveyed()])
    agreed = [observation(0.9, step) for step in range(4)]
    errors = [
        *(observation(0.1, step, THERE, corroborated=False) for step in (4, 5)),
        observation(0.9, 6),
    ]

    assert kinds(landmark_map, *agreed, *errors, observation(0.1, 7, THERE)) == []
    assert landmark_map.landmarks[7].reliability > 0.8


def test_landmark_is_not_registered_by_the_image_that_removed_it() -> None:
    landmark_map = LandmarkMap([surveyed()])

    changes = landmark_map.apply([observation(0.1, 0, THERE)], 0.0).changes

    assert [c.kind for c in changes] == [ChangeKind.REMOVED]
    assert landmark_map.landmarks[7].reliability <= 0.1 + 1e-9
    candidate = landmark_map.landmarks[7].candidate
    assert candidate is not None
    assert candidate.reliability == pytest.approx(0.1)


def test_moving_candidate_is_never_registered() -> None:
    landmark_map = LandmarkMap([surveyed()])
    carried = [
        observation(0.1, step, MapPosition(3.0 + 1.0 * step, 1.0, 0.02, 0.0, 0.02))
        for step in range(20)
    ]

    assert kinds(landmark_map, *carried) == [ChangeKind.REMOVED]
    assert landmark_map.landmarks[7].state is LandmarkState.RELOCATING


def test_object_that_alternates_between_positions_is_ignored() -> None:
    """Two identical posters, one of which has a model, are seen in turn."""
    landmark_map = LandmarkMap([surveyed()])
    reasons = []
    for step in range(60):
        place = HERE if step // 10 % 2 == 0 else THERE
        agrees = landmark_map.landmarks[7].position is not None and (
            landmark_map.landmarks[7].position.distance(place) < 0.3
        )
        frame = [
            observation(
                0.9 if agrees else 0.1, step, MapPosition(place.x, place.y, 0.02, 0.0, 0.02)
            )
        ]
        reasons += [(c.kind, c.reason) for c in landmark_map.apply(frame, float(step)).changes]

    assert "two things look alike" in reasons[-1][1]
    assert [kind for kind, _ in reasons if kind is ChangeKind.REGISTERED] == [
        ChangeKind.REGISTERED
    ] * 2
    assert landmark_map.landmarks[7].state is LandmarkState.RELOCATING


def test_ignored_object_is_registered_again_after_ten_minutes() -> None:
    landmark_map = LandmarkMap([surveyed()])
    for step in range(60):
        place = HERE if step // 10 % 2 == 0 else THERE
        known = landmark_map.landmarks[7].position
        agrees = known is not None and known.distance(place) < 0.3
        landmark_map.apply([observation(0.9 if agrees else 0.1, step, place)], float(step))
    before = landmark_map.landmarks[7].state

    for step in range(60, 66):
        landmark_map.apply([observation(0.5, step, THERE)], 700.0)

    assert (before, landmark_map.landmarks[7].state) == (
        LandmarkState.RELOCATING,
        LandmarkState.LIVE,
    )


def test_wrongly_removed_landmark_is_restored_at_its_position() -> None:
    landmark_map = LandmarkMap([surveyed()])
    near = MapPosition(2.1, 1.1, 0.02, 0.0, 0.02)

    seen = kinds(
        landmark_map,
        observation(0.1, 0, near),
        *(observation(0.5, step, near) for step in range(1, 5)),
    )

    assert seen == [ChangeKind.REMOVED, ChangeKind.RESTORED]
    assert landmark_map.landmarks[7].position == HERE


def test_unknown_object_is_registered_from_several_poses() -> None:
    landmark_map = LandmarkMap([])

    assert kinds(landmark_map, *(observation(0.5, step, THERE) for step in range(2))) == []
    assert kinds(landmark_map, observation(0.5, 2, THERE)) == [ChangeKind.REGISTERED]
    place = landmark_map.landmarks[7].position
    assert place is not None
    assert place.distance(THERE) < 0.05


def test_learning_of_unknown_objects_can_be_disabled() -> None:
    landmark_map = LandmarkMap([], most_learned=0)

    outcome = landmark_map.apply([observation(0.5, 0, THERE)], 0.0)

    assert outcome.after == (None,)
    assert landmark_map.landmarks == {}


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 1.0),
            st.sampled_from([EvidenceVerdict.FALSE_MATCH, EvidenceVerdict.NOT_CONVERGED]),
        ),
        max_size=40,
    )
)
def test_false_matches_and_lost_robots_do_not_count(
    frames: list[tuple[float, EvidenceVerdict]],
) -> None:
    landmark_map = LandmarkMap([surveyed()])

    for step, (similarity, verdict) in enumerate(frames):
        landmark_map.apply([observation(similarity, step, THERE, verdict, healthy=False)], 0.0)

    assert landmark_map.landmarks[7] == surveyed()


def test_lost_robot_registers_nothing() -> None:
    landmark_map = LandmarkMap([])

    for step in range(10):
        landmark_map.apply([observation(0.5, step, THERE, healthy=False)], 0.0)

    assert landmark_map.landmarks == {}


def test_judgments_of_a_lost_robot_are_undone() -> None:
    landmark_map = LandmarkMap([surveyed()])
    for step in range(4):
        landmark_map.apply([observation(0.9, step)], 0.0)
    before = landmark_map.landmarks[7]
    removed = kinds(landmark_map, *(observation(0.1, step, THERE) for step in range(4, 8)))
    assert removed[0] is ChangeKind.REMOVED

    objects, changes = landmark_map.undo(-1.0)

    assert landmark_map.landmarks[7] == before
    assert objects == [before]
    assert [c.kind for c in changes] == [ChangeKind.RESTORED]


def test_judgments_before_the_loss_are_kept() -> None:
    landmark_map = LandmarkMap([surveyed(7), surveyed(8)])
    landmark_map.apply([observation(0.1, 0, THERE)], 10.0)
    rightly = landmark_map.landmarks[7]
    before = landmark_map.landmarks[8]
    landmark_map.apply([observation(0.1, 1, THERE, object_id=8)], 20.0)
    assert {o.state for o in landmark_map.landmarks.values()} == {LandmarkState.RELOCATING}

    objects, changes = landmark_map.undo(15.0)

    assert objects == [before]
    assert [(c.object_id, c.kind) for c in changes] == [(8, ChangeKind.RESTORED)]
    assert landmark_map.landmarks == {7: rightly, 8: before}


def test_undone_registration_leaves_no_position() -> None:
    landmark_map = LandmarkMap([surveyed()])
    assert kinds(landmark_map, observation(0.1, 0, THERE)) == [ChangeKind.REMOVED]
    landmark_map.apply([], 61.0)  # the removal is too long ago to be undone
    seen = kinds(landmark_map, *(observation(0.5, step, THERE) for step in range(1, 4)))
    assert seen == [ChangeKind.REGISTERED]

    _, changes = landmark_map.undo(-1.0)

    assert landmark_map.landmarks[7].state is LandmarkState.RELOCATING
    assert [(c.kind, c.new) for c in changes] == [(ChangeKind.RESTORED, None)]


def test_agreeing_observations_refine_a_registered_position() -> None:
    landmark_map = LandmarkMap([])
    first = MapPosition(3.8, 1.0, 0.04, 0.0, 0.04)
    for step in range(3):
        landmark_map.apply([observation(0.5, step, first)], 0.0)

    for step in range(3, 30):
        landmark_map.apply([observation(0.9, step, THERE)], 0.0)

    place = landmark_map.landmarks[7].position
    assert place is not None
    assert place.distance(THERE) < 0.1


def test_surveyed_position_is_not_refined() -> None:
    landmark_map = LandmarkMap([surveyed()])

    for step in range(30):
        landmark_map.apply([observation(0.9, step, MapPosition(2.2, 1.2, 0.02, 0.0, 0.02))], 0.0)

    place = landmark_map.landmarks[7].position
    assert place is not None
    assert place.distance(HERE) < 0.05
