"""`cairn go`: orders to move, and how they get on; `cairn locate`: where the robot is."""

import math
from typing import Annotated

import typer

from cairn import CairnError
from cairn.cli.connection import DEFAULT_CONNECT, Connect, Domain, Json, Robot, connected
from cairn.cli.tables import line, print_json
from cairn.supervisors.mobile.following import Operator, follow, refusals_told
from cairn.supervisors.mobile.locating import point_out
from cairn.supervisors.mobile.reaching import reach


def go(
    goal: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="X Y [HEADING] | X,Y[,HEADING]...",
            help="Where to, in meters in the map; heading in radians, or as 90deg; 0 if not given. "
            "Several goals, each with commas, are driven to one after the other.",
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

    Ends with status 0 if it arrives, 1 if not; 130 after Ctrl-C, 143 after SIGTERM, 129 if its
    terminal is closed, which cancel too.
    """
    with refusals_told(as_json=json):
        if cancel and goal:
            raise CairnError("give a goal or --cancel, not both")
        goals = [] if cancel else parse_goals(goal or [])
    with connected(connect, domain) as connection:
        with refusals_told(as_json=json):
            operator = Operator(connection, reach(connection, robot))
            if cancel:
                _tell(operator.cancel(), "canceled", as_json=json)
            elif not wait:
                _tell(operator.go(goals), "given", as_json=json)
        if wait and not cancel:
            follow(operator, goals, as_json=json)


def locate(
    place: Annotated[
        list[str],
        typer.Argument(
            metavar="X Y [HEADING]",
            help="Where the robot is, in meters in the map; heading in radians, or as 90deg; 0 if "
            "not given.",
        ),
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
) -> None:
    """Tell a robot where it is, to about half a meter and 15 degrees."""
    x, y, heading = _pose(place, "place")
    with connected(connect, domain) as connection:
        topic = point_out(connection, robot, (x, y, heading))
    line(f"told on {topic}; `cairn topic echo localization` shows how sure the robot is")


def _tell(order: int, what: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"mission_id": order})
    else:
        line(f"order {order} is {what}")


def parse_goals(words: list[str]) -> list[list[float]]:
    """Goals [x, y, heading] of the command line; `CairnError` says what is wrong."""
    if not words:
        raise CairnError("give a goal, such as `cairn go 7.5 5.0 90deg`, or --cancel")
    if any("," in word for word in words):
        return [_pose(word.split(","), "goal") for word in words]
    return [_pose(words, "goal")]


def _pose(parts: list[str], what: str) -> list[float]:
    given = f"{what} {' '.join(parts)}"
    if len(parts) not in (2, 3):
        several = "; several goals each as X,Y[,HEADING]" if what == "goal" else ""
        raise CairnError(f"{given}: write it as X Y [HEADING]{several}")
    x, y = (_number(part, given) for part in parts[:2])
    heading = 0.0
    if len(parts) == 3:
        turned = parts[2].strip().removesuffix("deg")
        heading = _number(turned, given)
        if turned != parts[2].strip():
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
