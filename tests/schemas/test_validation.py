"""The invalid values that each message rejects, and the error message."""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cairn.schemas.builtin_interfaces import Duration, Time
from cairn.schemas.cairn_msgs import (
    ComponentStatus,
    ObjectEvidence,
    ObjectEvidenceArray,
    PortStatus,
    RecognizedObject,
    RecognizedObjectArray,
    VisualMapChange,
    VisualObject,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.diagnostic_msgs import DiagnosticStatus
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Transform,
    Vector3,
)
from cairn.schemas.message import InvalidMessage
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid
from cairn.schemas.sensor_msgs import CameraInfo, Image, LaserScan
from cairn.schemas.std_msgs import Header, String

NAN, INF = math.nan, math.inf


def estimate_at(x: float) -> LocalizationEstimate:
    pose = PoseWithCovariance(pose=Pose(position=Point(x=x)))
    return LocalizationEstimate(pose=pose)


def evidence(**changed: Any) -> ObjectEvidence:
    whole: dict[str, Any] = {
        "object_id": 1, "similarity": 0.5, "verdict": ObjectEvidence.AGREES, "distance": 0.1,
        "x": 1.0, "y": 2.0, "covariance": np.eye(2).ravel(), "range": 3.0, "bearing": 0.0,
    }  # fmt: skip
    return ObjectEvidence(**(whole | changed))


def recognized_object(**changed: Any) -> RecognizedObject:
    whole: dict[str, Any] = {"object_id": 1, "range": 3.0, "bearing": 0.0}
    return RecognizedObject(**(whole | changed))


def grid(cells: Any, width: int, height: int, resolution: float = 0.05) -> OccupancyGrid:
    info = MapMetaData(resolution=resolution, width=width, height=height)
    return OccupancyGrid(info=info, data=cells)


def grid_at(x: float) -> OccupancyGrid:
    return OccupancyGrid(info=MapMetaData(origin=Pose(position=Point(x=x))))


