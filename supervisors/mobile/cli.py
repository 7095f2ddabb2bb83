"""`cairn go`: send the robot to goals and print the progress; `cairn locate`: set its pose."""

from __future__ import annotations

import math
import re
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Annotated

import typer

from cairn import CairnError
from cairn.client import NavigationGoal, NoReplyError
from cairn.client import connect as connect_to
from cairn.client.navigation import MissionClient
from cairn.planar.messages import pose_message
from cairn.schemas.cairn_nav_msgs import NAVIGATION_STATES, NavigationStatus, zone_name_problem
from cairn.schemas.geometry_msgs import PoseWithCovariance, PoseWithCovarianceStamped
from cairn.schemas.message import type_name
from cairn.schemas.std_msgs import Header
from cairn.terminal import completion
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import OutputLost, line, note, print_json

_REPEAT_S = 5.0  # AutoMove publishes twice a second; an unchanged status is printed this often
_POSE_TOPIC = "initialpose"
_MAX_SHOWN = 10  # goals of a mission


def go(
    goal: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="X Y [HEADING] | PLACE | X,Y[,HEADING]...",
            help="Goal in meters in the map; heading in radians, or as 90deg; 0 by default. Or the "
            "name of a place on the map. Several goals, coordinates with commas, are driven to one "
            "after the other.",
            autocompletion=completion.places,
        ),
    ] = None,
    cancel: Annotated[
        bool, typer.Option("--cancel", help="Cancel the goal under way; the robot stops.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Print the progress until the result.")
    ] = True,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Send a robot to a goal; a new goal preempts the old one, Ctrl-C cancels it.

    Exit status 0 if the robot arrives, 1 if not; 130 after Ctrl-C, 143 after SIGTERM, 129 if the
    terminal is closed, each of which cancels the goal.
    """
    with _errors_as_json(as_json=json):
        if cancel and goal:
            raise CairnError("give a goal or --cancel, not both")
        goals = [] if cancel else parse_goals(goal or [])
    with connect_to(connect, domain, robot, notify=note) as client:
        with _errors_as_json(as_json=json):
            missions = client.missions()
            if cancel:
                _print_goal(missions.cancel(), "canceled", as_json=json)
            elif not wait:
                with missions.goal(goals) as sent:
                    _print_goal(sent.send(), "accepted", as_json=json)
        if wait and not cancel:
            follow(missions, goals, as_json=json)


def locate(
    pose: Annotated[
        list[str],
        typer.Argument(
            metavar="X Y [HEADING]",
            help="Pose of the robot, in meters in the map; heading in radians, or as 90deg; 0 by "
            "default.",
        ),
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Set the robot's pose in the map, to about half a meter and 15 degrees."""
    x, y, heading = _pose(pose, "pose")
    with connect_to(connect, domain, robot) as client:
        subscribed = {
            end.topic
            for end in client.connection.endpoints()
            if end.kind == "MS" and end.type_name == type_name(PoseWithCovarianceStamped)
        }
        if not any(topic.endswith(f"/{_POSE_TOPIC}") for topic in subscribed):
            raise CairnError(
                f"nothing subscribes to {_POSE_TOPIC}: no localizer runs; `cairn load localizer` "
                "starts it, or AutoMove with its parameter `load_plugins: on_activation`"
            )
        message = PoseWithCovarianceStamped(
            header=Header(frame_id="map"),
            pose=PoseWithCovariance(pose=pose_message((x, y, heading))),
        )
        topic = client.publish(_POSE_TOPIC, message)
    line(f"published on {topic}; `cairn topic echo localization` shows the uncertainty")


def follow(
    missions: MissionClient, goals: Sequence[Sequence[float] | str], *, as_json: bool
) -> None:
    """Send a goal and print its progress; Ctrl-C, SIGTERM and a closed terminal cancel it.

    Raises `CairnError` if the robot does not arrive, `SystemExit` after SIGTERM or SIGHUP.
    """
    with exit_on(signal.SIGTERM, signal.SIGHUP), ExitStack() as stack:
        with _errors_as_json(as_json=as_json):
            goal = stack.enter_context(missions.goal(goals))
        try:
            with _errors_as_json(as_json=as_json):
                goal.send()
            if not as_json:
                line(f"go to {_poses_text(goals)}; Ctrl-C cancels")
            status = print_progress(goal, as_json=as_json)
        except (KeyboardInterrupt, SystemExit, BrokenPipeError, OutputLost):
            _cancel(goal, as_json=as_json)
            raise
    if as_json:
        print_json(_fields(goal.id, status))
    if status.state != NavigationStatus.SUCCEEDED:
        state = "failed" if status.state == NavigationStatus.FAILED else "was canceled"
        raise CairnError(f"the goal {state} after {status.elapsed:.1f} s: {status.reason}")
    if not as_json:
        line(f"{status.elapsed:6.1f} s  {status.reason}")


def parse_goals(words: list[str]) -> list[list[float] | str]:
    """Return the goals of the command line: [x, y, heading], or the name of a place.

    Raises `CairnError` if they are invalid.
    """
    if not words:
        raise CairnError("give a goal, such as `cairn go 7.5 5.0 90deg`, or --cancel")
    if any("," in word for word in words) or not zone_name_problem(words[0]):
        return [
            word if not zone_name_problem(word) else _pose(word.split(","), "goal")
            for word in words
        ]
    return [_pose(words, "goal")]


