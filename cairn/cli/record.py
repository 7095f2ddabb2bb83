"""`cairn record`: record what is on the bus; `cairn recorder`: requests to a recorder component."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
import zenoh
from pydantic import ValidationError

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.graph import read_graph
from cairn.client import ControlError, NoReplyError
from cairn.client import connect as connect_to
from cairn.client.connection import Connection
from cairn.deployment.model import ROOT, Deployment
from cairn.errors import CairnError
from cairn.recording.recorder import McapRecorder, RecorderSettings, RecorderStatus
from cairn.recording.run_attachments import MessageClasses, as_json, run_attachments, versions
from cairn.recording.tap import ZenohTap
from cairn.recording.topics import TopicPatterns
from cairn.recording.triggers import Condition
from cairn.runtime.parameters import error_reason
from cairn.system.bell import Bell
from cairn.system.signal_handlers import signal_handlers
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, print_json

_ALIVE_S = 1.0
_GRAPH_LIMIT_S = 1.0
_REPLY_LIMIT_S = 15.0
_PARAMETERS_LIMIT_S = 0.5
_DEFAULTS = RecorderSettings()
_OPTIONS = {
    "topics": "TOPIC", "exclude": "--exclude", "compression": "--compression",
    "split_mb": "--split-size", "split_s": "--split-time", "disk_limit_mb": "--disk-limit",
    "keep_free_mb": "--keep-free", "queue_mb": "--memory", "last_s": "--last",
    "after_s": "--after", "buffer_mb": "--buffer", "triggers": "--trigger",
    "trigger_on_failure": "--trigger-on-failure",
}  # fmt: skip
"""The options by which the command takes the settings."""


def _option(setting: str) -> Any:
    """Return the option of a setting; its help is the setting's description."""
    text = RecorderSettings.model_fields[setting].description or ""
    for name, option in _OPTIONS.items():
        text = text.replace(f"`{name}`", option)
    return typer.Option(_OPTIONS[setting], help=text)


