"""Keeps a robot busy: sends it goals, one after the other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from random import Random

import cairn.client
from cairn.client.robot import Robot
from cairn.errors import CairnError
from cairn.schemas.cairn_nav_msgs import NAVIGATION_STATES
from cairn_lab.campaign.free_space import FreeSpace, free_space
from cairn_lab.campaign.model import Goals
from cairn_lab.campaign.observations import GoalEnded

_PAUSE_S = 1.0
_CLOSED = "the campaign has ended the deployment"
_JOIN_S = 20.0


class GoalSender:
    """Sends goals on a thread, with a connection of its own, until it is closed."""

    def __init__(
        self,
        goals: Goals,
        random: Random,
        endpoint: str,
        domain: int,
        robot: str,
        report: Callable[[GoalEnded], None],
    ) -> None:
        """`report` is called on the thread with each goal that has ended; its time is 0."""
        self._goals = goals
        self._random = random
        self._where = endpoint, domain, robot
        self._report = report
        self._number = 0
        self._space: FreeSpace | None = None
        self._closing = threading.Event()
        self.failure: Exception | None = None
        """Why no further goal is sent; None if goals are sent."""
        self._thread = threading.Thread(target=self._run, name="goals", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Cancel the goal under way, and send no further one."""
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        try:
            self._send_goals()
        except Exception as error:
            self.failure = error

    def _send_goals(self) -> None:
        endpoint, domain, robot = self._where
        while not self._closing.is_set():
            with (
                suppress(CairnError),  # the deployment has ended, which its process shows
                cairn.client.connect(endpoint, domain, robot, notify=lambda _: None) as client,
            ):
                while not self._closing.is_set():
                    self._drive(client)
                    self._closing.wait(_PAUSE_S)
            self._closing.wait(_PAUSE_S)

    def _drive(self, client: Robot) -> None:
        pose = self._next_pose(client)
        began = time.monotonic()
        state, reason = self._outcome(client, pose)
        if self._closing.is_set() and state != "succeeded":
            state, reason = "canceled", _CLOSED
        self._report(GoalEnded(0.0, pose, state, reason, time.monotonic() - began))
        if state == "late":
            with suppress(CairnError):  # it has just ended
                client.cancel()

    def _outcome(self, client: Robot, pose: tuple[float, float, float]) -> tuple[str, str]:
        """Send a goal and return how it ended: state and reason."""
        deadline = time.monotonic() + self._goals.limit_s
        doing = ""
        try:
            with client.go(*pose) as goal:
                for status in goal.progress(self._goals.limit_s):
                    doing = f"{NAVIGATION_STATES[status.state]}: {status.reason or 'no reason'}"
                    if self._closing.is_set():
                        goal.cancel()
                        break
                result = goal.result(0.0)
        except CairnError as error:
            return ("late", doing) if time.monotonic() >= deadline else ("lost", str(error))
        return NAVIGATION_STATES[result.state], result.reason

    def _next_pose(self, client: Robot) -> tuple[float, float, float]:
        if self._goals.poses:
            self._number += 1
            return self._goals.poses[(self._number - 1) % len(self._goals.poses)]
        if self._space is None:
            self._space = free_space(client, self._goals.clearance)
        return self._space.pose(self._random)