def print_progress(goal: NavigationGoal, *, as_json: bool) -> NavigationStatus:
    """Print the progress of a goal and return its last status."""
    status = NavigationStatus()
    printed: tuple[int | str, ...] | None = None
    printed_at = 0.0
    cause = ""  # of the last one that was printed
    for status in goal:
        now = time.monotonic()
        loading = status.reason if status.state == NavigationStatus.LOADING else ""
        news = (status.state, status.goal, status.reason_code, status.recoveries, loading)
        is_due = news != printed or now - printed_at >= _REPEAT_S
        if is_due and not as_json and not goal.ended:
            printed, printed_at = news, now
            line(progress_line(status, cause))
            cause = cause_of(status) or cause
    return status


@contextmanager
def exit_on(*numbers: signal.Signals) -> Iterator[None]:
    """Turn signals into `SystemExit` with the status that a shell gives them."""
    handled = [one for one in numbers if signal.getsignal(one) is not signal.SIG_IGN]  # nohup

    def leave(number: int, _frame: object) -> None:
        for one in handled:  # a terminal that closes may hang up twice
            signal.signal(one, signal.SIG_IGN)
        raise SystemExit(128 + number)

    before = {number: signal.signal(number, leave) for number in handled}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def _cancel(goal: NavigationGoal, *, as_json: bool) -> None:
    with suppress(OSError, OutputLost):  # the terminal may have been closed
        try:
            goal.cancel()
        except CairnError as error:  # it has just ended, was preempted, or its robot has gone
            note(f"nothing is canceled: {error}")
            return
        if as_json:
            print_json({"goal_id": goal.id, "state": "canceled"})
        else:
            line("canceled: the robot stops")


@contextmanager
def _errors_as_json(*, as_json: bool) -> Iterator[None]:
    """Print an error as JSON too, if that is asked for."""
    try:
        yield
    except CairnError as error:
        if as_json:
            state = "unanswered" if isinstance(error, NoReplyError) else "refused"
            print_json({"state": state, "reason": str(error)})
        raise


def _print_goal(identity: str, state: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"goal_id": identity})
    else:
        line(f"goal {identity} is {state}")


def _pose_text(pose: Sequence[float]) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f}, {math.degrees(pose[2]):.0f} deg)"


def _poses_text(poses: Sequence[Sequence[float] | str]) -> str:
    shown = (one if isinstance(one, str) else _pose_text(one) for one in poses[:_MAX_SHOWN])
    text = ", then ".join(shown)
    more = len(poses) - _MAX_SHOWN
    return f"{text} and {more} more" if more > 0 else text


def cause_of(status: NavigationStatus) -> str:
    """Return what keeps the robot from its goal: the reason without the recovery behavior."""
    if status.state == NavigationStatus.RECOVERING:
        return status.reason.partition("): ")[2] or status.reason
    return status.reason


def _without_numbers(cause: str) -> str:
    """Return a cause without its ages and distances, which change while the cause does not."""
    return re.sub(r"\d+(\.\d+)?", "#", cause)


def progress_line(status: NavigationStatus, printed_cause: str = "") -> str:
    """Return the progress as a line.

    A cause that was printed last is not repeated, but for what holds the robot on its way.
    """
    of = f"goal {status.goal + 1} of {status.goals}: " if status.goals > 1 else ""
    left = ""
    is_driving = status.state == NavigationStatus.DRIVING
    if is_driving and status.distance_left > 0.0:
        left = f": {status.distance_left:.1f} m left"
        left += "" if status.reason else f", about {status.time_left:.0f} s"
    reason, cause = status.reason, cause_of(status)
    if cause and not is_driving and _without_numbers(cause) == _without_numbers(printed_cause):
        reason = reason.removesuffix(cause).removesuffix(": ")
    why = f"{', but' if left else ':'} {reason}" if reason else ""
    return f"{status.elapsed:6.1f} s  {of}{NAVIGATION_STATES[status.state]}{left}{why}"


def _fields(identity: str, status: NavigationStatus) -> dict[str, object]:
    return {
        "goal_id": identity,
        "mission_id": status.mission_id,
        "state": NAVIGATION_STATES[status.state],
        "goal": status.goal,
        "goals": status.goals,
        "elapsed_s": status.elapsed,
        "recoveries": status.recoveries,
        "reason": status.reason,
    }


def _pose(parts: list[str], kind: str) -> list[float]:
    given = f"{kind} {' '.join(parts)}"
    if len(parts) not in (2, 3):
        several = "; several goals each as X,Y[,HEADING]" if kind == "goal" else ""
        raise CairnError(f"{given}: write it as X Y [HEADING]{several}")
    x, y = (_number(part, given) for part in parts[:2])
    heading = 0.0
    if len(parts) == 3:
        digits = parts[2].strip().removesuffix("deg")
        heading = _number(digits, given)
        if digits != parts[2].strip():
            heading = math.radians(heading)
    return [x, y, math.remainder(heading, 2 * math.pi)]


def _number(text: str, given: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise CairnError(f"{given}: {text!r} is not a number") from None
    if not math.isfinite(value):
        raise CairnError(f"{given}: {text} must be finite")
    return value