def scan(beams: int, first: float, last: float, step: float, **more: Any) -> LaserScan:
    fields: dict[str, Any] = {"range_max": 8.0, "ranges": np.ones(beams, "f4")}
    return LaserScan(angle_min=first, angle_max=last, angle_increment=step, **(fields | more))


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Time(sec=2**31), "Time: sec = 2147483648: must be an integer from -2147483648 to"),
        (lambda: Time(sec=1.0), "Time: sec = 1.0: must be an integer"),  # type: ignore[arg-type]
        (lambda: Time(sec=True), "Time: sec = True: must be an integer"),
        (lambda: Time(nanosec=10**9), "Time: nanosec = 1000000000: must be an integer from 0 to"),
        (lambda: Duration(nanosec=-1), "Duration: nanosec = -1: must be an integer from 0 to"),
        (lambda: String(data="a\0b"), r"String: data = 'a\x00b': must be a string without NUL"),
        (lambda: String(data="\ud800"), r"String: data = '\ud800': must be a string without NUL"),
        (lambda: String(data=b"a"), "String: data = b'a': must be a string"),  # type: ignore[arg-type]
        (lambda: Header(stamp=3), "Header: stamp = 3: "),  # type: ignore[arg-type]
        (lambda: estimate_at(1e256), "Estimate: position = (1e+256, 0.0): must be within 1e+07 m"),
        (lambda: Point(x=NAN), "Point: x = nan: must be a finite number"),
        (lambda: Point(y="1"), "Point: y = '1': must be a finite number"),  # type: ignore[arg-type]
        (lambda: Point(y=True), "Point: y = True: must be a finite number"),
        (lambda: Vector3(z=INF), "Vector3: z = inf: must be a finite number"),
        (lambda: Quaternion(w=NAN), "Quaternion: w = nan: must be a finite number"),
        (lambda: Transform(rotation=Point()), "Transform: rotation = Point("),  # type: ignore[arg-type]
        (
            lambda: PoseWithCovariance(covariance=np.zeros(9)),
            "PoseWithCovariance: covariance = float64[9]",
        ),
        (
            lambda: PoseWithCovariance(covariance=np.full(36, INF)),
            "must hold finite numbers only",
        ),
        (lambda: MapMetaData(resolution=-0.1), "resolution = -0.1: must be a finite number at lea"),
        (lambda: grid([0, 0], 3, 1), "data = int8[2] [0 0]: must have width * height = 3 cells"),
        (lambda: grid([0, 101], 2, 1), ": must hold values from -1 to 100"),
        (lambda: grid([-2], 1, 1), "data = int8[1] [-2]: must hold values from -1 to 100"),
        (lambda: grid([0], 1, 1, 0.0), "info.resolution = 0.0: must be at least 0.001 where there"),
        (lambda: grid([0], 1, 1, 1e-30), "must be at least 0.001 where there are cells"),
        (lambda: grid([0], 5001, 5000), "makes 25005000 cells, above 25000000"),
        (lambda: grid_at(1e300), "must be at most 1e+07 from 0"),
        (lambda: scan(3, 0.0, 1.0, 0.1), "angle_max = 1.0: must be within a step of the last of 3"),
        (lambda: scan(3, 0.0, 0.2, NAN), "angle_increment = nan: must be a finite number"),
        (lambda: scan(1, 0.0, 0.5, 0.0), "angle_max = 0.5: must be within a step"),
        (
            lambda: scan(3, 0.0, 0.2, 0.1, intensities=np.ones(2, "f4")),
            "intensities = float32[2] [1. 1.]: must be none or 3, as the ranges",
        ),
        (lambda: LaserScan(range_min=2.0, range_max=1.0), "range_max = 1.0: must be range_min = 2"),
        (lambda: scan(1, 0.0, 0.0, 0.0, range_max=0.0), "range_max = 0.0: must be above 0 and fin"),
        (lambda: scan(1, 0.0, 0.0, 0.0, range_max=INF), "range_max = inf: must be above 0 and fin"),
        (lambda: scan(1, 0.0, 0.0, 0.0, range_min=-1.0), "range_min = -1.0: must be at least 0"),
        (lambda: LaserScan(range_max=NAN), "range_max = nan: must be range_min = 0.0 or more"),
        (
            lambda: Image(height=2, step=3, data=np.zeros(5, np.uint8)),
            "Image: data = uint8[5] [0 0 0 0 0]: must have height * step = 6 bytes",
        ),
        (lambda: CameraInfo(k=np.zeros(8)), "CameraInfo: k = float64[8]"),
        (lambda: CameraInfo(d=[NAN]), "CameraInfo: d = [nan]: must hold finite numbers only"),  # type: ignore[arg-type]
        (lambda: DiagnosticStatus(level=4), "level = 4: must be an integer from 0 to 3"),
        (lambda: recognized_object(range=0.0), "range = 0.0: must be a finite number above 0"),
        (lambda: recognized_object(range=INF), "range = inf: must be a finite number above 0"),
        (
            lambda: recognized_object(object_id=-1),
            "object_id = -1: must be an integer from 0 to 4294967295",
        ),
        (lambda: recognized_object(covariance=[1, 2, 2, 1]), "must be positive semidefinite"),
        (lambda: recognized_object(covariance=[-1, 0, 0, 1]), "must be positive semidefinite"),
        (lambda: recognized_object(covariance=[1, 0.1, 0, 1]), "must be symmetric"),
        (lambda: recognized_object(covariance=[1, NAN, NAN, 1]), "must hold finite numbers only"),
        (
            lambda: evidence(similarity=1.1),
            "similarity = 1.1: must be a finite number at least 0 an",
        ),
        (lambda: evidence(similarity=NAN), "similarity = nan: must be a finite number at least 0"),
        (lambda: evidence(verdict=5), "verdict = 5: must be an integer from 0 to 4"),
        (lambda: recognized_object(corners=[1.0, 2.0]), "must be none, or 8 image coordinates"),
        (
            lambda: RecognizedObjectArray(view_right=0.5, view_left=-0.5),
            "view_left = -0.5: must be 0.5 or more",
        ),
        (
            lambda: RecognizedObjectArray(nearest=3.0, farthest=1.0),
            "farthest = 1.0: must be nearest = 3.0 or more",
        ),
        (lambda: evidence(distance=-0.1), "distance = -0.1: must be a finite number at least 0"),
        (
            lambda: ObjectEvidenceArray(robot_covariance=[1, 0, 2, 0, 1, 0, 2, 0, 1]),  # type: ignore[arg-type]
            "robot_covariance = [1, 0, 2, 0, 1, 0, 2, 0, 1]: must be positive semidefinite",
        ),
        (
            lambda: ObjectEvidenceArray(robot_covariance=[1, 0, 0, 0, 1, 0.5, 0, 0, 1]),  # type: ignore[arg-type]
            "must be symmetric",
        ),
        (lambda: VisualObject(1, state=3), "state = 3: must be an integer from 0 to 1"),
        (
            lambda: VisualObject(1, candidate_x=1.0),
            "candidate_x, candidate_y = (1.0, nan): must be",
        ),
        (lambda: VisualObject(1, reliability=-0.1), "reliability = -0.1: must be a finite number"),
        (lambda: VisualMapChange(kind=5), "kind = 5: must be an integer from 0 to 4"),
        (lambda: VisualMapChange(new_x=INF, new_y=0.0), "new_x, new_y = (inf, 0.0): must be two"),
        (lambda: PortStatus("scan", "/scan", 4), "direction = 4: must be an integer from 0 to 3"),
        (
            lambda: ComponentStatus(Header(), "localizer", state="asleep"),
            "state = 'asleep': must be one of 'unconfigured', 'inactive', 'active', ",
        ),
    ],
)
def test_invalid_message_is_rejected_with_path_value_and_reason(
    make: Callable[[], object], error: str
) -> None:
    with pytest.raises(InvalidMessage, match=re.escape(error)):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Time(sec=-(2**31), nanosec=999_999_999),
        lambda: Quaternion(w=0.0),
        lambda: PoseWithCovariance(covariance=[-1.0] * 36),  # type: ignore[arg-type]
        lambda: grid([], 0, 0, 0.0),
        lambda: scan(3, 0.0, 0.0, 0.0, ranges=[NAN, INF, -INF]),
        lambda: LaserScan(range_max=INF),
        lambda: scan(682, -2.0923, 2.0862, 2 * math.pi / 1024),
        lambda: scan(682, 2.0923, -2.0862, -2 * math.pi / 1024),
        lambda: scan(360, 0.0, 2 * math.pi, 2 * math.pi / 360),
        lambda: scan(1_000_000, -math.pi, math.pi, 2 * math.pi / 1_000_000),
        lambda: scan(1, 0.3, 0.3, 0.0),
        lambda: recognized_object(covariance=[0, 0, 0, 0]),
        lambda: recognized_object(covariance=[1e300, 1e300, 1e300, 1e300]),
        lambda: recognized_object(covariance=[1.0, 1 + 1e-12, 1 + 1e-12, 1.0]),
        lambda: evidence(similarity=0.0, distance=0.0),
        lambda: ObjectEvidenceArray(robot_covariance=np.diag([1e-8, 1e8, 0.0]).ravel()),
        lambda: VisualMapChange(old_x=1.0, old_y=2.0, kind=VisualMapChange.REMOVED),
    ],
)
def test_valid_message_is_accepted(make: Callable[[], object]) -> None:
    make()