def record(
    topics: Annotated[
        list[str] | None,
        typer.Argument(
            help="Topics: `scan`, `/robot/scan`, or patterns such as `camera/*`. By default all.",
            metavar="[TOPIC]...",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="The file; by default recording-TIME.mcap in this folder."
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, help="End after this time [s].")
    ] = None,
    exclude: Annotated[list[str] | None, _option("exclude")] = None,
    compression: Annotated[str, _option("compression")] = _DEFAULTS.compression,
    split_size: Annotated[int, _option("split_mb")] = _DEFAULTS.split_mb,
    split_time: Annotated[float, _option("split_s")] = _DEFAULTS.split_s,
    disk_limit: Annotated[int, _option("disk_limit_mb")] = _DEFAULTS.disk_limit_mb,
    keep_free: Annotated[int, _option("keep_free_mb")] = _DEFAULTS.keep_free_mb,
    memory: Annotated[int, _option("queue_mb")] = _DEFAULTS.queue_mb,
    last: Annotated[float, _option("last_s")] = _DEFAULTS.last_s,
    after: Annotated[float, _option("after_s")] = _DEFAULTS.after_s,
    buffer: Annotated[int, _option("buffer_mb")] = _DEFAULTS.buffer_mb,
    trigger: Annotated[list[str] | None, _option("triggers")] = None,
    trigger_on_failure: Annotated[bool, _option("trigger_on_failure")] = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """Record the messages on the bus to an MCAP file, until Ctrl-C or the end of the deployment.

    Tools of ROS 2 and Foxglove read the file. It is readable at any moment, also if this command is
    killed. With --last, signal SIGUSR1 triggers as well: `kill -USR1 PID`.
    """
    settings = _settings(
        topics=topics or _DEFAULTS.topics,
        exclude=exclude or (),
        compression=compression,
        split_mb=split_size,
        split_s=split_time,
        disk_limit_mb=disk_limit,
        keep_free_mb=keep_free,
        queue_mb=memory,
        last_s=last,
        after_s=after,
        buffer_mb=buffer,
        triggers=trigger or (),
        trigger_on_failure=trigger_on_failure,
    )
    if (trigger or trigger_on_failure) and not last:
        raise CairnError("cairn record: a trigger needs --last SECONDS, the time to keep before it")
    path = output or Path(f"recording-{datetime.now(UTC):%Y%m%d-%H%M%S}.mcap")
    if output is not None and path.exists():
        raise CairnError(f"{path} exists; remove it, or choose another file with --output")
    connection = Connection.open(connect, domain)
    try:
        deployment, attachments = _run_of(connection, robot)
        find = MessageClasses(deployment).find
        recorder = McapRecorder(settings, path, attachments, find, robot=robot)
        with _bell() as (bell, ended):
            tap = ZenohTap(connection.session, domain, recorder.receive, recorder.topics)
            try:
                recorder.start(tap)
                with suppress(CairnError, zenoh.ZError):  # it is a hint only
                    _note_missing(connection, settings, robot)
                if not json:
                    files = recorder.status().files  # none before a trigger
                    note(f"recording to {files[0] if files else path}; Ctrl-C ends it")
                _wait(recorder, connection, bell, ended, duration)
            finally:
                tap.close()
                status = recorder.close()
    finally:
        connection.close()
    _print(status, as_json=json)
    if recorder.failure is not None:
        raise CairnError(f"{path}: recording failed: {recorder.failure}")
    if status.problem:
        raise CairnError(status.problem)


def _settings(**values: Any) -> RecorderSettings:
    try:
        return RecorderSettings(**values)
    except ValidationError as error:
        wrong = "; ".join(
            f"{_OPTIONS[str(one['loc'][0])]} {one['input']}: {error_reason(one)}"
            for one in error.errors()
        )
        raise CairnError(f"cairn record: {wrong}") from error


def _note_missing(connection: Connection, settings: RecorderSettings, robot: str) -> None:
    """Note the topics that have no publisher so far: their names may be misspelled."""
    pattern = keys.endpoints_pattern(connection.domain, kind="MP")
    graph = read_graph(connection.session, pattern, patience_s=_GRAPH_LIMIT_S)
    published = sorted({one.topic for one in graph if isinstance(one, keys.EndpointEntity)})
    wanted = [TopicPatterns([text], robot) for text in settings.topics]
    wanted += [Condition(text, robot).patterns for text in settings.triggers]
    shorts = {topic.split("/", 2)[-1]: topic for topic in published}
    for name, one in {one.patterns[0].removeprefix("/*/"): one for one in wanted}.items():
        if not any(map(one.match, published)):
            close = get_close_matches(name.split("/", 2)[-1], shorts)
            guess = f"; did you mean {' or '.join(shorts[found] for found in close)}?"
            note(f"{name} has no publisher so far{guess if close else ''}")


def _wait(
    recorder: McapRecorder,
    connection: Connection,
    bell: Bell,
    ended: list[int],
    duration: float | None,
) -> None:
    """Wait for a signal, the end of the deployment, or of the duration [s]; pass triggers on.

    Triggers of which none can work end it, too: nothing would be recorded.
    """
    deadline = None if duration is None else time.monotonic() + duration
    while recorder.failure is None and not recorder.cannot_trigger:
        left = _ALIVE_S if deadline is None else min(_ALIVE_S, deadline - time.monotonic())
        if left <= 0:
            return
        if bell.wait(left):
            while ended:
                if ended.pop() != signal.SIGUSR1:
                    return
                if recorder.continuous:
                    note("there is nothing to trigger: everything is recorded; see --last")
                else:
                    recorder.trigger("signal SIGUSR1")
        elif left == _ALIVE_S and not connection.is_alive():
            note("the deployment has ended")
            return


@contextmanager
def _bell() -> Iterator[tuple[Bell, list[int]]]:
    """Yield a bell that signals ring, and the list of those that have come."""
    bell = Bell()
    received: list[int] = []

    def on_signal(number: int, _: object) -> None:
        received.append(number)
        bell.ring()

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
    with signal_handlers(numbers, on_signal):
        yield bell, received


def _run_of(connection: Connection, robot: str) -> tuple[Deployment | None, dict[str, bytes]]:
    """Return the deployment of the only robot, or of that name, and what to attach about its run.

    Of several robots, or of one that does not answer, only the versions are attached.
    """
    nodes = [name for name in connection.nodes() if name.rpartition("/")[2] == ROOT]
    roots = [name for name in nodes if robot in ("", name.split("/")[1])]
    if len(roots) == 1:
        try:
            run = connection.request(roots[0], "run", timeout_s=_REPLY_LIMIT_S)
            deployment = Deployment.model_validate_json(run["deployment"])
        except (ControlError, NoReplyError, ValidationError) as error:
            note(f"the recording has no copy of the deployment: {error}")
        else:
            parameters = _parameters(connection, deployment)
            return deployment, run_attachments(
                deployment, parameters, seed=run["seed"], lockstep=run["lockstep"]
            )
    return None, {"versions.json": as_json(versions())}


def _parameters(connection: Connection, deployment: Deployment) -> dict[str, Any]:
    """Return the current parameters of the components that run."""
    running = set(connection.nodes())
    found: dict[str, Any] = {}
    for member in deployment.members():
        name = full_name(deployment.robot.name, member.name)
        if name in running:
            with suppress(ControlError, NoReplyError):  # it is ending, or hangs
                answer = connection.request(name, "parameters", timeout_s=_PARAMETERS_LIMIT_S)
                found[member.name] = {one["name"]: one["value"] for one in answer}
    return found


def recorder(
    action: Annotated[
        Literal["status", "trigger", "split", "pause", "resume"],
        typer.Argument(help="What it does. `trigger` is for a recorder with `last_s`."),
    ],
    reason: Annotated[str, typer.Option(help="With trigger: noted in the file.")] = "",
    component: Annotated[
        str, typer.Option(help="The recorder's name in the deployment.", metavar="NAME")
    ] = "recorder",
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """Control the recorder of a running deployment, and print its state."""
    arguments = {"reason": reason} if action == "trigger" and reason else {}
    with connect_to(connect, domain, robot) as client:
        answer = client.request(component, action, arguments, timeout_s=_REPLY_LIMIT_S)
    if json:
        print_json(answer)
        return
    line(f"{component}: {answer['text']}")
    for path in answer["files"]:
        line(path)


def _print(status: RecorderStatus, *, as_json: bool) -> None:
    if as_json:
        print_json(status.as_plain())
        return
    files = ", ".join(map(str, status.files)) or "nothing was triggered"
    line(f"{status.messages} messages, {status.size / 1e6:.1f} MB: {files}")
    for name, counts in (("dropped", status.dropped), ("lost", status.lost)):
        for topic, count in sorted(counts.items()):
            line(f"{name} {count} of {topic}")
    if status.refused:
        line(f"refused {status.refused} samples that are no messages, or of too many publishers")
