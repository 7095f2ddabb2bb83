"""Goals for a robot: send, follow, cancel."""

from __future__ import annotations

import queue
import secrets
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol, Self

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.control import ControlError, NoReplyError
from cairn.client.connection import STATUS_TOPIC, Connection, resolve
from cairn.errors import CairnError
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.cairn_nav_msgs import (
    MAX_GOALS,
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    NavigationStatus,
)
from cairn.schemas.message import InvalidMessage

_PLUGIN, _AUTOMOVE = "mobile_supervisor", "automove"
_ACTIVE = "active"
# The supervisor above kills one that hangs after `hang_timeout_s` and 3 s more, and restarts it.
PATIENCE_S = 30.0
# AutoMove publishes the status of a goal twice a second. After _SILENT_S without one, the
# supervisor is asked, again and again; it may be restarted and resume the goal. After _LOST_S it
# has not; after _GONE_S nothing will answer.
_SILENT_S, _LOST_S, _GONE_S = 3.0, 8.0, 20.0
_LOADING_S = 90.0  # longer than a component takes to start, by default
_ANSWER_S = 5.0
_POLL_S = 0.5


class _Samples(Protocol):
    """A queue of samples."""

    def get(self, *, timeout: float) -> Any:
        """Return the next one; `queue.Empty` if none arrives in time."""
        ...


class Navigator:
    """A supervisor that accepts goals."""

    def __init__(self, connection: Connection, supervisor: str, notify: Callable[[str], None]):
        """`supervisor` is its full name (`/robot/mobile_supervisor`)."""
        self._connection = connection
        self._supervisor = supervisor
        self._notify = notify
        self._codec = Codec()

    @classmethod
    def find(cls, connection: Connection, robot: str, notify: Callable[[str], None]) -> Navigator:
        """Return the supervisor of a robot that accepts goals, once it answers.

        Raises `CairnError` if there is none, or if it does not answer within the limit.
        """
        statuses = connection.statuses()
        heard = {name for name, status in statuses.items() if status.plugin == _PLUGIN}
        found = sorted(heard | _expected(statuses) - statuses.keys())
        if not found:
            raise CairnError(
                f"no {_PLUGIN} runs here that accepts goals; start a deployment with one, such as "
                f"`cairn up sim`{connection.elsewhere()}"
            )
        name = resolve(found, found[0].rpartition("/")[2], robot)
        navigator = cls(connection, name, notify)
        if name not in heard or statuses[name].state != _ACTIVE:
            navigator.await_active()
        return navigator

    def goal(self, poses: Sequence[Sequence[float] | str]) -> NavigationGoal:
        """Return a goal of poses [x, y, theta] in frame map or names of places, not sent yet.

        Raises `CairnError` if there are too many poses for one mission.
        """
        if len(poses) > MAX_GOALS:
            raise CairnError(
                f"{len(poses):,} goals: a mission has at most {MAX_GOALS:,}; send the further ones "
                "when it has ended"
            )
        goals: list[Sequence[float] | str] = [
            pose if isinstance(pose, str) else [float(value) for value in pose] for pose in poses
        ]
        return NavigationGoal(self, goals)

    def cancel(self, **selection: Any) -> int:
        """Cancel the goal under way; return its mission id.

        `selection` may be the `mission_id` or the `token` of the goal that is meant.
        """
        try:
            answer = self.ask("cancel", selection, _LOADING_S)
        except NoReplyError:  # it hung and was killed; once restarted, it resumes the goal
            self.await_active()
            answer = self.ask("cancel", selection, _LOADING_S)
        return int(answer["mission_id"])

    def ask(self, verb: str, arguments: Mapping[str, Any], limit_s: float) -> Any:
        """Send a request to the supervisor."""
        return self._connection.request(self._supervisor, verb, arguments, timeout_s=limit_s)

    def last_mission(self) -> dict[str, Any] | None:
        """Return the last mission with its result, empty while it is under way; None if none."""
        mission: dict[str, Any] | None = self.ask("mission", {}, _ANSWER_S)
        return mission

    def is_alive(self) -> bool:
        """Return whether the deployment still runs."""
        return self._connection.is_alive()

    def listen(self) -> AbstractContextManager[_Samples]:
        """Subscribe to the navigation status."""
        topic = f"{self._supervisor.rpartition('/')[0]}/navigation_status"
        domain = self._connection.domain
        key = keys.message_key(domain, topic, NavigationStatus)
        return self._connection.listen(key, latched=True)

    def next_status(self, samples: _Samples, wait_s: float) -> NavigationStatus | None:
        """Return the next status; None if none arrives in time, or if it is not valid."""
        try:
            sample = samples.get(timeout=wait_s)
            return self._codec.decode(NavigationStatus, sample.payload.to_bytes())
        except (queue.Empty, InvalidMessage):
            return None

    def await_active(self) -> None:
        """Wait until the supervisor answers; `CairnError` if it does not within the limit."""
        _, robot, component = self._supervisor.split("/")
        self._notify(
            f"{component} does not answer; if it hangs it is killed and restarted: "
            f"waiting up to {PATIENCE_S:g} s"
        )
        connection = self._connection
        topic = f"/{robot}/{STATUS_TOPIC}"
        key = keys.message_key(connection.domain, topic, ComponentStatus)
        deadline = time.monotonic() + PATIENCE_S
        with connection.listen(key) as samples:
            while (left_s := deadline - time.monotonic()) > 0 and connection.is_alive():
                try:
                    sample = samples.get(timeout=min(left_s, 1.0))
                    status = self._codec.decode(ComponentStatus, sample.payload.to_bytes())
                except (queue.Empty, InvalidMessage):
                    continue
                if status.component == component and status.state == _ACTIVE:
                    return
        if not connection.is_alive():
            raise CairnError(f"{component} does not answer: the deployment has ended")
        raise CairnError(
            f"{component} has not answered for {PATIENCE_S:g} s, and the robot may drive on: press "
            "Ctrl-C twice where `cairn up` runs, which ends everything at once (`cairn restart`, "
            "or Ctrl-C once, would wait for it)"
        )


