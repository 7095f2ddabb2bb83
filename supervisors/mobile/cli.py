"""`cairn go`: orders to move, and how they get on."""

import math
import queue
import time
from collections.abc import Iterator
from typing import Annotated

import typer

from cairn.bus import rmw
from cairn.bus.codec import Codec
from cairn.bus.control import request
from cairn.cli.connection import (
    DEFAULT_CONNECT,
    Connect,
    Connection,
    Domain,
    Json,
    Robot,
    connected,
    resolve,
)
from cairn.cli.tables import line, print_json
from cairn.errors import CairnError
from schemas.cairn_nav_msgs import MoveStatus
from schemas.message import InvalidMessage, type_name

_STATES = {
    MoveStatus.LOADING: "loading plugins",
    MoveStatus.LOCALIZING: "localizing",
    MoveStatus.PLANNING: "planning",
    MoveStatus.DRIVING: "driving",
    MoveStatus.RECOVERING: "recovering",
    MoveStatus.SUCCEEDED: "succeeded",
    MoveStatus.FAILED: "failed",
    MoveStatus.CANCELLED: "cancelled",
}
_ENDS = (MoveStatus.SUCCEEDED, MoveStatus.FAILED, MoveStatus.CANCELLED)
_LOADING_S = 60.0
# AutoMove tells twice a second how it gets on; it may be started anew meanwhile.
_SILENCE_S = 30.0


def go(
    goal: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="X Y [HEADING] | X,Y[,HEADING]...",
            help="Where to, in metres in the map; heading in radians, or as 90deg. Several goals, "
            "each with commas, are driven to one after the other.",
        ),
    ] = None,
    cancel: Annotated[
        bool, typer.Option("--cancel", help="Take the order back; the robot stands still.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Tell how it gets on until its result.")
    ] = True,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
) -> None:
    """Send a robot to a goal; a new order pre-empts the old one, Ctrl-C cancels it.

    Ends with status 0 if it arrives.
    """
    goals = [] if cancel else parse_goals(goal or [])
    with connected(connect, domain) as connection:
        names = [name for name in connection.statuses() if name.endswith("/mobile_supervisor")]
        supervisor = resolve(names, "mobile_supervisor", robot)
        if cancel:
            request(connection.session, domain, supervisor, "cancel", {}, timeout_s=_LOADING_S)
            line("cancelled")
            return
        topic = f"/{supervisor.split('/')[1]}/move_status"
        codec = Codec()
        wanted = type_name(MoveStatus)
        key = rmw.data_key(domain, topic, wanted, codec.type_hash(MoveStatus))
        with connection.listen(key, latched=True) as samples:
            answer = request(
                connection.session,
                domain,
                supervisor,
                "go",
                {"goals": goals},
                timeout_s=_LOADING_S,
            )
            order = int(answer["order_id"])
            if not wait:
                print_json({"order_id": order}) if json else line(f"order {order} given")
                return
            _follow(connection, supervisor, order, _statuses(samples, codec), as_json=json)


def parse_goals(words: list[str]) -> list[list[float]]:
    """Goals [x, y, heading] of the command line; `CairnError` says what is wrong."""
    if not words:
        raise CairnError("give a goal, such as `cairn go 7.5 5.0 90deg`, or --cancel")
    if any("," in word for word in words):
        return [_goal(word.split(",")) for word in words]
    return [_goal(words)]


def _goal(parts: list[str]) -> list[float]:
    given = " ".join(parts)
    if len(parts) not in (2, 3):
        raise CairnError(
            f"goal {given}: write it as X Y [HEADING]; several goals each as X,Y[,HEADING]"
        )
    x, y = (_number(part, given) for part in parts[:2])
    heading = 0.0
    if len(parts) == 3:
        turned = parts[2].removesuffix("deg")
        heading = _number(turned, given)
        if turned != parts[2]:
            heading = math.radians(heading)
    return [x, y, math.remainder(heading, 2 * math.pi)]


def _number(text: str, given: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise CairnError(f"goal {given}: {text!r} is not a number") from None
    if not math.isfinite(value):
        raise CairnError(f"goal {given}: {text} must be finite")
    return value


def _statuses(samples: "queue.Queue[object]", codec: Codec) -> Iterator[MoveStatus | None]:
    """What is told, one after the other; None when nothing has come for a second."""
    while True:
        try:
            sample = samples.get(timeout=1.0)
        except queue.Empty:
            yield None
            continue
        try:
            yield codec.decode(MoveStatus, sample.payload.to_bytes())  # type: ignore[attr-defined]
        except InvalidMessage:
            continue


def _follow(
    connection: Connection,
    supervisor: str,
    order: int,
    statuses: Iterator[MoveStatus | None],
    *,
    as_json: bool,
) -> None:
    told: tuple[int, int, str] | None = None
    heard = time.monotonic()
    try:
        for status in statuses:
            if status is None:
                if time.monotonic() - heard > _SILENCE_S:
                    raise CairnError(
                        f"nothing was heard of order {order} for {_SILENCE_S:.0f} s; "
                        "see `cairn ps` and `cairn logs`"
                    )
                continue
            if status.order_id > order:
                raise CairnError(f"order {order} was pre-empted by order {status.order_id}")
            if status.order_id != order:
                continue
            heard = time.monotonic()
            now = (status.state, status.goal, status.reason)
            if now != told and not as_json:
                told = now
                line(_sentence(status))
            if status.state in _ENDS:
                if as_json:
                    print_json(_fields(status))
                if status.state != MoveStatus.SUCCEEDED:
                    raise CairnError(f"{_STATES[status.state]}: {status.reason}")
                return
    except KeyboardInterrupt:
        request(
            connection.session, connection.domain, supervisor, "cancel", {}, timeout_s=_LOADING_S
        )
        line("cancelled")
        raise


def _sentence(status: MoveStatus) -> str:
    of = f" goal {status.goal + 1} of {status.goals}:" if status.goals > 1 else ""
    left = ""
    if status.state in (MoveStatus.DRIVING, MoveStatus.PLANNING):
        left = f", {status.distance_left:.1f} m left, about {status.time_left:.0f} s"
    why = f": {status.reason}" if status.reason else ""
    ends = status.state in _ENDS
    return f"{status.elapsed:6.1f} s {'' if ends else of} {_STATES[status.state]}{left}{why}"


def _fields(status: MoveStatus) -> dict[str, object]:
    return {
        "order_id": status.order_id,
        "state": _STATES[status.state],
        "goal": status.goal,
        "goals": status.goals,
        "elapsed_s": status.elapsed,
        "recoveries": status.recoveries,
        "reason": status.reason,
    }
