"""Goals for a robot: send, follow, cancel."""

from __future__ import annotations

import math
import queue
import secrets
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, Final

from cairn.bus import keys
from cairn.bus.actions import CANCEL_GOAL, UnknownGoalError, uuid_of
from cairn.bus.bus import ServiceError
from cairn.bus.codec import Codec
from cairn.client.connection import STATUS_TOPIC, Connection, resolve
from cairn.client.services import RunningGoal, call_service
from cairn.errors import CairnError
from cairn.schemas.action_msgs.msg import GoalInfo, GoalStatus
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.cairn_nav_msgs import (
    MAX_COORDINATE,
    MAX_GOALS,
    NAVIGATION_END_STATES,
    NavigationStatus,
    Zone,
    Zones,
)
from cairn.schemas.geometry_msgs import Point, Pose, PoseStamped, Quaternion
from cairn.schemas.message import InvalidMessage
from cairn.schemas.nav2_msgs.action import NavigateThroughPoses
from cairn.schemas.std_msgs import Header
from cairn.system.closing import Closing

_PLUGIN, _AUTOMOVE = "mobile_supervisor", "automove"
_ACTION: Final = "navigate_through_poses"
_ACTIONS: Final = (_ACTION, "navigate_to_pose", "follow_waypoints", "spin", "back_up")
_ACTIVE = "active"
# The supervisor above kills one that hangs after `hang_timeout_s` and 3 s more, and restarts it.
PATIENCE_S = 30.0
_LOADING_S = 90.0  # longer than a component takes to start, by default
_POLL_S = 0.2
# The end of a goal comes on two ways: as the result, and as AutoMove's last status.
_LAST_STATUS_S = 1.0
_PLACES_S = 2.0

PlanarPose = tuple[float, float, float]


class DeploymentEnded(CairnError):
    """A deployment whose supervisor was awaited has ended."""


def find_place(zones: Sequence[Zone], name: str) -> PlanarPose:
    """Return x, y [m] and heading [rad], 0 if it does not matter, of a named place.

    Raises `CairnError` with the names of the places that there are.
    """
    places = {zone.name: zone for zone in zones if zone.kind == Zone.PLACE}
    place = places.get(name)
    if place is None:
        known = ", ".join(sorted(places)) or "none; `cairn zone add` adds one"
        raise CairnError(f"{name}: no such place on the map; the places are: {known}")
    x, y = place.points.tolist()
    return x, y, 0.0 if math.isnan(place.heading) else place.heading