class NavigationGoal:
    """A goal: iterate over its progress, await its result, cancel it. A context manager."""

    def __init__(self, navigator: Navigator, poses: Sequence[Sequence[float] | str]) -> None:
        self.mission_id = 0
        """Number of the mission, once it is accepted."""
        self.poses = poses
        self._navigator = navigator
        self._token = secrets.token_hex(8)
        self._listening = navigator.listen()
        self._samples: _Samples | None = None
        self._last = NavigationStatus()

    @property
    def ended(self) -> bool:
        """Whether the goal has its result."""
        return self._last.state in NAVIGATION_END_STATES

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self) -> int:
        """Send the goal to the supervisor and return its mission id, once it is accepted.

        If this is interrupted, the goal may have been accepted: `cancel` it.
        """
        self._samples = self._listening.__enter__()  # first, so that no status is missed
        goals = [pose if isinstance(pose, str) else list(pose) for pose in self.poses]
        arguments = {"goals": goals, "token": self._token}
        try:
            self.mission_id = int(self._navigator.ask("go", arguments, _LOADING_S)["mission_id"])
        except CairnError:
            self.close()
            raise
        return self.mission_id

    def close(self) -> None:
        """Stop listening to the goal's progress; the goal itself goes on."""
        if self._samples is not None:
            self._samples = None
            self._listening.__exit__(None, None, None)

    def cancel(self) -> int:
        """Cancel this goal; the robot stops. `CairnError` if it is not under way."""
        return self._navigator.cancel(token=self._token)

    def result(self, timeout_s: float) -> NavigationStatus:
        """Wait for the end of the goal and return its last status; `.state` says how it ended.

        Raises `CairnError` if it has not ended within `timeout_s` [s]; it is not canceled then.
        """
        for _ in self.progress(timeout_s):
            pass
        return self._last

    def __iter__(self) -> Iterator[NavigationStatus]:
        return self.progress()

    def progress(self, timeout_s: float = float("inf")) -> Iterator[NavigationStatus]:
        """Yield each status of the goal until it has ended; the last one has its result.

        Raises `CairnError` if the goal was preempted or lost, if the deployment has ended, or if
        the goal has not ended within `timeout_s` [s].
        """
        if self._samples is None:
            if self.ended:
                return
            raise CairnError("the goal was not sent, or its handle is closed")
        mission = self.mission_id
        deadline = time.monotonic() + timeout_s
        received = asked = time.monotonic()
        while True:
            status = self._navigator.next_status(self._samples, _POLL_S)
            now = time.monotonic()
            if status is not None and status.mission_id > mission:
                raise CairnError(f"mission {mission} was preempted by mission {status.mission_id}")
            if status is not None and status.mission_id == mission:
                received = now
            elif now - received > _SILENT_S and now - asked > 1.0:
                asked = now
                status = self._ask_supervisor(now - received)
            else:
                status = None
            if status is not None:
                self._last = status
                if self.ended:
                    self.close()
                    yield status
                    return
                yield status
            if now > deadline:
                raise CairnError(
                    f"mission {mission} has not ended within {timeout_s:g} s; cancel it, or wait "
                    "longer"
                )

    def _ask_supervisor(self, silent_s: float) -> NavigationStatus | None:
        """Return the result as the supervisor knows it, None if the goal is under way."""
        mission = self.mission_id
        if not self._navigator.is_alive():
            raise CairnError(f"mission {mission}: the deployment has ended, and with it the goal")
        try:
            known = self._navigator.last_mission()
        except ControlError as error:
            if silent_s > _GONE_S:
                raise CairnError(
                    f"mission {mission}: no status for {silent_s:.0f} s: {error}"
                ) from error
            return None
        ended = self._result_of(known, silent_s)
        if ended is None and silent_s > _LOADING_S:
            raise CairnError(
                f"mission {mission}: AutoMove has published no status for {silent_s:.0f} s; see "
                "`cairn ps` and `cairn logs`"
            )
        return ended

    def _result_of(
        self, known: Mapping[str, Any] | None, silent_s: float
    ) -> NavigationStatus | None:
        mission = self.mission_id
        if known is None or int(known["mission_id"]) < mission:
            if silent_s < _LOST_S:
                return None
            raise CairnError(
                f"mission {mission} was lost: its supervisor was restarted and does not know it; "
                "the robot stands"
            )
        if int(known["mission_id"]) > mission:
            raise CairnError(f"mission {mission} was preempted by mission {known['mission_id']}")
        state, _, reason = str(known["result"]).partition(": ")
        for number, name in NAVIGATION_STATES.items():
            if state == name:
                last = self._last
                return NavigationStatus(
                    mission_id=mission,
                    state=number,
                    goal=last.goal,
                    goals=last.goals,
                    elapsed=last.elapsed,
                    recoveries=last.recoveries,
                    reason=reason,
                )
        return None


def _expected(statuses: Mapping[str, ComponentStatus]) -> set[str]:
    """Return the supervisors that others mention: the bus soon forgets one that hangs."""
    found = set()
    for name, status in statuses.items():
        robot = name.rpartition("/")[0]
        if _PLUGIN in status.children:
            found.add(f"{robot}/{_PLUGIN}")
        if status.plugin == _AUTOMOVE and status.parent:
            found.add(f"{robot}/{status.parent}")
    return found
