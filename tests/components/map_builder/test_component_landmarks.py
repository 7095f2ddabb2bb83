"""Tests of the component's landmarks: map, changes, restart, relocalization."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError, from_ns
from cairn.components.map_builder.component import MapBuilder
from cairn.schemas.cairn_msgs import (
    ObjectEvidence,
    ObjectEvidenceArray,
    VisualMap,
    VisualMapChange,
    VisualObject,
)
from cairn.schemas.cairn_nav_msgs import Relocalization
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.new_map import write_map
from tests.components.map_builder.evidence import surveyed
from tests.disk import fill, room_for, small_disk
from tests.wording import assert_words, words_in_order


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.map"
    write_map(path, "a test", [surveyed(6), surveyed(7)])
    return path


def frame(
    step: int, similarity: float, x: float, object_ids: Iterable[int] = (7,)
) -> ObjectEvidenceArray:
    verdict = ObjectEvidence.AGREES if similarity >= 0.5 else ObjectEvidence.DISAGREES
    piece = ObjectEvidence(
        object_id=0,
        similarity=similarity,
        verdict=verdict,
        distance=3.0,
        x=x,
        y=1.0,
        covariance=np.array([0.02, 0.0, 0.0, 0.02]),
        range=2.0,
        bearing=0.1,
    )
    header = Header(stamp=from_ns((1000 + step) * 10**9), frame_id="map")
    pieces = tuple(replace(piece, object_id=one) for one in object_ids)
    return ObjectEvidenceArray(header=header, robot_x=0.3 * step, healthy=True, evidence=pieces)


def relocalization(stamp: int, confirmed_until: int = 0) -> Relocalization:
    header = Header(stamp=from_ns(stamp * 10**9), frame_id="map")
    return Relocalization(header=header, confirmed_until=from_ns(confirmed_until * 10**9))


def states(it: Any) -> dict[int, int]:
    return {o.object_id: o.state for o in it.take("visual_map")[-1].objects}


def test_map_is_published_at_start(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)

    (first,) = it.take("visual_map")

    assert [o.object_id for o in first.objects] == [6, 7]
    assert {o.reliability for o in first.objects} == {0.5}
    assert first.version == 2


def test_moved_landmark_is_removed_and_registered(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)

    it.publish("object_evidence", frame(0, 0.1, 3.5))
    assert states(it)[7] == VisualObject.RELOCATING
    for step in range(1, 4):
        it.publish("object_evidence", frame(step, 0.9, 3.5))

    changes = it.take("visual_map_changes")
    assert [c.kind for c in changes[:2]] == [VisualMapChange.REMOVED, VisualMapChange.REGISTERED]
    assert np.isnan(changes[0].new_x)
    assert changes[1].old_x == 2.0
    assert changes[1].new_x == pytest.approx(3.5, abs=0.05)
    assert states(it)[7] == VisualObject.LIVE


def test_why_returns_the_chain_of_evidence_and_counts_the_steps_before(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    for step in range(4):
        it.publish("object_evidence", frame(step, 0.9 if step else 0.1, 3.5))

    answer = it.request("why", object="landmark 7", last=2)

    assert answer["object"]["object_id"] == 7
    assert "is at (3.50, 1.00) m" in answer["now"]
    assert "REGISTERED" in " ".join(step["text"] for step in answer["steps"])
    assert (len(answer["steps"]), answer["left_out"] > 2) == (2, True)
    with pytest.raises(CairnError, match=words_in_order("99", "7 (landmark 7)")):
        it.request("why", object=99)
    with pytest.raises(CairnError, match=words_in_order("last", "-1", "1 to")):
        it.request("why", object=7, last=-1)


def test_restarted_map_builder_keeps_its_changes(map_file: Path) -> None:
    copy = map_file.with_name("copy.map")
    parameters = {"map_file": str(map_file), "working_copy": str(copy)}
    it = ComponentHarness(MapBuilder, parameters, start_s=1000.0)
    it.publish("object_evidence", frame(0, 0.1, 3.5))

    again = ComponentHarness(MapBuilder, parameters, start_s=1001.0)

    assert states(again)[7] == VisualObject.RELOCATING


def accepted(
    object_id: int, name: str = "found 1", x: float = 4.0, variance: float = 0.01
) -> VisualObject:
    covariance = np.array([variance, 0.0, 0.0, 0.01])
    return VisualObject(
        object_id=object_id, name=name, x=x, y=1.0, covariance=covariance, reliability=0.5
    )


def test_accepted_objects_become_landmarks_once(map_file: Path) -> None:
    parameters = {"map_file": str(map_file), "learn_unknown": False}
    it = ComponentHarness(MapBuilder, parameters, start_s=1000.0)
    it.take("visual_map")

    it.publish("accepted_objects", VisualMap(objects=(accepted(9), accepted(7, x=5.0))))

    (newest,) = it.take("visual_map")
    (change,) = it.take("visual_map_changes")
    assert [(o.object_id, o.name, o.x, o.reliability) for o in newest.objects if o.x > 2] == [
        (9, "found 1", 4.0, 0.5)
    ]
    assert (change.object_id, change.kind, change.new_x) == (9, VisualMapChange.REGISTERED, 4.0)
    assert np.isnan(change.old_x)
    with open_landmarks(map_file, read_only=True) as store:  # on the disk before it is published
        assert [one.object_id for one in store.landmarks()] == [6, 7, 9]
    it.publish("accepted_objects", VisualMap(objects=(accepted(9, x=5.0),)))
    assert it.take("visual_map") == it.take("visual_map_changes") == []


@pytest.mark.parametrize(
    "wrong", [accepted(9, x=1e9), accepted(9, name="a" * 2000), accepted(9, variance=1e9)]
)
def test_accepted_object_that_the_file_cannot_hold_is_refused(
    map_file: Path, wrong: VisualObject
) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)

    it.publish("accepted_objects", VisualMap(objects=(wrong,)))

    assert 9 not in states(it)
    open_landmarks(map_file, read_only=True).close()


def test_judgments_of_a_lost_robot_are_undone(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    it.publish("object_evidence", frame(0, 0.1, 3.5))

    it.publish("relocalized", relocalization(1010))

    kinds = [c.kind for c in it.take("visual_map_changes")]
    assert kinds == [VisualMapChange.REMOVED, VisualMapChange.RESTORED]
    assert states(it)[7] == VisualObject.LIVE


def test_judgments_before_the_loss_are_kept(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    it.publish("object_evidence", frame(0, 0.1, 3.5))

    it.publish("relocalized", relocalization(1010, confirmed_until=1001))

    assert [c.kind for c in it.take("visual_map_changes")] == [VisualMapChange.REMOVED]
    assert states(it)[7] == VisualObject.RELOCATING


def test_old_judgments_are_kept(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    it.publish("object_evidence", frame(0, 0.1, 3.5))

    it.publish("relocalized", relocalization(1061))

    assert states(it)[7] == VisualObject.RELOCATING


def test_late_evidence_of_a_lost_robot_is_ignored(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)

    it.publish("relocalized", relocalization(1005))
    it.publish("object_evidence", frame(5, 0.1, 3.5))
    assert it.take("visual_map_changes") == []

    it.publish("object_evidence", frame(6, 0.1, 3.5))
    assert states(it)[7] == VisualObject.RELOCATING


def test_evidence_counts_after_the_clock_was_set_back(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)

    it.publish("relocalized", relocalization(1100))
    it.publish("object_evidence", frame(5, 0.1, 3.5))

    assert states(it)[7] == VisualObject.RELOCATING


def test_invalid_map_file_fails_configuration(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.map"
    wrong.write_text("nothing of the kind")
    it = ComponentHarness(MapBuilder, {"map_file": str(wrong)}, start_s=1000.0, activate=False)

    with pytest.raises(CairnError, match=r"wrong\.map.*damaged or not a map"):
        it.activate()


def test_evidence_is_saved_once_a_full_disk_has_room(
    map_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    with room_for(1000):
        it.publish("object_evidence", frame(0, 0.9, 2.0))
        it.run_for(3.0)

    assert it.ends == []
    assert_words(caplog.text, "visual map", "not saved")

    it.run_for(2.0)

    with open_landmarks(map_file, read_only=True) as kept:
        counts = {one.object_id: one.evidence_count for one in kept.landmarks()}
    assert counts == {6: 0, 7: 1}


def stored(path: Path) -> tuple[list[str], int]:
    with open_landmarks(path, read_only=True) as store:
        return [change[3] for change in store.history()], len(store.evidence_of(7))


@pytest.mark.parametrize("closed", [True, False])
def test_full_disk_neither_fails_the_map_builder_nor_loses_a_change(
    map_file: Path, tmp_path: Path, closed: bool, caplog: pytest.LogCaptureFixture
) -> None:
    with small_disk(tmp_path / "disk", 2 << 20) as disk:
        copy = disk / "copy.map"
        config = {"map_file": str(map_file), "working_copy": str(copy)}
        first = ComponentHarness(MapBuilder, config, start_s=1000.0)
        first.publish("object_evidence", frame(0, 0.9, 2.0))
        first.run_for(1.5)
        if closed:  # SQLite has removed its lock file, and finds no room for another one
            first.request("deactivate")
        ballast = fill(disk)

        it = ComponentHarness(MapBuilder, config, start_s=1002.0)
        assert len(it.take("visual_map")[-1].objects) == 2
        for step in (3, 4):
            it.publish("object_evidence", frame(step, 0.1, 3.5))
        assert states(it)[7] == VisualObject.RELOCATING
        it.run_for(5.0)
        for step in range(8, 11):
            it.publish("object_evidence", frame(step, 0.9, 3.5))
        assert [change.version for change in it.take("visual_map_changes")] == [3, 4]
        it.run_for(10.0)
        assert it.ends == []
        assert_words(caplog.text, "copy.map", "free some space", "changes", "evidence are lost")
        assert stored(copy)[0] == ["IMPORTED"] * 2

        ballast.unlink()
        it.run_for(11.0)

        kinds, pieces = stored(copy)
        assert kinds[:4] == ["IMPORTED", "IMPORTED", "REMOVED", "REGISTERED"]
        assert pieces == 6
        assert it.runtime.status().reason == ""
        it.request("deactivate")


def test_working_copy_is_made_once_a_full_disk_has_room(map_file: Path, tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 2 << 20) as disk:
        ballast, copy = fill(disk), disk / "copy.map"
        it = ComponentHarness(
            MapBuilder, {"map_file": str(map_file), "working_copy": str(copy)}, start_s=1000.0
        )
        it.publish("object_evidence", frame(3, 0.1, 3.5))
        assert states(it)[7] == VisualObject.RELOCATING
        assert not copy.exists()

        ballast.unlink()
        it.run_for(11.0)

        assert stored(copy) == (["IMPORTED", "IMPORTED", "REMOVED"], 1)
        it.request("deactivate")


def test_forged_evidence_about_endless_objects_fills_neither_memory_nor_disk(
    map_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = {"map_file": str(map_file), "max_landmarks": 20}
    it = ComponentHarness(MapBuilder, config, start_s=1000.0)
    for step in range(20):
        it.publish("object_evidence", frame(step, 0.9, 2.0, range(100 * step, 100 * step + 100)))
    for step in (20, 21):
        it.publish("object_evidence", frame(step, 0.1, 3.5))
    it.run_for(1.5)

    assert states(it)[7] == VisualObject.RELOCATING  # landmarks of the map are judged as ever
    with open_landmarks(map_file, read_only=True) as kept:
        ids = [one.object_id for one in kept.landmarks()]
        stored_ids = [one for one in range(2000) if kept.evidence_of(one)]
    assert len(ids) == 20
    assert set(stored_ids) <= set(ids)
    warnings = [one.getMessage() for one in caplog.records if "map is full" in one.getMessage()]
    assert len(warnings) == 5  # the 1st, 2nd, 4th, 8th and 16th
    assert_words(warnings[0], "20 landmarks", "max_landmarks", "did not learn object 99")


def test_evidence_about_an_object_that_is_not_learned_is_not_kept(map_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    for step in range(50):
        unhealthy = replace(frame(step, 0.9, 2.0, [1000 + step]), healthy=False)
        it.publish("object_evidence", unhealthy)
    it.run_for(1.5)

    with open_landmarks(map_file, read_only=True) as kept:
        assert not any(kept.evidence_of(1000 + step) for step in range(50))


def test_evidence_about_an_endless_position_does_not_make_the_map_unreadable(
    map_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    it = ComponentHarness(MapBuilder, {"map_file": str(map_file)}, start_s=1000.0)
    for step in range(10):
        it.publish("object_evidence", frame(step, 0.0, 1e300, (7, 8)))
    it.run_for(1.5)
    it.request("deactivate")

    with open_landmarks(map_file, read_only=True) as kept:
        assert {one.object_id for one in kept.landmarks()} == {6, 7}
    assert_words(caplog.text, "refused evidence about object 8", "1e+07 m")
