"""World and drivers together: truth, odometry, scans and objects agree."""

import hashlib
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cairn import SECOND, SENSOR, CairnError, to_ns
from cairn.bus.codec import Codec
from cairn.components.simulation.base import SimulatedBase
from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.ray_casting import cast
from cairn.components.simulation.scanner import SimulatedScanner
from cairn.components.simulation.world_component import SimulatedWorld
from cairn.components.simulation.world_file import read_world
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose, compose, distance, wrap
from cairn.schemas.cairn_sim_msgs import WheelMotion
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.testing.lockstep import ComponentHarness, Lockstep
from tests.components.simulation.simulation_harness import (
    EXACT,
    MOUNT,
    NO_SLIP,
    OBJECTS,
    TABLE,
    Simulation,
    drive_curves,
    poses_of,
)

Simulate = Callable[..., Simulation]


def test_exact_odometry_equals_the_truth_at_the_same_times(simulate: Simulate) -> None:
    simulation = simulate(furniture=[TABLE], objects=OBJECTS)
    drive_curves(simulation)
    odom, truth = poses_of(simulation.take("odom")), poses_of(simulation.take("truth"))

    together = sorted(set(odom) & set(truth))
    assert len(together) >= 65
    for stamp in together:
        there = compose((3.0, 2.0, 0.0), odom[stamp])
        assert distance(there, truth[stamp]) < 1e-9
        assert wrap(there[2] - truth[stamp][2]) == pytest.approx(0, abs=1e-9)
    way = [distance(truth[a], truth[b]) for a, b in pairwise(together)]
    assert sum(way) > 1.0


def test_each_odometry_message_has_a_transform(simulate: Simulate) -> None:
    simulation = simulate()
    drive_curves(simulation)
    odometry, expected_text = simulation.take("odom"), simulation.take("tf")

    assert len(expected_text) == len(odometry) > 300
    for odom, message in zip(odometry, expected_text, strict=True):
        (transform,) = message.transforms
        assert transform.header == odom.header
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
        place, turned = odom.pose.pose.position, odom.pose.pose.orientation
        assert transform.transform.translation == Vector3(x=place.x, y=place.y)
        assert transform.transform.rotation == turned


def test_odometry_with_random_delays_arrives_late_and_out_of_order() -> None:
    prompt, late = driven_base(), driven_base(odometry_delay_s=0.3)

    ages = np.array([received - stamp for received, stamp, _ in late]) / SECOND
    assert ages.min() >= 0.0
    assert ages.max() <= 0.3 + STEP_S
    assert np.mean(ages) == pytest.approx(0.15 + STEP_S / 2, abs=0.02)
    assert np.mean(np.diff([stamp for _, stamp, _ in late]) < 0) > 0.2
    # The stamps remain those of the measurements.
    measured = {stamp: pose for _, stamp, pose in prompt}
    assert len(late) == len(prompt) > 400
    assert all(pose == measured[stamp] for _, stamp, pose in late)


def test_share_of_odometry_is_lost() -> None:
    share = 1.0 - len(driven_base(odometry_loss=0.2)) / len(driven_base())

    assert share == pytest.approx(0.2, abs=0.06)


STEP_S = 0.02


def driven_base(**parameters: float) -> list[tuple[int, int, Pose]]:
    """Drive for 9 s, and wait; return times of arrival [ns], stamps [ns] and poses of odometry.

    A message that arrives within a step of 20 ms counts as received at its end.
    """
    base = ComponentHarness(SimulatedBase, {**EXACT, **parameters}, start_s=1.0)
    received: list[tuple[int, int, Pose]] = []
    for _ in range(500):
        base.publish("cmd_vel", Twist(linear=Vector3(x=0.4), angular=Vector3(z=0.2)))
        base.run_for(STEP_S)
        odometry, transforms = base.take("odom"), base.take("tf")
        headers = [odom.header for odom in odometry]
        assert [message.transforms[0].header for message in transforms] == headers
        received += [
            (base.now_ns, to_ns(odom.header.stamp), planar_pose(odom.pose.pose))
            for odom in odometry
        ]
    return [one for one in received if one[1] <= 10 * SECOND]


def test_each_beam_starts_at_the_pose_of_the_robot_at_its_time(simulate: Simulate) -> None:
    simulation = simulate(furniture=[TABLE], objects=OBJECTS)
    drive_curves(simulation)
    states = simulation.take("world_state")
    stamps = np.array([to_ns(state.header.stamp) for state in states], float)
    poses = np.array([planar_pose(state.robot) for state in states])
    poses[:, 2] = np.unwrap(poses[:, 2])
    segments = WorldLayout.of(read_world(simulation.file)).solid_segments.segments

    off = []
    for scan in simulation.take("scan"):
        beams = np.arange(scan.ranges.size)
        times = to_ns(scan.header.stamp) + beams * scan.time_increment * SECOND
        if not (stamps[0] <= times[0] and times[-1] <= stamps[-1]):
            continue
        robots = np.column_stack([np.interp(times, stamps, column) for column in poses.T])
        mounted = np.array([compose(tuple(one), (0.1, 0.0, 0.2)) for one in robots.tolist()])
        angles = mounted[:, 2] + scan.angle_min + beams * scan.angle_increment
        true, _ = cast(mounted[:, :2].copy(), angles, segments, np.zeros((0, 3)), 10.0)
        off.append(scan.ranges - true)

    errors = np.concatenate(off)
    assert len(off) >= 65
    # At corners a ray may hit either side.
    assert np.mean(np.abs(errors) < 4 * 0.015) > 0.995
    assert np.median(errors) == pytest.approx(0.0, abs=5e-4)
    assert 1.4826 * np.median(np.abs(errors)) == pytest.approx(0.015, rel=0.03)


