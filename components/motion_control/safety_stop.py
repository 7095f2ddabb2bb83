"""Safety stop: the reasons for which the robot must stand still.

These are stale inputs, a scanner that measures nothing, a lost robot, and a break in odometry.
"""

from __future__ import annotations

from collections.abc import Mapping

from cairn import SECOND
from cairn.components.motion_control.config import Timeouts
from cairn.planar.odometry import time_went_back
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, ReasonCode

# The health must exceed the limit by this much [1] before a path is followed again: without the
# hysteresis the robot would start and stop repeatedly at the limit.
_HEALTH_HYSTERESIS = 0.05

Stop = tuple[int, str]
"""A `ReasonCode` and the reason in words; the words are empty if the robot may move."""


class SafetyStop:
    """Judges the inputs of motion control by their ages and contents."""

    def __init__(self, topics: Mapping[str, str]) -> None:
        """Name the topic of each input for the messages."""
        self._topics = topics
        self._times: dict[str, int] = {}
        self._lost: Stop | None = None
        self._paused_until, self._pause = 0, ""
        self.scan_informative = True

    def note(self, name: str, stamp: int, now: int) -> None:
        """Note a message with `stamp` [ns] at `now` [ns]; a stamp in the future counts as now."""
        newest = self._times.get(name, 0)
        if time_went_back(newest, now):
            newest = 0
        self._times[name] = max(min(stamp, now), newest)

    def note_localization(self, estimate: LocalizationEstimate, health_limit: float) -> None:
        """Judge whether the pose in the map is reliable."""
        if self._lost is not None:  # it must be clearly better to count as found
            health_limit = min(1.0, health_limit + _HEALTH_HYSTERESIS)
        self._lost = None
        if estimate.health < health_limit or not estimate.located:
            reason = f"the robot is lost, health {estimate.health:.2f}: {estimate.reason}"
            self._lost = estimate.reason_code, reason

    def pause(self, until: int, reason: str) -> None:
        """Stop until that time [ns]."""
        self._paused_until, self._pause = until, reason

    def stale_command(self, now: int, timeouts: Timeouts) -> str:
        """Return why the navigation command is stale, else ""."""
        return self._stale("nav_command", timeouts.nav_command, now)

    def reason(self, now: int, timeouts: Timeouts, needs_pose: bool, pose_known: bool) -> Stop:
        """Return why the robot must stand still at `now` [ns].

        The pose in the map counts only if the current behavior `needs_pose`.
        """
        stale = self._stale("odom", timeouts.odom, now)
        if stale:
            return ReasonCode.NO_ODOMETRY, stale
        scan = "scan" if self.scan_informative else "valid scan"
        stale = self._stale("scan", timeouts.scan, now, scan)
        if stale:
            return ReasonCode.NO_SCAN, stale
        if now < self._paused_until:
            return ReasonCode.ODOMETRY_RESET, self._pause
        if not needs_pose:
            return ReasonCode.NONE, ""
        stale = self._stale("localization", timeouts.localization, now)
        if not stale and self._lost is not None:
            return self._lost
        if not stale and not pose_known:
            stale = f"no pose on {self._topics['localization']} since odometry restarted"
        return ReasonCode.NO_LOCALIZATION, stale

    def _stale(self, name: str, timeout_s: float, now: int, called: str = "") -> str:
        """Return why an input, `called` so in words, is too old, with age and topic; else ""."""
        time, topic = self._times.get(name), self._topics[name]
        if time is None:
            return f"no {called or name} yet on {topic}"
        if time_went_back(time, now):
            return f"no {called or name} since time was set back on {topic}"
        age = (now - time) / SECOND
        return "" if age <= timeout_s else f"no {called or name} for {age:.2f} s on {topic}"
