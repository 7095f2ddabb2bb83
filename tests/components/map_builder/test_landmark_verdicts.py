"""Tests of absence: landmarks not seen from where they used to be seen are removed."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.map_builder.landmark_map import LandmarkMap
from cairn.components.map_builder.landmark_registration import record_departure
from cairn.components.map_builder.undo import MOST_ENTRIES, LandmarkJournal
from cairn.components.map_builder.viewpoints import (
    add_absence,
    add_recognition,
    cell_of,
    similarity_of_absence,
)
from cairn.planar.poses import Pose
from cairn.visual_map.landmarks import (
    NO_HISTORY,
    NO_VIEWPOINTS,
    ChangeKind,
    EvidenceVerdict,
    LandmarkEvidence,
    LandmarkState,
    MapPosition,
)
from tests.components.map_builder.evidence import HERE, THERE, surveyed

IN_FRONT = [(0.1 + 0.45 * step, 0.6, 0.0) for step in range(3)]


def evidence(
    verdict: EvidenceVerdict, robot: Pose, implied: MapPosition = HERE
) -> LandmarkEvidence:
    similarity = 0.9 if verdict is EvidenceVerdict.AGREES else 0.5
    return LandmarkEvidence(7, similarity, verdict, 0.0, implied, robot, healthy=True)


def seen_often(landmark_map: LandmarkMap) -> None:
    for _ in range(4):
        for pose in IN_FRONT:
            landmark_map.apply([evidence(EvidenceVerdict.AGREES, pose)], 0.0)


def missed(landmark_map: LandmarkMap, poses: list[Pose], times: int) -> list[ChangeKind]:
    return [
        change.kind
        for _ in range(times)
        for pose in poses
        for change in landmark_map.apply([evidence(EvidenceVerdict.UNSEEN, pose)], 0.0).changes
    ]


def test_missing_landmark_is_removed_after_several_absences() -> None:
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)

    assert missed(landmark_map, IN_FRONT, 1) == []
    assert missed(landmark_map, IN_FRONT, 4) == [ChangeKind.REMOVED]

    assert landmark_map.landmarks[7].state is LandmarkState.RELOCATING
    assert landmark_map.landmarks[7].candidate is None


def test_missing_landmark_is_removed_with_the_reason_not_seen() -> None:
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)

    reasons = [
        change.reason
        for pose in IN_FRONT * 5
        for change in landmark_map.apply([evidence(EvidenceVerdict.UNSEEN, pose)], 0.0).changes
    ]

    assert len(reasons) == 1
    assert "not seen" in reasons[0]


def test_returned_landmark_is_restored_at_its_position() -> None:
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)
    assert missed(landmark_map, IN_FRONT, 5) == [ChangeKind.REMOVED]

    near = MapPosition(HERE.x + 0.1, HERE.y, 0.02, 0.0, 0.02)
    kinds = [
        change.kind
        for pose in IN_FRONT
        for change in landmark_map.apply(
            [evidence(EvidenceVerdict.AGREES, pose, near)], 0.0
        ).changes
    ]

    assert kinds == [ChangeKind.RESTORED]
    place = landmark_map.landmarks[7].position
    assert place is not None
    assert place.distance(HERE) < 0.01


def test_absence_from_unknown_viewpoint_does_not_count() -> None:
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)
    behind = [(3.9, 0.9 + 0.5 * step, 0.0) for step in range(3)]

    assert missed(landmark_map, behind, 10) == []

    assert landmark_map.landmarks[7].reliability > 0.9


def test_standing_robot_counts_an_absence_once() -> None:
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)

    assert missed(landmark_map, IN_FRONT[:1], 100) == []

    assert landmark_map.landmarks[7].reliability > 0.9


def test_often_missed_landmark_stays() -> None:
    """Two of three recognitions fail, as in bad light; the counts of viewpoints learn that."""
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)
    kinds: list[ChangeKind] = []
    for _ in range(40):
        kinds += missed(landmark_map, IN_FRONT[:2], 1)
        kinds += [
            c.kind
            for c in landmark_map.apply(
                [evidence(EvidenceVerdict.AGREES, IN_FRONT[2])], 0.0
            ).changes
        ]

    assert ChangeKind.REMOVED not in kinds


def test_landmark_without_position_is_never_missing() -> None:
    landmark_map = LandmarkMap([])

    assert missed(landmark_map, IN_FRONT, 3) == []

    assert landmark_map.landmarks == {}


def test_moved_landmark_has_new_viewpoints() -> None:
    landmark_map = LandmarkMap([surveyed()])
    seen_often(landmark_map)
    for step in range(12):
        moved = LandmarkEvidence(
            7, 0.1, EvidenceVerdict.DISAGREES, 9.0, THERE, (0.2 * step, 0.0, 0.0), healthy=True
        )
        landmark_map.apply([moved], 0.0)
    assert landmark_map.landmarks[7].position is not None
    assert landmark_map.landmarks[7].position.distance(THERE) < 0.2

    assert missed(landmark_map, IN_FRONT, 10) == []


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=60), st.integers(0, 2))
def test_absence_never_increases_reliability(outcomes: list[tuple[int, bool]], last: int) -> None:
    viewpoints = NO_VIEWPOINTS
    for look, seen in outcomes:
        cell = cell_of(HERE.x, HERE.y, IN_FRONT[look])
        viewpoints = (add_recognition if seen else add_absence)(viewpoints, cell)

    similarity = similarity_of_absence(viewpoints, cell_of(HERE.x, HERE.y, IN_FRONT[last]))

    assert similarity is None or 0.3 <= similarity <= 0.51


@pytest.mark.parametrize("robot", [(3.0, 1.0, 0.0), (1.0, 1.0, 2.0), (2.0, 1.0, 0.0)])
def test_every_robot_pose_has_a_viewpoint_cell(robot: Pose) -> None:
    sector, band = cell_of(HERE.x, HERE.y, robot)

    assert 0 <= sector < 12
    assert band >= 0


def test_what_is_remembered_of_viewpoints_departures_and_judgments_is_bounded() -> None:
    cells = {cell_of(0.0, 0.0, (10.0**far, 0.0, 0.0)) for far in range(300)}
    assert len(cells) <= 31
    history = NO_HISTORY
    for number in range(100):
        history = record_departure(history, HERE, number * 0.1)
    assert len(history.departures) == 20
    assert history.departures[-1] == (HERE, 9.9)
    journal = LandmarkJournal(60.0)
    before = surveyed()
    for number in range(MOST_ENTRIES + 1000):
        journal.record(number * 1e-4, before, replace(before, reliability=0.1))
    assert len(journal._entries) == MOST_ENTRIES
