"""`cairn explore`: has the robot explore, and prints the progress."""

from __future__ import annotations

import math
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from cairn import CairnError
from cairn.client import Robot
from cairn.client import connect as connect_to
from cairn.schemas.cairn_nav_msgs import EXPLORATION_STATES, ExplorationStatus
from cairn.supervisors.mobile.cli import exit_on
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import OutputLost, line, note, print_json

_REPEAT_S = 5.0  # an unchanged status is printed this often
# The explorer publishes twice a second; a restarted one is back within this [s].
_SILENT_S = 30.0


def explore(
    save: Annotated[
        Path | None,
        typer.Option(metavar="OUT", help="Save the map at the end, as `cairn map save OUT`."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the files of the map OUT.")
    ] = False,
    stop: Annotated[
        bool, typer.Option("--stop", help="End the exploration under way; the robot stops.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Print the progress until the end.")
    ] = True,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Explore: drive to the borders of the map until nothing reachable is unknown.

    Ctrl-C ends the exploration. Exit status 0 if nothing that the robot can reach is unknown, 1 if
    the exploration ended before; 130 after Ctrl-C, 143 after SIGTERM, 129 if the terminal is
    closed.
    """
    if save is not None and (stop or not wait):
        raise CairnError("--save needs the end of the exploration: leave --stop and --no-wait out")
    with connect_to(connect, domain, robot, notify=note) as client:
        explorer = client.component_of("explorer")
        if explorer is None:
            raise CairnError(
                "no component explorer runs; start a deployment with one, such as "
                "`cairn up mapping`"
            )
        if stop:
            client.request(explorer, "stop")
            line("exploration ended: the robot stops")
            return
        if save is not None:
            from cairn.tools.mapping.live import check_target

            check_target(save, force=force)
        with exit_on(signal.SIGTERM, signal.SIGHUP):
            try:
                client.request(explorer, "explore")
                if not wait:
                    line("exploring; `cairn explore --stop` ends it")
                    return
                if not json:
                    line("exploring; Ctrl-C ends it")
                status = _follow(client, as_json=json)
            except (KeyboardInterrupt, SystemExit, BrokenPipeError, OutputLost):
                _stop(client, explorer)
                raise
        _print_end(status, as_json=json)
        if save is not None:
            from cairn.tools.mapping.live import print_saved, save_map

            print_saved(save_map(client, save, force=force), as_json=json)


def _follow(client: Robot, *, as_json: bool) -> ExplorationStatus:
    """Print the progress; return the status at the end."""
    printed: tuple[object, ...] = ()
    printed_at = 0.0
    # Subscribed after the request: the latched status is that of this exploration.
    with client.subscribe("exploration_status", ExplorationStatus, timeout_s=_SILENT_S) as statuses:
        for status in statuses:
            if status.state == ExplorationStatus.IDLE:
                raise CairnError("the explorer was restarted, and does not continue (state_file)")
            if status.state != ExplorationStatus.EXPLORING:
                return status
            if not status.known_area and not status.reason:
                continue  # the explorer has no map yet
            now = time.monotonic()
            news = (status.goal_x, status.goal_y)
            if not as_json and (str(news) != str(printed) or now - printed_at >= _REPEAT_S):
                printed, printed_at = news, now
                line(_progress(status))
    raise CairnError("the deployment has ended, and with it the exploration")


def _progress(status: ExplorationStatus) -> str:
    goal = ""
    if not math.isnan(status.goal_x):
        goal = f", next ({status.goal_x:.2f}, {status.goal_y:.2f})"
    if not status.known_area:  # what it waits for
        return f"{status.elapsed:6.1f} s  {status.reason}"
    reason = f": {status.reason}" if status.reason else ""
    return (
        f"{status.elapsed:6.1f} s  {status.known_area:.0f} m² are free, {status.frontiers} "
        f"{'frontier' if status.frontiers == 1 else 'frontiers'}{goal}{reason}"
    )


def _print_end(status: ExplorationStatus, *, as_json: bool) -> None:
    state = EXPLORATION_STATES[status.state]
    if as_json:
        print_json(
            {
                "state": state,
                "elapsed_s": status.elapsed,
                "known_area_m2": status.known_area,
                "frontiers": status.frontiers,
                "given_up": status.given_up,
                "reason": status.reason,
            }
        )
    if status.state != ExplorationStatus.FINISHED:
        raise CairnError(f"exploration {state} after {status.elapsed:.1f} s: {status.reason}")
    if not as_json:
        line(f"{status.elapsed:6.1f} s  {status.reason}; {status.known_area:.0f} m² are free")


def _stop(client: Robot, explorer: str) -> None:
    with suppress(OSError, OutputLost):  # the terminal may have been closed
        try:
            client.request(explorer, "stop")
        except CairnError as error:
            note(f"the exploration is not ended: {error}")
            return
        line("exploration ended: the robot stops")
