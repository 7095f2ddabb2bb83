"""Components replay an MRCLAM data set, and continue after a restart where the replay is."""

import math
from pathlib import Path

import numpy as np
import pytest

from cairn import SECOND, from_ns, to_ns
from cairn.components.replay_devices.components import ReplayOdometry, ReplayRecognizer, ReplayTruth
from cairn.components.replay_devices.mrclam import MrclamDataset, integrate_commands
from cairn.components.replay_devices.pacing import ReplayClock
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.rosgraph_msgs import Clock
from tests.components.replay_devices.conftest import start
from tests.wording import assert_words

pytestmark = pytest.mark.slow


def test_odometry_is_published_at_its_recorded_time(dataset: Path) -> None:
    rows = MrclamDataset(dataset).odometry(2)
    harness = start(ReplayOdometry, rows[0, 0], recording=str(dataset), robot=2)

    harness.run_for(5.0)

    sent = harness.take("odom")
    due = rows[rows[:, 0] <= rows[0, 0] + 5.0]
    assert [to_ns(o.header.stamp) for o in sent] == [round(t * 1e6) * 1000 for t in due[:, 0]]
    assert [o.twist.twist.linear.x for o in sent] == due[:, 1].tolist()
    assert [o.twist.twist.angular.z for o in sent] == due[:, 2].tolist()


def test_restarted_component_skips_past_records_and_keeps_its_frame(dataset: Path) -> None:
    rows = MrclamDataset(dataset).odometry(2)
    at = rows[0, 0] + 300.0
    harness = start(ReplayOdometry, at, recording=str(dataset), robot=2)

    harness.run_for(1.0)

    first = harness.take("odom")[0]
    index = int(np.searchsorted(rows[:, 0], at - 0.5))
    assert to_ns(first.header.stamp) / SECOND == pytest.approx(rows[index, 0])
    assert first.pose.pose.position.x == pytest.approx(integrate_commands(rows)[0][index, 0])
    assert math.sqrt(first.pose.covariance[0]) > 1.0


def test_observations_of_one_time_make_one_message_without_robots(dataset: Path) -> None:
    table = MrclamDataset(dataset).observations(5)
    subjects = MrclamDataset(dataset).subjects()
    harness = start(ReplayRecognizer, table.time[0], recording=str(dataset), robot=5)

    harness.run_for(60.0)

    messages = harness.take("objects")
    stamps = [to_ns(m.header.stamp) for m in messages]
    due = [
        (t, subjects[b])
        for t, b in zip(table.time.tolist(), table.barcode.tolist(), strict=True)
        if t <= table.time[0] + 60.0 and subjects.get(b, 0) >= 6
    ]
    assert len(set(stamps)) == len(stamps) == len({t for t, _ in due})
    assert [o.object_id for m in messages for o in m.objects] == [subject for _, subject in due]


def test_unknown_barcode_is_warned_of_once_and_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "Barcodes.dat").write_text("6 63\n")
    records = "".join(f"{100 + k}.0 {code} 2.0 0.1\n" for k, code in enumerate([63, 99, 99, 63]))
    (tmp_path / "Robot1_Measurement.dat").write_text(records)
    harness = start(ReplayRecognizer, 100.0, recording=str(tmp_path), robot=1)

    harness.run_for(10.0)

    assert [m.objects[0].object_id for m in harness.take("objects")] == [6, 6]
    (warning,) = (r.message for r in caplog.records if "barcode" in r.message)
    assert_words(warning, "barcode 99", "Barcodes.dat", "ignored")


def test_truth_is_thinned_and_the_surveyed_map_published(dataset: Path) -> None:
    first, _ = MrclamDataset(dataset).span(2)
    harness = start(ReplayTruth, first, recording=str(dataset), robot=2)

    harness.run_for(10.0)

    assert 40 <= len(harness.take("truth")) <= 101
    (surveyed,) = harness.take("true_map")
    assert {o.object_id for o in surveyed.objects} == set(range(6, 21))


def test_clock_runs_at_its_rate_to_the_end_of_the_recording(dataset: Path) -> None:
    first, last = MrclamDataset(dataset).span(2)
    harness = start(ReplayClock, 1000.0, recording=str(dataset), robot=2, rate=100.0, tick_s=0.5)

    harness.run_for(0.5 + (last - first) / 100.0 + 0.1)

    times = [to_ns(m.clock) / SECOND for m in harness.take("time")]
    assert times[0] == pytest.approx(first)
    assert np.diff(times) == pytest.approx(np.full(len(times) - 1, 0.5))
    assert last < times[-1] <= last + 1.6
    assert harness.ends == [ExitReport(True, "the recording is at its end")]


def test_restarted_clock_continues_where_the_replay_is(dataset: Path) -> None:
    first, _ = MrclamDataset(dataset).span(2)
    harness = start(ReplayClock, 1000.0, recording=str(dataset), robot=2, rate=10.0)
    reached = round((first + 200.0) * SECOND)
    harness.publish("reached", Clock(clock=from_ns(reached)))

    harness.run_for(1.0)

    times = [to_ns(m.clock) for m in harness.take("time")]
    assert reached < times[0] < reached + SECOND
