"""The `cairn` command: the table of its subcommands, and how it reports errors."""

import io
import logging
import os
import sys
from typing import Annotated

import typer

from cairn.cli.command_groups import LazyCommand, lazy_group
from cairn.errors import CairnError
from cairn.system.extras import missing_library
from cairn.system.files import allow_many_files, private_files
from cairn.system.kernel_compilation import before_compilation

COMMANDS_GROUP = "cairn.commands"
"""Entry points of this group add subcommands: a `typer.Typer`, or a function as typer takes it."""

_RUN = "Run a robot"
_INSPECT = "Inspect a running robot"
_CONTROL = "Control a running robot"
_RECORD = "Record and replay"
_MAPS = "Maps, objects, cameras and simulated worlds"
_DEVELOP = "Develop components and drivers"

COMMANDS = (
    LazyCommand("up", "cairn.cli.up:up",
                "Run a deployment until it ends or Ctrl-C.", _RUN),
    LazyCommand("check", "cairn.cli.check:check",
                "Check a deployment; report each problem with file and line.", _RUN),
    LazyCommand("deployments", "cairn.cli.check:deployments",
                "List the deployments that Cairn ships.", _RUN),
    LazyCommand("deploy", "cairn.cli.deploy:deploy",
                "Bring a deployment to other computers by ssh, and go back.", _RUN),
    LazyCommand("doctor", "cairn.cli.doctor.command:doctor",
                "Check this computer, and what a deployment needs of it.", _RUN),
    LazyCommand("security", "cairn.cli.security:app",
                "Make, renew and revoke certificates of machines and users.", _RUN),
    LazyCommand("ps", "cairn.cli.ps:ps",
                "List the components: state, process, load, losses.", _INSPECT),
    LazyCommand("machines", "cairn.cli.machines:machines",
                "List the machines of robots, and how their clocks differ.", _INSPECT),
    LazyCommand("fleet", "cairn.cli.fleet:fleet",
                "List the robots: health, missions, maps, and what they share.", _INSPECT),
    LazyCommand("view", "cairn.tools.terminal_map:view",
                "Show map, scan, pose and path of a robot, live.", _INSPECT),
    LazyCommand("console", "cairn.console.cli:console",
                "Show a running robot in a web browser, and steer it.", _INSPECT),
    LazyCommand("graph", "cairn.cli.graph:graph",
                "List the topics with their publishers and subscribers.", _INSPECT),
    LazyCommand("node", "cairn.cli.nodes:node",
                "List the nodes, those of ROS 2 too; show what one uses.", _INSPECT),
    LazyCommand("topic", "cairn.cli.topics:topic",
                "List, print, publish, plot and time messages.", _INSPECT),
    LazyCommand("service", "cairn.cli.services:service",
                "List and call services; run a robot as a service of systemd.", _INSPECT),
    LazyCommand("action", "cairn.cli.services:action",
                "List actions, and send goals to them.", _INSPECT),
    LazyCommand("tf", "cairn.cli.transforms:tf",
                "Show the tree of frames; print transforms.", _INSPECT),
    LazyCommand("logs", "cairn.cli.logs:logs",
                "Print the log messages of the components.", _INSPECT),
    LazyCommand("go", "cairn.supervisors.mobile.cli:go",
                "Send the robot to a goal, or cancel.", _CONTROL, negative_numbers=True),
    LazyCommand("zone", "cairn.components.map_builder.zone_cli:app",
                "List, add and remove zones on the robot's map.", _CONTROL),
    LazyCommand("locate", "cairn.supervisors.mobile.cli:locate",
                "Set the robot's pose in the map.", _CONTROL, negative_numbers=True),
    LazyCommand("explore", "cairn.tools.mapping.explore_cli:explore",
                "Explore until nothing reachable is unknown; save the map.", _CONTROL),
    LazyCommand("stop", "cairn.cli.control:stop",
                "Engage the emergency stop, or release it.", _CONTROL),
    LazyCommand("param", "cairn.cli.control:param",
                "List, read and set parameters.", _CONTROL),
    LazyCommand("load", "cairn.cli.control:load",
                "Start a component that is not loaded.", _CONTROL),
    LazyCommand("unload", "cairn.cli.control:unload",
                "Stop a component and leave it stopped.", _CONTROL),
    LazyCommand("restart", "cairn.cli.control:restart",
                "Stop a component and start it again.", _CONTROL),
    LazyCommand("record", "cairn.cli.record:record",
                "Record what is on the bus, for analysis and for tools of ROS 2.", _RECORD),
    LazyCommand("recorder", "cairn.cli.record:recorder",
                "Control the recorder of a running deployment.", _RECORD),
    LazyCommand("recording", "cairn.components.replay_devices.cli:app",
                "Show, cut, merge and export recordings.", _RECORD),
    LazyCommand("rerun", "cairn.rerun.cli:rerun",
                "Re-run recorded components exactly; find the first difference.", _RECORD),
    LazyCommand("map", "cairn.tools.mapping.cli:app",
                "Build, import and show grid maps and visual maps.", _MAPS),
    LazyCommand("object", "cairn.components.object_recognizer.proposal_cli:app",
                "Teach objects to the recognizer; accept proposed ones.", _MAPS),
    LazyCommand("recognize", "cairn.components.object_recognizer.recognize_cli:recognize",
                "Recognize taught objects in an image.", _MAPS),
    LazyCommand("camera", "cairn.tools.calibration.cli:app",
                "Calibrate a camera or a stereo pair.", _MAPS),
    LazyCommand("world", "cairn.components.simulation.cli:app",
                "Check and draw simulated worlds; change the running one.", _MAPS),
    LazyCommand("init", "cairn.cli.init:init",
                "Create a package for your own robot.", _DEVELOP),
    LazyCommand("plugins", "cairn.cli.plugins:plugins",
                "List the component classes that a deployment can name.", _DEVELOP),
    LazyCommand("schema", "cairn.cli.schemas:schema",
                "List, show, import and export the ROS 2 types.", _DEVELOP),
    LazyCommand("driver", "cairn.cli.command_groups:driver",
                "Try a device without a deployment.", _DEVELOP),
    LazyCommand("emulate", "cairn.cli.command_groups:emulate",
                "Emulate a device on a serial or TCP port.", _DEVELOP),
)  # fmt: skip
"""All commands of this distribution. Their modules are imported when they are invoked."""

