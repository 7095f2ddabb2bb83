"""The localizer on the bus: order by stamps, known and unknown starts, evidence, bad time."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest

from cairn import from_ns
from cairn.components.localizer.component import Localizer
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import (
    ObjectEvidence,
    RecognizedObject,
    RecognizedObjectArray,
    VisualMap,
    VisualObject,
)
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.localizer.hall import PLACES, Moment, drive
from tests.wording import assert_words

BEGIN = 1000.0
START = {"x": 0.0, "y": 0.0, "theta": 0.0}
BASE = {"kind": "commanded", "lag_s": 0.0, "forward_gain": 1.0, "turn_gain": 1.0}


def header(time: float, frame: str = "") -> Header:
    return Header(stamp=from_ns(round((BEGIN + time) * 1e6) * 1000), frame_id=frame)


def odometry(moment: Moment, drift_m: float = 0.0) -> Odometry:
    x, y, theta = moment.pose
    covariance = np.zeros(36)
    covariance[0] = covariance[7] = drift_m**2 / 2
    heading = Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    return Odometry(
        header=header(moment.time, "odom"),
        child_frame_id="base_link",
        pose=PoseWithCovariance(
            pose=Pose(position=Point(x=x, y=y), orientation=heading), covariance=covariance
        ),
        twist=TwistWithCovariance(
            twist=Twist(linear=Vector3(x=moment.forward), angular=Vector3(z=moment.turn))
        ),
    )


def recognized(moment: Moment) -> RecognizedObjectArray:
    return RecognizedObjectArray(
        header=header(moment.time, "base_link"),
        objects=tuple(
            RecognizedObject(
                object_id=s.object_id,
                range=s.range_m,
                bearing=s.bearing,
                covariance=np.array([s.range_variance, 0.0, 0.0, s.bearing_variance]),
            )
            for s in moment.observations
        ),
    )


def visual_map(**moved: tuple[float, float]) -> VisualMap:
    shift = {int(name[1:]): move for name, move in moved.items()}
    return VisualMap(
        objects=tuple(
            VisualObject(
                object_id=i,
                x=x + shift.get(i, (0.0, 0.0))[0],
                y=y + shift.get(i, (0.0, 0.0))[1],
                reliability=0.9,
            )
            for i, (x, y) in PLACES.items()
        )
    )


def start_localizer(
    start: dict[str, float] | None, **parameters: Any
) -> ComponentHarness[Localizer]:
    localizer = ComponentHarness(
        Localizer,
        {"start": start, "base": BASE, "search_particles": 8000, **parameters},
        start_s=BEGIN,
    )
    localizer.publish("visual_map", visual_map())
    return localizer


def travel(
    localizer: ComponentHarness[Localizer],
    moments: Iterable[Moment],
    drift_m: float = 0.0,
    late_s: float = 0.0,
) -> None:
    """Publish odometry in time and observations `late_s` [s] late."""
    waiting: list[Moment] = []
    for moment in moments:
        localizer.run_for(max(0.0, BEGIN + moment.time - localizer.now))
        localizer.publish("odom", odometry(moment, drift_m))
        waiting.append(moment)
        while waiting and waiting[0].time <= moment.time - late_s:
            ready = waiting.pop(0)
            if ready.observations:
                localizer.publish("objects", recognized(ready))


def error(message: PoseWithCovarianceStamped, moments: Sequence[Moment]) -> float:
    stamp = message.header.stamp
    time = stamp.sec + stamp.nanosec / 1e9 - BEGIN
    moment = min(moments, key=lambda m: abs(m.time - time))
    where = message.pose.pose.position
    return math.hypot(where.x - moment.pose[0], where.y - moment.pose[1])


def test_pose_is_published_from_a_known_start() -> None:
    moments = list(drive(20.0))
    localizer = start_localizer(START)

    travel(localizer, moments)

    poses = localizer.take("pose")
    assert len(poses) >= 90
    assert max(error(pose, moments) for pose in poses) < 0.3
    assert poses[0].header.frame_id == "map"
    cloud = localizer.take("particles")[-1]
    assert len(cloud.poses) == 200
    transform = localizer.take("tf")[-1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "odom")
    assert math.hypot(transform.transform.translation.x, transform.transform.translation.y) < 0.3


def test_no_pose_is_published_before_the_robot_is_found() -> None:
    moments = list(drive(25.0))
    localizer = start_localizer(None)
    blind = [Moment(m.time, m.forward, m.turn, m.pose, []) for m in moments[:25]]

    travel(localizer, blind)
    assert localizer.take("pose") == []
    travel(localizer, moments[25:])

    assert error(localizer.take("pose")[-1], moments) < 0.3


def test_late_observations_give_the_same_evidence() -> None:
    moments = list(drive(30.0))
    prompt, late = start_localizer(START), start_localizer(START)

    travel(prompt, moments)
    travel(late, moments, late_s=0.19)

    judged = [
        [(e.object_id, e.similarity) for m in localizer.take("object_evidence") for e in m.evidence]
        for localizer in (prompt, late)
    ]
    assert judged[0][:100] == judged[1][:100]


def test_observation_waits_for_odometry_for_a_limited_time(
    caplog: pytest.LogCaptureFixture,
) -> None:
    moments = list(drive(10.0))
    localizer = start_localizer(START, hold_s=1.0)
    travel(localizer, moments[:20])
    localizer.take("object_evidence")
    ahead = next(m for m in moments[21:] if m.observations)
    localizer.run_for(ahead.time + BEGIN - localizer.now)

    localizer.publish("objects", recognized(ahead))
    assert localizer.take("object_evidence") == []
    localizer.run_for(2.0)

    assert len(localizer.take("object_evidence")) == 1
    assert "no odometry for" in caplog.text


def test_odometry_that_runs_backwards_is_logged_and_ignored(
    caplog: pytest.LogCaptureFixture,
) -> None:
    moments = list(drive(20.0))
    localizer = start_localizer(START)
    travel(localizer, moments[:60])

    localizer.publish("odom", odometry(moments[3]))
    localizer.publish("objects", recognized(next(m for m in moments if m.observations)))
    travel(localizer, moments[60:])

    assert_words(caplog.text, "/robot/odom ignored", "1011.800 s", "1000.600 s")
    assert_words(caplog.text, "1000.000 s ignored", "11.8 s late")
    assert error(localizer.take("pose")[-1], moments) < 0.3


def test_restarted_localizer_does_not_use_the_old_start(caplog: pytest.LogCaptureFixture) -> None:
    moments = list(drive(60.0))
    localizer = start_localizer(START)

    travel(localizer, moments[150:], drift_m=3.0)

    assert "start pose not used" in caplog.text
    assert error(localizer.take("pose")[-1], moments) < 0.3


def test_localizer_restarted_near_the_start_uses_odometry() -> None:
    moments = list(drive(20.0))
    localizer = start_localizer(START)
    blind = [Moment(m.time, m.forward, m.turn, m.pose, []) for m in moments[40:]]

    travel(localizer, blind, drift_m=0.1)

    assert error(localizer.take("pose")[-1], moments) < 0.3


def test_gap_in_commands_is_filled_by_the_odometry_pose(caplog: pytest.LogCaptureFixture) -> None:
    moments = list(drive(20.0))
    localizer = start_localizer(START)
    blind = [Moment(m.time, m.forward, m.turn, m.pose, []) for m in moments]

    travel(localizer, [*blind[:20], *blind[50:]])

    assert "no odometry on /robot/odom for 6" in caplog.text
    assert error(localizer.take("pose")[-1], moments) < 0.4


def test_operator_sets_the_pose() -> None:
    localizer = start_localizer(None)
    moments = list(drive(5.0))
    blind = [Moment(m.time, m.forward, m.turn, m.pose, []) for m in moments]
    travel(localizer, blind[:5])

    localizer.publish("initialpose", PoseWithCovarianceStamped(pose=odometry(moments[4]).pose))
    travel(localizer, blind[5:])

    assert error(localizer.take("pose")[-1], moments) < 0.2


def test_impossible_poses_and_odometry_are_rejected(caplog: pytest.LogCaptureFixture) -> None:
    localizer = start_localizer(START)
    moments = list(drive(20.0))
    travel(localizer, moments[:50])

    far = Pose(position=Point(x=1e200))
    stated = Pose(position=Point(x=1.0)), np.full(36, 1e300)
    for pose in (
        PoseWithCovariance(pose=far),
        PoseWithCovariance(pose=stated[0], covariance=stated[1]),
        PoseWithCovariance(pose=stated[0], covariance=np.diag([1e300] * 6).ravel()),
    ):
        localizer.publish("initialpose", PoseWithCovarianceStamped(pose=pose))
    now = odometry(moments[50])
    fast = TwistWithCovariance(twist=Twist(linear=Vector3(x=1e300)))
    for forged in (
        Odometry(header=now.header, pose=PoseWithCovariance(pose=far), twist=now.twist),
        Odometry(header=now.header, pose=now.pose, twist=fast),
    ):
        localizer.publish("odom", forged)
    travel(localizer, moments[50:])

    assert "pose on /robot/initialpose rejected: (1e+200 m, 0 m)" in caplog.text
    assert "odometry on /robot/odom ignored: at (1e+200 m, 0 m)" in caplog.text
    assert error(localizer.take("pose")[-1], moments) < 0.6


def test_odometry_from_the_far_future_does_not_take_long() -> None:
    localizer = start_localizer(START)
    moments = list(drive(20.0))
    travel(localizer, moments[:50])

    future = Header(stamp=Time(sec=2**31 - 1), frame_id="odom")
    now = odometry(moments[50])
    localizer.publish("odom", Odometry(header=future, pose=now.pose, twist=now.twist))
    localizer.take("pose")
    travel(localizer, moments[50:])

    assert localizer.take("pose")


def test_evidence_has_the_moved_object_and_its_position() -> None:
    localizer = start_localizer(START)
    localizer.publish("visual_map", visual_map(o3=(1.3, 0.4)))

    travel(localizer, drive(70.0))

    evidence = [(m, e) for m in localizer.take("object_evidence") for e in m.evidence]
    blamed = {e.object_id for _, e in evidence if e.similarity < 0.4}
    assert blamed == {3}
    against = [e for m, e in evidence if e.verdict == ObjectEvidence.DISAGREES and m.healthy]
    assert np.median([e.x for e in against]) == pytest.approx(-1.0, abs=0.25)
    assert np.median([e.y for e in against]) == pytest.approx(3.5, abs=0.25)
    assert all(m.reason for m, _ in evidence if not m.healthy)


def test_unmapped_object_gets_a_position() -> None:
    localizer = start_localizer(START)
    known = visual_map()
    localizer.publish("visual_map", VisualMap(objects=known.objects[1:]))

    travel(localizer, drive(60.0))

    placed = [
        e
        for m in localizer.take("object_evidence")
        for e in m.evidence
        if e.object_id == 1 and m.healthy and e.verdict == ObjectEvidence.AGREES
    ]
    assert np.median([e.x for e in placed]) == pytest.approx(3.0, abs=0.2)
    assert {e.similarity for e in placed} == {0.5}
