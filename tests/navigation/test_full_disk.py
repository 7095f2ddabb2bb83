"""The robot drives while its disk is full: no component ends, and all is saved afterwards."""

import json
import resource
from pathlib import Path

import pytest

from cairn.visual_map.landmark_store import open_landmarks
from tests.navigation.processes import ObservedRobot, robot_in

pytestmark = [pytest.mark.xdist_group("robots in real time"), pytest.mark.processes]

REPORT = """
stop_limit_s: 70
components:
  report:
    plugin: report
    parameters: {directory: "${report}"}
    restart: transient
    stop_timeout_s: 60
  mobile_supervisor:
    children:
      automove: {parameters: {load_plugins: on_request}}
"""
SAVED_AGAIN = ("visual map", "mission", "report journal", "state of the world", "last pose")


def limit_files(robot: ObservedRobot, size: int) -> None:
    """Have no process of the run write beyond `size` [bytes] of any file, or lift that with -1."""
    for pid in robot.run.pids():
        _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, most))


def stored_evidence(report: Path) -> int:
    with open_landmarks(report / "visual_map.cairn", read_only=True) as store:
        return sum(len(store.evidence_of(one.object_id)) for one in store.landmarks())


@pytest.mark.accuracy
def test_robot_drives_while_its_disk_is_full_and_saves_all_when_there_is_room(
    tmp_path: Path,
) -> None:
    overlay = tmp_path / "report.yaml"
    overlay.write_text(REPORT)
    with robot_in(tmp_path, overlays=[overlay]) as robot:
        report = robot.run.report
        robot.run.await_line("child active: report")  # the last one at start
        limit_files(robot, 0)  # also while AutoMove's components start, for the first goal
        assert robot.go("2.2", "1.1", "0").await_end() == 0
        assert not (report / "visual_map.cairn").exists()
        journal = (report / "record.jsonl").stat().st_size

        limit_files(robot, resource.RLIM_INFINITY)
        for subject in SAVED_AGAIN:
            robot.run.await_line(f"{subject} saved again")
        assert stored_evidence(report) > 0
        assert (report / "record.jsonl").stat().st_size > journal
        assert robot.run.stop() == 0

    lines = robot.run.lines
    assert not [one for one in lines if "restarting child" in one or "child failed" in one]
    summary = json.loads((report / "report.json").read_text())
    assert [mission["state"] for mission in summary["missions"]] == ["succeeded"]
    assert summary["collisions"] == []
    assert summary["position_rmse_m"] < 0.2