_OF_THE_LAB = dict.fromkeys(("campaign", "evaluate", "experiment"), "cairn-lab")

_HELP = ["-h", "--help"]


def main() -> None:
    """Run the command; print an error of ours as one sentence on stderr and exit with status 1."""
    _open_missing_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a test replaces them
            stream.reconfigure(errors="backslashreplace")  # no locale makes a run fail
    logging.captureWarnings(True)
    before_compilation(_compile_in_helper)
    try:
        allow_many_files()
        with private_files():
            _check_folder()
            build()()
    except CairnError as error:
        _print_error(str(error))
        sys.exit(1)
    except ModuleNotFoundError as error:  # of an import where the library is used
        missing = missing_library(error)
        if missing is None:
            raise
        _print_error(f"the command needs {missing[0]}, which is not installed; {missing[1]}")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output, `head` perhaps, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at exit
        sys.exit(1)


def build() -> typer.Typer:
    """Return the command line."""
    app = typer.Typer(
        name="cairn",
        cls=lazy_group(
            COMMANDS,
            entry_points=COMMANDS_GROUP,
            packages=_OF_THE_LAB,
            negative_numbers=True,
        ),
        help="Component-based robot middleware over Zenoh, and a navigation system built on it.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"max_content_width": 100, "help_option_names": _HELP},
    )
    app.callback()(_options)
    return app


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        from cairn.terminal.output import line

        line(f"cairn {version('cairn-robotics')}, zenoh {version('eclipse-zenoh')}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version)
    ] = False,
) -> None:
    """Take the options that stand before a command."""


def _check_folder() -> None:
    try:
        os.getcwd()
    except OSError as error:
        raise CairnError("the current folder has been removed; change to another one") from error


def _compile_in_helper() -> None:
    from cairn.cli.kernel_helper import compile_in_helper

    compile_in_helper()


def _open_missing_streams() -> None:
    """Replace standard streams that the caller has closed (`cairn up ... >&-`).

    A socket must not get one of their numbers: a child would take it for the stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _print_error(text: str) -> None:
    from rich.console import Console  # takes 30 ms

    from cairn.runtime.log_output import printable

    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    console.print(f"cairn: {printable(text)}", style="red", markup=False)