class MissionClient:
    """Sends goals to a supervisor that carries out missions, and cancels them."""

    def __init__(self, connection: Connection, supervisor: str, notify: Callable[[str], None]):
        """`supervisor` is its full name (`/robot/mobile_supervisor`)."""
        self._connection = connection
        self._supervisor = supervisor
        self._robot = supervisor.rpartition("/")[0]
        self._notify = notify
        self._codec = Codec()

    @classmethod
    def find(
        cls, connection: Connection, robot: str, notify: Callable[[str], None]
    ) -> MissionClient:
        """Return the supervisor of a robot that accepts goals, once it answers.

        Raises `CairnError` if there is none, or if it does not answer within the limit.
        """
        found = connection.find(_supervisors)
        if not found:
            raise CairnError(
                f"no {_PLUGIN} runs here that accepts goals; start a deployment with one, such as "
                f"`cairn up sim`{connection.elsewhere()}"
            )
        name = resolve(found, min(found).rpartition("/")[2], robot)
        missions = cls(connection, name, notify)
        if not found[name]:
            missions.await_active()
        return missions

    def goal(self, poses: Sequence[Sequence[float] | str]) -> NavigationGoal:
        """Return a goal of poses [x, y, theta] in frame map or names of places, not sent yet.

        Raises `CairnError` if there are too many poses, or if one is not valid or not known.
        """
        if len(poses) > MAX_GOALS:
            raise CairnError(
                f"{len(poses):,} goals: a mission has at most {MAX_GOALS:,}; send the further ones "
                "when it has ended"
            )
        zones = self._zones() if any(isinstance(pose, str) for pose in poses) else ()
        return NavigationGoal(
            self, [_resolved(number, pose, zones) for number, pose in enumerate(poses, 1)]
        )

    def send(self, poses: Sequence[PlanarPose], identity: bytes) -> RunningGoal[Any, Any, Any]:
        """Send a goal of that id to the supervisor; it is not accepted yet."""
        return RunningGoal(
            self._connection,
            f"{self._robot}/{_ACTION}",
            NavigateThroughPoses,
            NavigateThroughPoses.Goal(poses=tuple(_stamped(pose) for pose in poses)),
            _LOADING_S,
            identity,
        )

    def cancel(self, identity: bytes | None = None) -> str:
        """Cancel the goal under way, or only the one with that id; return its id in hexadecimal.

        Raises `CairnError` if it is not under way.
        """
        actions: Sequence[str] = _ACTIONS
        wanted = GoalInfo()
        if identity is not None:
            actions, wanted = (_ACTION,), GoalInfo(goal_id=uuid_of(identity))
        try:
            canceled = self._cancel(actions, wanted)
        except ServiceError:  # it hung and was killed; once restarted, it resumes the goal
            self.await_active()
            canceled = self._cancel(actions, wanted)
        if not canceled:
            which = "there is no goal" if identity is None else "this goal is not"
            raise CairnError(f"{self._supervisor.rpartition('/')[2]}: {which} under way")
        return canceled[-1].goal_id.uuid.tobytes().hex()

    def listen(self) -> AbstractContextManager[queue.Queue[Any]]:
        """Subscribe to the navigation status."""
        topic = f"{self._robot}/navigation_status"
        key = keys.message_key(self._connection.domain, topic, NavigationStatus)
        return self._connection.listen(key, latched=True)

    def next_status(self, samples: queue.Queue[Any], wait_s: float) -> NavigationStatus | None:
        """Return the next status; None if none arrives in time, or if it is not valid."""
        try:
            sample = samples.get(timeout=wait_s)
            return self._codec.decode(NavigationStatus, sample.payload.to_bytes())
        except (queue.Empty, InvalidMessage):
            return None

    def await_active(self) -> None:
        """Wait until the supervisor answers; `CairnError` if it does not within the limit.

        `DeploymentEnded` if the deployment ends meanwhile.
        """
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
            while (left_s := deadline - time.monotonic()) > 0:
                if not connection.is_alive():
                    raise DeploymentEnded(f"{component} does not answer: the deployment has ended")
                try:
                    sample = samples.get(timeout=min(left_s, 1.0))
                    status = self._codec.decode(ComponentStatus, sample.payload.to_bytes())
                except (queue.Empty, InvalidMessage):
                    continue
                if status.component == component and status.state == _ACTIVE:
                    return
        raise CairnError(
            f"{component} has not answered for {PATIENCE_S:g} s, and the robot may drive on: press "
            "Ctrl-C twice where `cairn up` runs, which ends everything at once (`cairn restart`, "
            "or Ctrl-C once, would wait for it)"
        )

    def _cancel(self, actions: Sequence[str], wanted: GoalInfo) -> list[GoalInfo]:
        """Cancel a goal, or all if it has no id; return those that are canceled."""
        canceled: list[GoalInfo] = []
        for action in actions:
            service = f"{self._robot}/{action}/{CANCEL_GOAL}"
            request = CancelGoal.Request(goal_info=wanted)
            answer = call_service(self._connection, service, CancelGoal, request, _LOADING_S)
            canceled += answer.goals_canceling
        return canceled

    def _zones(self) -> Sequence[Zone]:
        """Return the zones on the robot's map."""
        key = keys.message_key(self._connection.domain, f"{self._robot}/zones", Zones)
        with self._connection.listen(key, latched=True) as samples:
            try:
                sample = samples.get(timeout=_PLACES_S)
                return self._codec.decode(Zones, sample.payload.to_bytes()).zones
            except (queue.Empty, InvalidMessage):
                raise CairnError(
                    "the places on the map are not known, as no map builder with a zones_file has "
                    "run; `cairn load map_builder` starts it, or a goal by coordinates"
                ) from None


