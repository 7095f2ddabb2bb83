"""Recorded messages survive the death of the report's process, and a full disk."""

import json
from pathlib import Path
from typing import Any

import pytest

from cairn import RetriedSave
from cairn.components.run_outputs import run_journal
from cairn.components.run_outputs.report import Report
from cairn.components.run_outputs.run_journal import RunJournal
from cairn.components.run_outputs.run_record import RunRecord
from cairn.testing.lockstep import ComponentHarness
from tests.disk import room_for

NAN = float("nan")


def record_messages(journal: RunJournal) -> None:
    journal.write("record_start", 100.0, 10**9)
    journal.write("record_true_position", 3, 1.0, 2.0)
    journal.write(
        "record_map", 10**9, [[3, "box", 1.0, 2.0, "live", 0.5], [4, "can", NAN, NAN, "live", 0.5]]
    )
    journal.write("record_estimate", 10**9, 0.5, 0.25, 0.1)
    journal.write("record_truth", 10**9, 0.5, 0.5, 0.1)
    journal.write("record_removal", 2 * 10**9, 3, 1.0, 2.0)
    journal.write("record_mission", 7, [[1.0, 2.0, 0.5]])
    journal.write("record_port_counters", "base.cmd_vel", 0, 7, 1)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "record.jsonl"


class Owner:
    """The component of the journals of a test."""

    def __init__(self) -> None:
        self.harness = ComponentHarness(Report, {}, start_s=1000.0)

    def journal(self, record: RunRecord, file: Path, *, resume: bool = False) -> RunJournal:
        saved = RetriedSave(self.harness.component, "report journal")
        return RunJournal(record, file, saved, resume=resume)


@pytest.fixture
def owner() -> Owner:
    return Owner()


def test_restarted_report_replays_its_journal(owner: Owner, file: Path) -> None:
    before = RunRecord()
    record_messages(owner.journal(before, file))
    with file.open("a") as stream:
        stream.write('["record_estimate", 3000000000, 0.')  # killed while it wrote

    after = RunRecord()
    journal = owner.journal(after, file, resume=True)
    journal.write("record_port_counters", "base.cmd_vel", 1, 2, 0)

    assert after.object(3) == before.object(3)
    assert (after.estimate, after.truth, after.begin) == (before.estimate, before.truth, 10**9)
    summary = after.summary(130.0)
    assert (summary["wall_s"], summary["position_rmse_m"]) == (30.0, 0.25)
    assert (summary["dropped"], summary["invalid"]) == ({"base.cmd_vel": 9}, {"base.cmd_vel": 1})
    again = RunRecord()
    owner.journal(again, file, resume=True)
    assert again == after
    journal.remove()
    assert not file.exists()


@pytest.mark.parametrize(
    "line",
    [
        "[" * 100_000,
        '["record_estimate", "now", 0.5, 0.25, 0.1]',
        '["record_estimate", 2000000000, [0.5], 0.25, 0.1]',
        '["record_map", 1, [[1]]]',
        '["record_removal", 1e999, 3, 1.0, 2.0]',
        '["__init__"]',
        "\0\0\0\0",
    ],
    ids=["nested", "text", "list", "objects", "infinite", "method", "zeros"],
)
def test_invalid_line_of_a_journal_is_skipped(owner: Owner, file: Path, line: str) -> None:
    before = RunRecord()
    record_messages(owner.journal(before, file))
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:2], line, *lines[2:]]) + "\n")

    after = RunRecord()
    owner.journal(after, file, resume=True)

    assert after == before


def test_first_report_ignores_the_journal_of_another_run(owner: Owner, file: Path) -> None:
    record_messages(owner.journal(RunRecord(), file))

    record = RunRecord()
    owner.journal(record, file)

    assert record == RunRecord()


def test_repeated_maps_are_not_recorded_twice(owner: Owner, file: Path) -> None:
    record = RunRecord()
    journal = owner.journal(record, file)
    for stamp, reliability in ((1, 0.5), (2, 0.7), (1, 0.5)):
        journal.write("record_map", stamp, [[3, "box", 1.0, 2.0, "live", reliability]])

    assert record.object(3).history == [(1, 0.5), (2, 0.7)]
    assert record.object(3).reliability == 0.7


