"""The localizer with a scanner on the bus: bad scans, bad odometry, other maps, and no sensors."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn import from_ns
from cairn.components.localizer.component import Localizer
from cairn.planar.grid import FREE, OCCUPIED, Frame, Grid, OccupancyCells, map_message
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose, compose
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.geometry_msgs import PoseWithCovariance, PoseWithCovarianceStamped
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.localizer.room import Moment, apart, drive, room
from tests.wording import assert_words

BEGIN = 1000.0
AT: Pose = (2.0, 2.0, 0.0)
START = {"x": AT[0], "y": AT[1], "theta": AT[2], "position_sd": 0.02, "heading_sd": 0.02}
BEAMS, STEP = 241, math.radians(1.0)


def header(time: float, frame: str) -> Header:
    return Header(stamp=from_ns(round((BEGIN + time) * 1e6) * 1000), frame_id=frame)


def odometry(time: float, pose: Pose) -> Odometry:
    return Odometry(
        header=header(time, "odom"),
        child_frame_id="base_link",
        pose=PoseWithCovariance(pose=pose_message(pose)),
    )


def ranges_of(moment: Moment) -> NDArray[np.float32]:
    ranges = np.full(BEAMS, np.inf, np.float32)
    angles = np.arctan2(moment.points[:, 1], moment.points[:, 0])
    places = np.rint((angles + BEAMS // 2 * STEP) / STEP).astype(int)
    ranges[np.clip(places, 0, BEAMS - 1)] = np.hypot(moment.points[:, 0], moment.points[:, 1])
    return ranges


def scan(time: float, ranges: NDArray[np.float32]) -> LaserScan:
    step = STEP * (BEAMS - 1) / max(1, ranges.size - 1)
    return LaserScan(
        header=header(time, "laser"),
        angle_min=-(BEAMS // 2) * STEP,
        angle_max=(BEAMS // 2) * STEP,
        angle_increment=step,
        range_min=0.05,
        range_max=8.0,
        ranges=ranges,
    )


def grid_message(grid: OccupancyCells) -> Any:
    return map_message(header(0.0, "map"), grid, Time())


def start_localizer(
    start: dict[str, float] | None = START, mapped: bool = True
) -> ComponentHarness[Localizer]:
    localizer = ComponentHarness(
        Localizer, {"start": start, "search_particles": 5000}, start_s=BEGIN
    )
    if mapped:
        localizer.publish("map", grid_message(room()))
    return localizer


def travel(
    localizer: ComponentHarness[Localizer],
    moments: Iterable[Moment],
    change: Callable[[NDArray[np.float32]], NDArray[np.float32] | None] = lambda ranges: ranges,
    shift: Pose = (0.0, 0.0, 0.0),
) -> None:
    """Publish odometry and scans in time; `change` alters each scan, None omits it."""
    for moment in moments:
        localizer.run_for(max(0.0, BEGIN + moment.time - localizer.now))
        localizer.publish("odom", odometry(moment.time, compose(shift, moment.odometry)))
        ranges = change(ranges_of(moment))
        if ranges is not None:
            localizer.publish("scan", scan(moment.time, ranges))


def moments_of_drive(seconds: float = 12.0, seed: int = 0) -> list[Moment]:
    return list(drive(room(), AT, seconds, seed))


def last_error(localizer: ComponentHarness[Localizer], moments: list[Moment]) -> float:
    message = localizer.take("pose")[-1]
    stamp = message.header.stamp
    time = stamp.sec + stamp.nanosec / 1e9 - BEGIN
    moment = min(moments, key=lambda m: abs(m.time - time))
    return apart(planar_pose(message.pose.pose), moment.pose)[0]


def last_health(localizer: ComponentHarness[Localizer]) -> Any:
    return localizer.take("localization")[-1]


def test_each_scan_gives_an_estimate_with_its_stamp() -> None:
    localizer, moments = start_localizer(), moments_of_drive()

    travel(localizer, moments)

    poses, healths = localizer.take("pose"), localizer.take("localization")
    assert [p.header.stamp for p in poses] == [h.header.stamp for h in healths]
    assert len(poses) >= 0.95 * len(moments)
    assert healths[-1].health > 0.9


def test_robot_with_unknown_start_is_found_by_scans() -> None:
    localizer, moments = start_localizer(None), moments_of_drive()

    travel(localizer, moments)

    assert last_error(localizer, moments) < 0.1
    healths = localizer.take("localization")
    assert not healths[0].located
    assert healths[-1].health > 0.9


@pytest.mark.parametrize(
    ("ranges", "word"),
    [
        (np.full(BEAMS, np.nan, np.float32), "invalid scan on /robot/scan"),
        (np.full(BEAMS, np.inf, np.float32), "invalid scan on /robot/scan"),
        (np.zeros(0, np.float32), "invalid scan on /robot/scan"),
        (np.full(BEAMS, -np.inf, np.float32), "invalid scan on /robot/scan"),
    ],
)
def test_invalid_scans_leave_odometry(
    ranges: NDArray[np.float32], word: str, caplog: pytest.LogCaptureFixture
) -> None:
    localizer, moments = start_localizer(), moments_of_drive(6.0)

    travel(localizer, moments[:30])
    travel(localizer, moments[30:], lambda _: ranges)

    assert last_error(localizer, moments) < 0.2
    assert word in caplog.text
    health = last_health(localizer)
    assert health.health <= 0.2
    assert "no valid scan on /robot/scan for" in health.reason


def test_number_of_beams_may_change() -> None:
    localizer, moments = start_localizer(), moments_of_drive()
    numbers = iter(np.tile([BEAMS, 61, 21, 1], len(moments)))

    travel(
        localizer,
        moments,
        lambda ranges: ranges[:: (BEAMS - 1) // max(1, next(numbers) - 1)].copy(),
    )

    assert last_error(localizer, moments) < 0.1


def test_odometry_jump_is_logged_and_ignored(caplog: pytest.LogCaptureFixture) -> None:
    localizer, moments = start_localizer(), moments_of_drive()

    travel(localizer, moments[:60])
    travel(localizer, moments[60:], shift=(30.0, -20.0, 2.0))

    assert "odometry on /robot/odom jumped" in caplog.text
    assert last_error(localizer, moments) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_odometry_that_is_late_and_out_of_order_is_sorted(
    seed: int, caplog: pytest.LogCaptureFixture
) -> None:
    random = np.random.default_rng(seed)
    localizer, moments = start_localizer(), moments_of_drive(seed=seed)
    events: list[tuple[float, str, Any]] = []
    for moment in moments:
        message = odometry(moment.time, moment.odometry)
        if random.random() >= 0.02:
            events.append((moment.time + float(random.uniform(0.0, 0.3)), "odom", message))
        events.append((moment.time, "scan", scan(moment.time, ranges_of(moment))))

    for time, topic, message in sorted(events, key=lambda event: event[0]):
        localizer.run_for(max(0.0, BEGIN + time - localizer.now))
        localizer.publish(topic, message)

    poses = localizer.take("pose")
    errors = [
        apart(planar_pose(pose.pose.pose), moment.pose)[0]
        for pose in poses
        for moment in moments
        if header(moment.time, "").stamp == pose.header.stamp
    ]
    assert len(errors) > 0.9 * len(moments)
    assert max(errors) < 0.1
    assert "/robot/odom" not in caplog.text


def test_outdated_messages_are_ignored(caplog: pytest.LogCaptureFixture) -> None:
    localizer, moments = start_localizer(), moments_of_drive()
    travel(localizer, moments[:60])

    localizer.publish("odom", odometry(1.0, (9.0, 9.0, 1.0)))
    localizer.publish("scan", scan(1.0, ranges_of(moments[10])))
    travel(localizer, moments[60:])

    assert "runs backwards" in caplog.text
    assert "message on /robot/scan of 1001.000 s ignored: it is " in caplog.text
    assert last_error(localizer, moments) < 0.1


def test_localizer_continues_after_time_was_set_back(caplog: pytest.LogCaptureFixture) -> None:
    localizer, moments = start_localizer(), moments_of_drive()
    travel(localizer, moments[:60])

    for moment in moments[60:]:  # the clock of the robot was 500 s fast
        localizer.publish("odom", odometry(moment.time - 500.0, moment.odometry))
        localizer.publish("scan", scan(moment.time - 500.0, ranges_of(moment)))
    shown = localizer.take("pose")[-1]

    assert_words(caplog.text, "/robot/odom", "set back", "49")
    assert caplog.text.count("was set back") == 1
    assert shown.header.stamp.sec == int(BEGIN + moments[-1].time - 500.0)
    assert apart(planar_pose(shown.pose.pose), moments[-1].pose)[0] < 0.1


def test_scans_ahead_of_the_clock_are_logged_and_dropped(caplog: pytest.LogCaptureFixture) -> None:
    localizer, moments = start_localizer(), moments_of_drive()
    travel(localizer, moments[:60])

    localizer.publish("scan", scan(86_400.0, ranges_of(moments[60])))
    travel(localizer, moments[60:])

    assert_words(caplog.text, "ahead of the clock", "clock of its driver")
    assert last_error(localizer, moments) < 0.1


def test_scan_without_odometry_gives_no_transform() -> None:
    localizer, moments = start_localizer(), moments_of_drive()
    travel(localizer, moments[:60])
    before = localizer.take("tf")[-1].transforms[0]

    # It begins before odometry does after its jump.
    localizer.publish("scan", scan(moments[60].time, ranges_of(moments[60])))
    localizer.publish("odom", odometry(moments[60].time + 0.05, (30.0, -20.0, 2.0)))

    for message in localizer.take("tf"):
        for transform in message.transforms:
            moved = np.hypot(
                transform.transform.translation.x - before.transform.translation.x,
                transform.transform.translation.y - before.transform.translation.y,
            )
            assert moved < 0.1 or moved > 20.0


@pytest.mark.parametrize("variance", [-1.0, 0.0])
def test_odometry_without_covariance_is_accepted(variance: float) -> None:
    localizer = start_localizer()
    first = odometry(0.0, (0.0, 0.0, 0.0))
    covariance = np.zeros(36)
    covariance[[0, 7, 35]] = variance
    stated = PoseWithCovariance(pose=first.pose.pose, covariance=covariance)

    localizer.publish("odom", replace(first, pose=stated))
    localizer.publish("odom", odometry(0.2, (0.0, 0.0, 0.0)))

    assert planar_pose(localizer.take("pose")[-1].pose.pose) == pytest.approx(AT, abs=0.05)


def test_operator_pose_needs_no_covariance() -> None:
    localizer, moments = start_localizer(None), moments_of_drive()
    none = np.zeros(36)
    for given in (none, np.where(np.arange(36) == 7, -1.0, none)):
        localizer.publish("odom", odometry(0.0, moments[0].odometry))
        localizer.publish(
            "initialpose",
            PoseWithCovarianceStamped(
                header=header(0.0, "map"),
                pose=PoseWithCovariance(
                    pose=pose_message((AT[0] + 0.3, AT[1], 0.1)), covariance=given
                ),
            ),
        )

    travel(localizer, moments)

    assert last_error(localizer, moments) < 0.1


def test_map_of_another_size_replaces_the_first() -> None:
    localizer, moments = start_localizer(), moments_of_drive()
    travel(localizer, moments[:60])
    small = room()
    cells = np.full((small.values.shape[0] + 40, small.values.shape[1] + 60), FREE, np.int8)
    cells[20:-20, 20:-40] = small.values

    localizer.publish("map", grid_message(Grid(cells, Frame(0.05, (-1.0, -1.0, 0.0)))))
    travel(localizer, moments[60:])

    assert last_error(localizer, moments) < 0.1
    assert last_health(localizer).health > 0.9


def update(x: int, y: int, values: NDArray[np.int8]) -> OccupancyGridUpdate:
    rows, columns = values.shape
    return OccupancyGridUpdate(
        header=header(0.0, "map"), x=x, y=y, width=columns, height=rows, data=values.ravel()
    )


def test_updates_renew_the_map_and_those_off_it_are_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    # The map lacks the box in the middle until the updates arrive.
    localizer, moments = start_localizer(mapped=False), moments_of_drive()
    boxes = ((1.0, 5.0, 2.2, 5.6), (7.2, 0.0, 9.0, 1.2))
    localizer.publish("map", grid_message(room(boxes)))

    localizer.publish("map_updates", update(80, 60, np.full((12, 30), OCCUPIED, np.int8)))
    localizer.publish("map_updates", update(170, 0, np.full((10, 30), FREE, np.int8)))
    localizer.publish("map_updates", update(-3, 0, np.full((10, 30), FREE, np.int8)))
    travel(localizer, moments)

    assert "it leaves the map" in caplog.text
    assert last_error(localizer, moments) < 0.1
    assert last_health(localizer).health > 0.9


def test_update_before_any_map_is_ignored() -> None:
    localizer, moments = start_localizer(mapped=False), moments_of_drive(3.0)

    localizer.publish("map_updates", update(0, 0, np.full((10, 30), FREE, np.int8)))
    travel(localizer, moments)

    assert last_error(localizer, moments) < 0.1


def test_pose_without_sensors_follows_odometry() -> None:
    localizer, moments = start_localizer(), moments_of_drive(6.0)

    travel(localizer, moments, lambda _: None)

    assert last_error(localizer, moments) < 0.2
    health = last_health(localizer)
    assert health.health <= 0.5
    assert "no scan on /robot/scan" in health.reason


def test_operator_pose_locates_a_lost_robot() -> None:
    localizer, moments = start_localizer(None), moments_of_drive()
    travel(localizer, moments[:30], lambda _: np.full(BEAMS, np.inf, np.float32))
    assert localizer.take("pose") == []
    covariance = np.zeros(36)
    covariance[[0, 7, 35]] = 0.01

    operator_pose = PoseWithCovariance(pose=pose_message(moments[29].pose), covariance=covariance)
    localizer.publish(
        "initialpose", PoseWithCovarianceStamped(header=header(3.0, "map"), pose=operator_pose)
    )
    travel(localizer, moments[30:])

    assert last_error(localizer, moments) < 0.1
    assert last_health(localizer).health > 0.9


def test_wrong_operator_pose_is_corrected() -> None:
    localizer, moments = start_localizer(), moments_of_drive(25.0)
    travel(localizer, moments[:30])
    covariance = np.zeros(36)
    covariance[[0, 7, 35]] = 0.01

    operator_pose = PoseWithCovariance(pose=pose_message((7.0, 5.5, 2.5)), covariance=covariance)
    localizer.publish(
        "initialpose", PoseWithCovarianceStamped(header=header(3.0, "map"), pose=operator_pose)
    )
    travel(localizer, moments[30:])

    assert last_error(localizer, moments) < 0.1
    assert localizer.take("relocalized")
