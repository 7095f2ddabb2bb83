"""What a report says of a run, whatever of it came."""

import json
from pathlib import Path
from typing import Any

import pytest

from cairn.components.run_outputs import report as report_module
from cairn.components.run_outputs.report import Report
from cairn.components.run_outputs.table import render_table
from cairn.planar.messages import pose_message
from cairn.schemas.cairn_msgs import VisualMap, VisualObject
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.path_planner.rooms import pose_at, seconds
from tests.patience import LIMIT_S

BEGIN = 100.0


@pytest.fixture
def report(tmp_path: Path) -> Any:
    return ComponentHarness(Report, {"directory": str(tmp_path)}, start_s=BEGIN)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures, which are drawn in a process of their own."""
    monkeypatch.setattr(report_module, "draw_pictures", lambda *_: "")


def finished(harness: Any, folder: Path) -> tuple[dict[str, Any], str]:
    """The report at the end of a run: its values, and its text."""
    harness.request("deactivate")
    values = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return values, (folder / "report.txt").read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_run_without_poses_has_the_duration_of_its_clock(report: Any, tmp_path: Path) -> None:
    report.run_for(12.0)

    values, text = finished(report, tmp_path)

    assert values["recorded_s"] == pytest.approx(12.0, abs=0.2)
    assert values["first_pose_s"] is None
    assert text.startswith("the localizer published no pose\n12 s recorded")


@pytest.mark.usefixtures("undrawn")
def test_run_continues_after_the_last_pose(report: Any, tmp_path: Path) -> None:
    report.publish("truth", truth_at(BEGIN))
    report.publish("localization", pose_at((0.0, 0.1, 0.0), BEGIN))
    report.run_for(30.0)

    values, text = finished(report, tmp_path)

    assert (values["recorded_s"], values["first_pose_s"]) == (30.0, 0.0)
    assert text.startswith("position error 0.100 m rms")


@pytest.mark.usefixtures("undrawn")
def test_run_without_truth_is_reported(report: Any, tmp_path: Path) -> None:
    report.publish("localization", pose_at((0.0, 0.1, 0.0), BEGIN))

    _, text = finished(report, tmp_path)

    assert text.startswith("no truth to compare the poses with\n")


@pytest.mark.usefixtures("undrawn")
def test_run_without_clock_has_no_duration(tmp_path: Path) -> None:
    values, text = finished(ComponentHarness(Report, {"directory": str(tmp_path)}), tmp_path)

    assert (values["recorded_s"], values["wall_s"]) == (0.0, None)
    assert "0 s recorded; dropped: none" in text


def truth_at(time: float) -> PoseStamped:
    header = Header(stamp=seconds(time), frame_id="map")
    return PoseStamped(header=header, pose=pose_message((0.0, 0.0, 0.0)))


@pytest.mark.usefixtures("undrawn")
def test_journal_holds_only_objects_that_have_changed(report: Any, tmp_path: Path) -> None:
    def visual_map(at_s: float, reliability: float) -> VisualMap:
        objects = tuple(
            VisualObject(
                object_id=number, x=0.1 * number, reliability=reliability if number == 3 else 0.5
            )
            for number in range(100)
        )
        return VisualMap(header=Header(stamp=seconds(at_s)), objects=objects)

    journal = tmp_path / "record.jsonl"
    report.publish("visual_map", visual_map(BEGIN, 0.5))
    size = journal.stat().st_size
    for number in range(100):
        report.publish("visual_map", visual_map(BEGIN + number, 0.6 + 0.001 * number))

    assert journal.stat().st_size < size + 100 * 100
    values, _ = finished(report, tmp_path)
    assert [values["objects"][number]["reliability"] for number in (2, 3)] == [0.5, 0.699]


def test_pictures_are_drawn_after_the_run(
    report: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.components.run_outputs.drawing._LIMIT_S", LIMIT_S)
    report.publish("localization", pose_at((0.0, 0.1, 0.0), BEGIN))

    finished(report, tmp_path)

    for name in ("map.png", "reliability.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_report_without_matplotlib_says_what_installs_it(
    report: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    hidden = tmp_path / "hidden" / "matplotlib"
    hidden.mkdir(parents=True)
    text = "raise ModuleNotFoundError(\"No module named 'matplotlib'\", name='matplotlib')"
    (hidden / "__init__.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(hidden.parent))
    monkeypatch.setattr("cairn.components.run_outputs.drawing._LIMIT_S", LIMIT_S)

    finished(report, tmp_path)

    assert not (tmp_path / "map.png").exists()
    reason = "matplotlib is not installed; pip install 'cairn-robotics[plots]'"
    assert f"the report has no pictures: {reason}" in caplog.text


@pytest.mark.parametrize(
    ("wall_s", "dropped", "reported"), [(10.0, 3, True), (10.0, 0, False), (100.0, 3, False)]
)
def test_replay_that_was_too_fast_for_the_computer_is_reported_with_the_remedy(
    wall_s: float, dropped: int, reported: bool
) -> None:
    summary = {
        "objects": [], "missions": [], "dropped": {"localizer.odom": dropped},
        "recorded_s": 100.0, "wall_s": wall_s, "first_pose_s": None,
    }  # fmt: skip

    assert ("replay more slowly, or with --lockstep" in render_table(summary)) == reported
