"""Recorded messages survive the death of the report's process."""

import logging
import resource
from pathlib import Path

import pytest

from cairn.components.report.run_record import RunJournal, RunRecord

LOG = logging.getLogger("test")
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
    journal.write("record_port_counters", "base.cmd_vel", 0, 7, 1)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "record.jsonl"


def test_restarted_report_replays_its_journal(file: Path) -> None:
    before = RunRecord()
    record_messages(RunJournal(before, file, LOG, resume=False))
    with file.open("a") as stream:
        stream.write('["record_estimate", 3000000000, 0.')  # killed while it wrote

    after = RunRecord()
    journal = RunJournal(after, file, LOG, resume=True)
    journal.write("record_port_counters", "base.cmd_vel", 1, 2, 0)

    assert after.object(3) == before.object(3)
    assert (after.estimate, after.truth, after.begin) == (before.estimate, before.truth, 10**9)
    summary = after.summary(130.0)
    assert (summary["wall_s"], summary["position_rmse_m"]) == (30.0, 0.25)
    assert (summary["dropped"], summary["invalid"]) == ({"base.cmd_vel": 9}, {"base.cmd_vel": 1})
    journal.remove()
    assert not file.exists()


def test_first_report_ignores_the_journal_of_another_run(file: Path) -> None:
    record_messages(RunJournal(RunRecord(), file, LOG, resume=False))

    record = RunRecord()
    RunJournal(record, file, LOG, resume=False)

    assert record == RunRecord()


def test_repeated_maps_are_not_recorded_twice(file: Path) -> None:
    record = RunRecord()
    journal = RunJournal(record, file, LOG, resume=False)
    for stamp, reliability in ((1, 0.5), (2, 0.7), (1, 0.5)):
        journal.write("record_map", stamp, [[3, "box", 1.0, 2.0, "live", reliability]])

    assert record.object(3).history == [(1, 0.5), (2, 0.7)]
    assert record.object(3).reliability == 0.7


def test_full_disk_loses_only_the_journal(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    record = RunRecord()
    file.symlink_to("/dev/full")
    journal = RunJournal(record, file, LOG, resume=False)

    journal.write("record_estimate", 5, 0.0, 0.0, 0.0)
    journal.write("record_estimate", 6, 0.0, 0.0, 0.0)

    assert record.estimate_stamps == [5, 6]
    assert len([one for one in caplog.records if "No space left" in one.getMessage()]) == 1


def test_report_restarted_on_a_full_disk_continues(
    file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    RunJournal(RunRecord(), file, LOG, resume=False).write("record_estimate", 5, 0.0, 0.0, 0.0)
    record = RunRecord()

    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size, unlimited[1]))
    try:
        RunJournal(record, file, LOG, resume=True).write("record_estimate", 6, 0.0, 0.0, 0.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)

    assert record.estimate_stamps == [5, 6]
    assert len([one for one in caplog.records if "cannot be written" in one.getMessage()]) == 1
