"""Short runs of SLAM that show the effect of its constants: a recorded log, a drive, objects."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cairn import from_ns
from cairn.components.slam.component import Slam
from cairn.components.slam.graph_file import read_graph
from cairn.components.slam.mapping import Mapper
from cairn.planar.grid import OCCUPIED
from cairn.planar.map_file import read_map
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.motion_model import COMMANDED
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from cairn_lab.benchmarks.lockstep import ROOT
from cairn_lab.benchmarks.slam import FARTHEST_M, map_log, relation_errors
from tests.components.slam import courses
from tests.components.slam.courses import Course
from tests.components.slam.map_errors import alignment_to, position_errors
from tests.components.slam.object_drive import OBJECTS, Base, Drive
from tests.components.slam.recordings import SCANNERS, sweeps

_DATA = ROOT / "tests" / "data" / "slam"
_LOG_S = 100.0
_START_NS = 100 * 10**9  # of virtual time
_STOPS = 6  # of the tour of the office, to which the robot drives before it returns


def mapped_log() -> dict[str, Any]:
    """Map the first 100 s of fr079: errors of the relations, loops, keyframes."""
    log, relations = _DATA / "fr079_start.clf.gz", _DATA / "fr079_start.relations"
    mapper, times = map_log(log, FARTHEST_M, _LOG_S)
    found = [(x, y, theta) for x, y, theta in mapper.poses().tolist()]
    meters, degrees = relation_errors(times, found, relations)
    return {
        "meters": round(float(np.mean(meters)), 4),
        "degrees": round(float(np.mean(degrees)), 3),
        **_counts(mapper),
    }


def mapped_drive() -> dict[str, Any]:
    """Map a drive with the component: rms error of its poses, cells of walls, loops, keyframes."""
    course = courses.shipped("office")
    course = Course(course.world, (*course.stops[:_STOPS], course.stops[0]))
    poses, truth = [], []
    with tempfile.TemporaryDirectory() as folder:
        slam = ComponentHarness(Slam, {"map_file": f"{folder}/map.yaml"}, start_s=100.0)
        for sweep in sweeps(course, SCANNERS["UST-10LX"]):
            for at_ns, pose in ((sweep.start_ns, sweep.start), (sweep.end_ns, sweep.end)):
                slam.run_to(_START_NS + at_ns)
                header = Header(stamp=from_ns(slam.now_ns), frame_id="odom")
                odometry = PoseWithCovariance(pose=pose_message(pose))
                slam.publish(
                    "odom", Odometry(header=header, child_frame_id="base_link", pose=odometry)
                )
            header = Header(stamp=from_ns(_START_NS + sweep.start_ns), frame_id="laser")
            slam.publish("scan", replace(sweep.scan, header=header))
            for estimate in slam.take("localization"):
                if estimate.located:
                    poses.append(planar_pose(estimate.pose.pose))
                    truth.append(sweep.truth)
        slam.run_for(5.0)
        slam.request("deactivate")
        grid = read_map(Path(folder) / "map.yaml")
        mapper = read_graph(Path(folder) / "map.graph")
    found, true = np.array(poses), np.array(truth)
    errors = position_errors(true, found, alignment_to(true, found))
    return {
        "rmse": round(float(np.sqrt(np.mean(errors**2))), 4),
        "located": len(poses),
        "walls": int(np.count_nonzero(grid.values == OCCUPIED)),
        **_counts(mapper),
    }


def mapped_objects() -> dict[str, Any]:
    """Map objects without a scanner: their largest error, how many, and the turn gain."""
    drive = Drive(60.0, Base(turn_gain=0.9, drift=0.002))
    mapper = drive.into(Mapper(10.0, COMMANDED))
    mapper.finish()
    report = mapper.landmarks()
    places = {one.object_id: (one.position.x, one.position.y) for one in report.landmarks}
    return {
        "rmse": round(_object_error(places), 4),
        "objects": len(places),
        "turn_gain": round(mapper.calibration.calibration.turn_gain, 4),
    }


def _object_error(places: Mapping[int, tuple[float, float]]) -> float:
    """Return the rms error [m] of the objects that were found, after their alignment."""
    known = sorted(set(places) & set(OBJECTS))
    if len(known) < 2:
        return math.inf
    found, true = (np.array([(*one[k], 0.0) for k in known]) for one in (places, OBJECTS))
    return float(np.sqrt(np.mean(position_errors(true, found, alignment_to(true, found)) ** 2)))


def _counts(mapper: Mapper) -> dict[str, int]:
    loops = sum(edge.second > edge.first + 1 for edge in mapper.graph.edges)
    return {"closures": loops, "keyframes": len(mapper.keyframes)}