class NavigationGoal(Closing):
    """A goal: iterate over its progress, await its result, cancel it. A context manager."""

    def __init__(self, missions: MissionClient, poses: Sequence[PlanarPose]) -> None:
        self.poses = poses
        """x, y [m], heading [rad] in frame map."""
        self._missions = missions
        self._identity = secrets.token_bytes(16)
        self._listening = missions.listen()
        self._samples: queue.Queue[Any] | None = None
        self._running: RunningGoal[Any, Any, Any] | None = None
        self._last = NavigationStatus(goals=len(poses))

    @property
    def id(self) -> str:
        """Its id: 32 hexadecimal digits."""
        return self._identity.hex()

    @property
    def ended(self) -> bool:
        """Whether the goal has its result."""
        return self._last.state in NAVIGATION_END_STATES

    def send(self) -> str:
        """Send the goal to the supervisor and return its id, once it is accepted.

        If this is interrupted, the goal may have been accepted: `cancel` it.
        """
        self._samples = self._listening.__enter__()  # first, so that no status is missed
        try:
            self._running = self._missions.send(self.poses, self._identity)
            self._running.await_acceptance()
        except CairnError:
            self.close()
            raise
        return self.id

    def close(self) -> None:
        """Stop listening to the goal's progress; the goal itself goes on."""
        if self._samples is not None:
            self._samples = None
            self._listening.__exit__(None, None, None)
        if self._running is not None:
            self._running.close()

    def cancel(self) -> None:
        """Cancel this goal; the robot stops. `CairnError` if it is not under way."""
        if self._running is not None:  # the supervisor must not get its cancellation first
            self._running.await_acceptance()
        self._missions.cancel(self._identity)

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

        A goal that another one preempts has failed. Raises `CairnError` if the goal was lost, if
        the deployment has ended, or if the goal has not ended within `timeout_s` [s].
        """
        if self._samples is None or self._running is None:
            if self.ended:
                return
            raise CairnError("the goal was not sent, or its handle is closed")
        deadline = time.monotonic() + timeout_s
        heard = time.monotonic()
        while not self.ended:
            status = self._next_status(self._samples, _POLL_S)
            is_last = status is not None and status.state in NAVIGATION_END_STATES
            if self._running.await_end(_LAST_STATUS_S if is_last else 0.0):
                self._end(self._samples, self._running, status)
            elif status is not None and not is_last:
                heard = time.monotonic()
                self._last = status
                yield status
            elif time.monotonic() - heard > _LOADING_S:
                raise CairnError(
                    f"AutoMove has published no status of the goal for {_LOADING_S:.0f} s; see "
                    "`cairn ps` and `cairn logs`"
                )
            if time.monotonic() > deadline and not self.ended:
                raise CairnError(
                    f"the goal has not ended within {timeout_s:g} s; cancel it, or wait longer"
                )
        self.close()
        yield self._last

    def _next_status(self, samples: queue.Queue[Any], wait_s: float) -> NavigationStatus | None:
        """Return the next status of this goal, None if there is none in time."""
        deadline = time.monotonic() + wait_s
        while (left_s := deadline - time.monotonic()) > 0:
            status = self._missions.next_status(samples, left_s)
            if status is not None and status.goal_id.uuid.tobytes() == self._identity:
                return status
        return None

    def _end(
        self,
        samples: queue.Queue[Any],
        running: RunningGoal[Any, Any, Any],
        status: NavigationStatus | None,
    ) -> None:
        """Note the result; follow the goal further if its supervisor was restarted."""
        try:
            outcome, result = running.result()
        except UnknownGoalError:
            raise CairnError(
                "the goal was lost: its supervisor was restarted and does not know it; the robot "
                "stands"
            ) from None
        except ServiceError:
            self._continue(running)
            return
        if outcome == GoalStatus.STATUS_ABORTED and not result.error_code:  # it was deactivated
            self._continue(running)
            return
        last = self._last if status is None else status
        deadline = time.monotonic() + _LAST_STATUS_S
        # The result may overtake the last statuses, of which only the very last one has its reason.
        while outcome == GoalStatus.STATUS_SUCCEEDED and last.state not in NAVIGATION_END_STATES:
            status = self._next_status(samples, deadline - time.monotonic())
            if status is None:
                break
            last = status
        self._last = replace(
            last,
            goal_id=uuid_of(self._identity),
            state=_STATES.get(outcome, NavigationStatus.FAILED),
            distance_left=0.0,
            time_left=0.0,
            reason=result.error_msg or last.reason,
        )

    def _continue(self, running: RunningGoal[Any, Any, Any]) -> None:
        """Wait until the supervisor, which has ended, is restarted, and await the result again."""
        try:
            self._missions.await_active()
        except DeploymentEnded:
            raise CairnError("the deployment has ended, and with it the goal") from None
        running.resume()


_STATES: Final = {
    GoalStatus.STATUS_SUCCEEDED: NavigationStatus.SUCCEEDED,
    GoalStatus.STATUS_CANCELED: NavigationStatus.CANCELED,
}


def _resolved(number: int, pose: Sequence[float] | str, zones: Sequence[Zone]) -> PlanarPose:
    """Return a pose, also of a place; `CairnError` if it is not valid or not known."""
    try:
        if isinstance(pose, str):
            return find_place(zones, pose)
        x, y, theta = (float(value) for value in pose)
    except CairnError as error:
        raise CairnError(f"goal {number}: {error}") from error
    if not all(abs(value) <= MAX_COORDINATE for value in (x, y, theta)):  # nor NaN
        raise CairnError(
            f"goal {number} = {list(pose)!r}: x, y and heading must be finite, and at most "
            f"{MAX_COORDINATE:g}"
        )
    return x, y, theta


def _stamped(pose: PlanarPose) -> PoseStamped:
    x, y, theta = pose
    turn = Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    return PoseStamped(
        header=Header(frame_id="map"), pose=Pose(position=Point(x=x, y=y), orientation=turn)
    )


def _supervisors(statuses: Mapping[str, ComponentStatus]) -> dict[str, bool]:
    """Return by full name whether each is active; those that others mention are not.

    The bus soon forgets one that hangs.
    """
    mentioned = set()
    for name, status in statuses.items():
        robot = name.rpartition("/")[0]
        if _PLUGIN in status.children:
            mentioned.add(f"{robot}/{_PLUGIN}")
        if status.plugin == _AUTOMOVE and status.parent:
            mentioned.add(f"{robot}/{status.parent}")
    found = dict.fromkeys(mentioned - statuses.keys(), False)
    for name, status in statuses.items():
        if status.plugin == _PLUGIN:
            found[name] = status.state == _ACTIVE
    return found