def test_scans_have_their_rate_and_the_stamp_of_their_first_beam(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.drive(1.05, 0.0, 0.0)
    scans = simulation.take("scan")

    assert np.diff([to_ns(scan.header.stamp) for scan in scans]) == pytest.approx(SECOND // 10)
    swept_ns = 1080 * scans[0].time_increment * SECOND
    ended = to_ns(scans[0].header.stamp) + swept_ns
    assert ended == pytest.approx(1.1 * SECOND, abs=1000)
    assert scans[0].scan_time == pytest.approx(0.1)


def test_objects_are_observed_at_true_range_and_bearing(simulate: Simulate) -> None:
    simulation = simulate(objects=OBJECTS)
    simulation.drive(3.0, 0.0, 0.4)
    truth = {
        to_ns(state.header.stamp): planar_pose(state.robot)
        for state in simulation.take("world_state")
    }
    expected_text = [one for one in simulation.take("objects") if one.objects]
    seen = [one for one in expected_text if to_ns(one.header.stamp) in truth]

    assert len(seen) >= 4
    for message in seen:
        x, y, theta = truth[to_ns(message.header.stamp)]
        (one,) = message.objects
        assert one.object_id == 1
        assert one.range == pytest.approx(
            math.hypot(6 - x, 2 - y), abs=5 * one.covariance[0] ** 0.5
        )
        bearing = wrap(math.atan2(2 - y, 6 - x) - theta)
        assert wrap(one.bearing - bearing) == pytest.approx(0, abs=5 * one.covariance[3] ** 0.5)


def test_odometry_errors_match_their_covariance_and_speed_is_measured(simulate: Simulate) -> None:
    simulation = simulate(exact=False)
    simulation.drive(2.0, 0.4, 0.3)
    last = simulation.take("odom")[-1]
    covariance = last.pose.covariance.reshape(6, 6)

    assert covariance[0, 0] > 0
    assert covariance[5, 5] > 0
    assert np.all(np.linalg.eigvalsh(covariance[np.ix_([0, 1, 5], [0, 1, 5])]) > 0)
    assert last.twist.twist.linear.x == pytest.approx(0.4, rel=0.05)
    assert last.twist.twist.linear.x != 0.4


def test_robot_stops_without_commands_and_time_passes_without_a_base(simulate: Simulate) -> None:
    simulation = simulate(
        people=[{"name": "ada", "waypoints": [[0.5, 3.5], [5, 3.5]], "speed": 1.0}]
    )
    simulation.drive(1.0, 0.5, 0.0)
    simulation.lockstep.run_for(2.0)
    stopped = poses_of(simulation.take("truth"))
    simulation.base.request("shutdown")
    simulation.lockstep.run_for(2.0)
    states = simulation.take("world_state")

    last = [stopped[stamp] for stamp in sorted(stopped)[-8:]]
    assert len(set(last)) == 1
    assert to_ns(states[-1].header.stamp) > simulation.lockstep.now_ns - SECOND // 10
    assert states[-1].people.array[0, 0] > states[-30].people.array[0, 0]


def test_collision_is_reported_once_with_position_and_speed(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.drive(9.0, 0.6, 0.0)

    (hit,) = simulation.take("collisions")
    assert hit.obstacle == "wall 1"
    assert hit.x == pytest.approx(5.78, abs=0.013)
    assert hit.speed == pytest.approx(0.6)
    state = simulation.take("world_state")[-1]
    assert (state.forward, state.turn) == (0.0, 0.0)


def test_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    sums = []
    for _ in range(2):
        simulation = Simulation(
            tmp_path,
            exact=False,
            furniture=[TABLE],
            objects=OBJECTS,
            people=[{"name": "ada", "waypoints": [[0.5, 0.5], [5, 0.5]]}],
        )
        drive_curves(simulation)
        digest, codec = hashlib.sha256(), Codec()
        for topic in ("odom", "scan", "world_state", "objects"):
            messages = simulation.take(topic)
            assert len(messages) >= 5
            for message in messages:
                digest.update(codec.encode(message))
        sums.append(digest.hexdigest())

    assert sums[0] == sums[1]


def test_impossible_scanner_is_rejected_when_it_is_configured(tmp_path: Path) -> None:
    simulation = Simulation(tmp_path)
    for parameters, expected_text in (
        ({"rate": 50}, "rate = 50 Hz, but a UST-10LX turns 40 times per second"),
        ({"first": 1.0, "last": 0.9}, "leave fewer than two beams of a UST-10LX"),
    ):
        with pytest.raises(CairnError, match=expected_text):
            simulation.add(SimulatedScanner, **parameters)


def test_things_beyond_the_range_give_no_return(simulate: Callable[..., Simulation]) -> None:
    simulation = simulate()
    simulation.drive(0.5, 0.0, 0.0)
    before = simulation.take("scan")[-1]
    simulation.add(SimulatedScanner, rate=10, dropouts=0, farthest=2.5)
    simulation.take("scan")
    simulation.drive(0.5, 0.0, 0.0)

    scans = [scan for scan in simulation.take("scan") if scan.range_max == 2.5]

    assert scans
    assert np.isfinite(before.ranges).sum() > np.isfinite(scans[-1].ranges).sum() > 0
    for scan in scans:
        assert (scan.ranges[np.isfinite(scan.ranges)] <= 2.5).all()


def test_range_is_never_above_that_of_the_model(simulate: Callable[..., Simulation]) -> None:
    simulation = simulate()
    simulation.add(SimulatedScanner, model="PBS-03JN", dropouts=0, farthest=9.0)
    simulation.drive(0.5, 0.0, 0.0)

    assert {scan.range_max for scan in simulation.take("scan")} == {3.0, 10.0}


def test_scanner_without_any_range_is_rejected(simulate: Callable[..., Simulation]) -> None:
    with pytest.raises(CairnError, match=r"least range 0\.2 m"):
        simulate().add(SimulatedScanner, model="PBS-03JN", farthest=0.2)


def test_further_robots_are_driven_and_seen_by_each_other(simulate: Simulate) -> None:
    simulation = simulate()
    robots = {"robot_2": {"x": 5.0, "y": 2.0, "theta": 3.1416, "radius": 0.3}}
    lockstep = Lockstep(start_s=1.0)
    world = ComponentHarness(
        SimulatedWorld,
        {"world": str(simulation.file), "robots": robots, "slip": NO_SLIP},
        beside=lockstep,
        name="world",
    )
    shared = {name: f"/robot/{name}" for name in ("world_state", "world_geometry", "wheel_motion")}
    scanners = [
        ComponentHarness(
            SimulatedScanner,
            {"rate": 10, "dropouts": 0},
            beside=lockstep,
            robot=robot,
            topics={key: shared[key] for key in ("world_state", "world_geometry")},
        )
        for robot in ("robot", "robot_2")
    ]
    base = ComponentHarness(
        SimulatedBase,
        EXACT,
        beside=lockstep,
        robot="robot_2",
        topics={"wheel_motion": shared["wheel_motion"]},
    )
    for _ in range(10):
        base.publish("cmd_vel", Twist(linear=Vector3(x=0.4)))
        lockstep.run_for(0.1)

    x = world.take("world_state")[-1].others[0].pose.position.x
    assert 4.6 < x < 4.8
    ahead = [np.nanmin(scanner.take("scan")[-1].ranges) for scanner in scanners]
    assert ahead[0] == pytest.approx(x - 3.0 - 0.3, abs=0.1)  # to the other's edge
    assert ahead[1] == pytest.approx(x - 3.0 - 0.22, abs=0.1)
    listed = {(row["kind"], row["name"]) for row in world.request("list")}
    assert listed == {("robot", "robot"), ("robot", "robot_2")}


def test_wheels_of_an_unknown_robot_are_reported(
    simulate: Simulate, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = simulate()

    simulation.lockstep.publish("wheel_motion", WheelMotion(robot="robot_9"))

    assert "there is no such robot in this world (robot); add it" in caplog.text


def test_world_and_scanner_go_on_after_the_clock_was_set_back(tmp_path: Path) -> None:
    simulation = Simulation(tmp_path, simulated_time=True)

    def drive(begin_s: float, forward: float) -> float:
        """Drive for two seconds; return how far the wall ahead is from the scanner at the end."""
        for number in range(100):
            command = Twist(linear=Vector3(x=forward))
            simulation.lockstep.publish("cmd_vel", command, qos=SENSOR)
            simulation.set_clock(begin_s + 0.02 * number)
        state, scan = simulation.take("world_state")[-1], simulation.take("scan")[-1]
        for message in (state, scan):
            assert begin_s + 1.8 < to_ns(message.header.stamp) / SECOND < begin_s + 2.0
        to_wall = 6.0 - compose(planar_pose(state.robot), (MOUNT["x"], 0.0, 0.0))[0]
        ahead = round((-MOUNT["theta"] - scan.angle_min) / scan.angle_increment)
        assert scan.ranges[ahead] == pytest.approx(to_wall, abs=0.1)
        return to_wall

    before = drive(3600.0, 0.5)
    assert 1.9 < before < 2.3
    assert before - 0.2 < drive(5.0, 0.0) < before  # it brakes
    assert 0.9 < drive(7.0, 0.5) < 1.3