def test_full_disk_delays_the_journal_and_loses_nothing(
    owner: Owner, file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record = RunRecord()
    journal = owner.journal(record, file)
    with room_for(file.stat().st_size + 60):  # the second line fits in part
        for stamp in range(100):
            journal.write("record_estimate", stamp, 0.0, 0.0, 0.0)
    warnings = [one for one in caplog.records if "report journal not saved" in one.getMessage()]
    assert len(warnings) == 1
    owner.harness.run_for(1.1)  # the next attempt is due
    journal.write("record_estimate", 100, 0.0, 0.0, 0.0)

    assert record.estimate.stamps == [*range(101)]
    again = RunRecord()
    owner.journal(again, file, resume=True)
    assert again == record


@pytest.mark.accuracy
def test_report_starts_on_a_full_disk(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with room_for(0):
        harness = ComponentHarness(Report, {"directory": str(tmp_path / "out")}, start_s=1000.0)
        harness.run_for(0.5)
    assert "report journal not saved" in caplog.text
    harness.run_for(2.0)
    harness.request("deactivate")

    assert json.loads((tmp_path / "out" / "report.json").read_text())["recorded_s"] > 2.0


def test_long_journal_becomes_one_line_with_the_state_of_the_record(
    owner: Owner, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_journal, "SLACK_BYTES", 2_000)
    record = RunRecord()
    journal = owner.journal(record, file)
    largest = 0
    for number in range(1000):
        journal.write("record_port_counters", "base.cmd_vel", 0, number, 0)
        largest = max(largest, file.stat().st_size)

    assert largest < 3_000
    again = RunRecord()
    owner.journal(again, file, resume=True)
    assert again == record


@pytest.mark.parametrize(
    "line", ['["summary", 1.0]', '["__init__"]', '["state", {"begin": "x"}]', "[]", "7", '"state"']
)
def test_line_that_no_report_writes_is_ignored(owner: Owner, file: Path, line: str) -> None:
    file.write_text(line + "\n")
    record = RunRecord()
    owner.journal(record, file, resume=True)

    assert record == RunRecord()


def drive_for_days(record: RunRecord) -> None:
    """Record 200,000 s of everything that a robot, or a hostile peer, repeats."""
    for second in range(20_000):
        stamp = second * 10**9
        record.record_truth(stamp, second * 0.1, 0.0, 0.0)
        record.record_estimate(stamp, second * 0.1, 0.5, 0.0)
        if second % 4 == 0:
            reliability = (second % 100) / 100
            record.record_map(stamp, [(second % 2000, "x" * 9999, 1.0, 2.0, "live", reliability)])
            record.record_registration(stamp, second % 3)
            record.record_mission(second, [(1.0, 2.0, 3.0)] * 20)
            record.record_progress(second, "succeeded", 20, "arrived", 3.0, 0)
            record.record_collision(stamp, "chair", 1.0, 2.0, 0.1)
            record.record_port_counters(f"forged{second}.port", 0, 1, 0)
            record.record_port_counters("base.cmd_vel", second, 1, 0)


def test_record_of_days_is_bounded_and_its_figures_are_exact() -> None:
    record = RunRecord()
    drive_for_days(record)
    size = len(run_journal._RECORD.dump_json(record))
    summary: dict[str, Any] = record.summary(None)

    assert size < 3_000_000
    assert summary["position_rmse_m"] == summary["position_error_max_m"] == 0.5
    assert summary["driven_m"] == pytest.approx(1999.9)
    assert summary["dropped"]["base.cmd_vel"] == 5_000
    assert len(summary["missions"]) + summary["earlier_missions"]["succeeded"] == 5_000
    assert len(summary["collisions"]) + summary["omitted"]["collisions"] == 5_000
    assert summary["missions"][-1]["mission_id"] == 19_996
    assert len(record.truth.to_draw()) > 2_000
