"""Joins scans with the poses that they were taken from."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from logging import Logger

from cairn.planar.messages import planar_pose
from cairn.planar.odometry import FASTEST_WHEELS, OdometryChange, OdometryHistory
from cairn.planar.pose_tracker import sweep_of
from cairn.planar.poses import Pose, compose
from cairn.planar.scans import Rays, rays_of, sweep_s
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.system.clock import SECOND

_KEPT = 20  # scans that wait for their pose: those of 2 s at 10 Hz, of 0.5 s at 40 Hz
HISTORY_S = 5  # of odometry, longer than scans wait
# Scans of a pose with a less certain heading [rad] are not used: a beam of 3 m would end 0.18 m
# beside its obstacle, about four cells of 0.05 m. Chosen by hand; half and double make no
# difference in the demo's tour.
_MOST_HEADING_SD = 0.06


@dataclass(frozen=True)
class PosedScan:
    """Rays in the base's frame, and the base's pose in the map, at the end of the sweep."""

    stamp_ns: int
    pose: Pose
    rays: Rays


class PosedScans:
    """Returns scans with reliable poses, at most `per_s` per second.

    `waiting` is the reason why none is returned, "" while poses are reliable.
    """

    def __init__(
        self, mount: Pose, per_s: float, least_health: float, most_spread_m: float
    ) -> None:
        self._mount = mount
        self._every_ns = round(SECOND / per_s)
        self._least_health, self._most_spread_m = least_health, most_spread_m
        self._history = OdometryHistory[int](HISTORY_S * SECOND, FASTEST_WHEELS)
        self._scans: deque[LaserScan] = deque(maxlen=_KEPT)
        self._last_ns: int | None = None
        self.waiting = "no pose was received yet"

    def add_odometry(self, odom: Odometry, topic: str, log: Logger) -> None:
        """Store the robot's motion, which distorts the sweeps of scans."""
        change = self._history.add(to_ns(odom.header.stamp), planar_pose(odom.pose.pose))
        if change is OdometryChange.RESET:
            log.warning("odometry on %s went back in time: restarted its history", topic)

    def add_scan(self, scan: LaserScan) -> None:
        """Add a scan."""
        self._scans.append(scan)

    def ready(self, estimate: LocalizationEstimate) -> PosedScan | None:
        """Return the scan of this estimate, if it is reliable enough for the map."""
        self.waiting = self._why_unreliable(estimate)
        stamp = to_ns(estimate.header.stamp)
        if self.waiting:
            return None
        if self._last_ns is not None and 0 <= stamp - self._last_ns < self._every_ns:
            return None
        scan = next((s for s in self._scans if to_ns(s.header.stamp) == stamp), None)
        if scan is None:
            return None
        self._last_ns = stamp
        sweep = sweep_of(scan, self._history.at)
        motion = sweep.motion if sweep is not None else (0.0, 0.0, 0.0)
        end_ns = stamp + round(sweep_s(scan) * SECOND)
        pose = compose(planar_pose(estimate.pose.pose), motion)
        return PosedScan(end_ns, pose, rays_of(scan, self._mount, motion))

    def _why_unreliable(self, estimate: LocalizationEstimate) -> str:
        if not estimate.located:
            return estimate.reason or "the robot is not localized"
        if estimate.health < self._least_health:
            return f"the pose is not reliable: {estimate.reason}"
        if estimate.position_sd > self._most_spread_m:
            return f"the position is uncertain by {estimate.position_sd:.2f} m"
        if estimate.heading_sd > _MOST_HEADING_SD:
            return f"the heading is uncertain by {estimate.heading_sd:.2f} rad"
        return ""
