"""The deployment under a campaign: launched by `cairn up`, observed and disturbed from outside."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import psutil
import zenoh

import cairn.client
from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.codec import Codec
from cairn.campaign.faults import SkippedFault
from cairn.campaign.observations import (
    ROOT,
    DeploymentEnded,
    LogLine,
    Processes,
    ProcessSample,
)
from cairn.campaign.programs import Programs
from cairn.deployment.load import assemble, read_sources
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.schemas.message import InvalidMessage
from cairn.supervision.orphan_cleanup import set_parent_death_signal
from cairn.testing.launching import Launching, Run, title_of

_START_LIMIT_S = 180.0
_POLL_S = 0.2
_END_LIMIT_S = 60.0
_LEFT_LIMIT_S = 10.0
_LAST_LINES = 12
_TITLE = "cairn: "


class CampaignRobot:
    """A deployment that runs, its processes, its topics, and a client connected to it."""

    def __init__(
        self,
        launch: Launching,
        file: Path,
        arguments: list[str],
        report: Path,
        programs: Programs,
    ) -> None:
        """`file` and `arguments` are those of `cairn up`; nothing is launched yet.

        Raises `DeploymentError` if the deployment cannot be read.
        """
        self._launch = launch
        self._file = file
        self._arguments = arguments
        self.report = report
        """The report folder of the deployment: of all its launches."""
        self.deployment = read_deployment(file, arguments)
        self.components = tuple(
            member.name
            for member in self.deployment.members()
            if member.spec.placement == "process"
        )
        """The components that have a process of their own, in start order."""
        self.programs = programs
        """The programs that run beside it."""
        self._launches = 0
        self._overdue: list[str] = []
        self._run: Run | None = None
        self._client: cairn.client.Robot | None = None
        self._lines = 0
        self._topics: list[keys.EndpointEntity] = []
        self._subscribers: list[Any] = []
        self.forgers: set[bytes] = set()
        """The identities (gid) under which faults publish: `observe` leaves out their messages."""

    @property
    def run(self) -> Run:
        """The present launch."""
        assert self._run is not None, "the deployment is not launched"
        return self._run

    @property
    def client(self) -> cairn.client.Robot:
        """A client of the present launch."""
        assert self._client is not None, "the deployment is not launched"
        return self._client

    def launch(self, connected: Callable[[], None] = lambda: None) -> None:
        """Launch the deployment, again in the same report folder, until all components are active.

        `connected` is called as soon as `client` is connected. Raises `CairnError` with the last
        line of `cairn up` if they do not become active.
        """
        self._run = self._launch(
            self._file,
            "--plain",
            *self._arguments,
            report=self.report,
            process_group=0,  # Ctrl-C is for the campaign, which stops the deployment itself
            preexec_fn=lambda: set_parent_death_signal(signal.SIGTERM),
        )
        self._lines = 0
        deadline = time.monotonic() + _START_LIMIT_S
        while not self._is_active(connected):
            if self.run.process.poll() is not None:
                raise CairnError(f"the deployment does not start: {self._last_line()}")
            if time.monotonic() > deadline:
                raise CairnError(
                    f"the deployment is not active after {_START_LIMIT_S:g} s; see {self.run.logs}"
                )
            time.sleep(_POLL_S)
        self._topics = sorted(
            (end for end in self.client.connection.endpoints() if end.kind == "MS"),
            key=lambda end: (end.topic, end.node.name),
        )

    @property
    def is_launched(self) -> bool:
        """Whether it was launched, and its end is not handled yet by `close`."""
        return self._run is not None

    def has_ended(self) -> bool:
        """Return whether `cairn up` has ended."""
        return self._run is None or self._run.process.poll() is not None

    def stop(self) -> None:
        """Stop the deployment, as Ctrl-C does."""
        self.run.process.send_signal(signal.SIGINT)
        self.await_end()

    def close(self, at_s: float, *, expected: bool) -> DeploymentEnded:
        """Disconnect from a deployment that has ended; return how, with the processes it left."""
        self._subscribers.clear()  # they end with their session
        if self._client is not None:
            with suppress(CairnError, zenoh.ZError):
                self._client.close()
            self._client = None
        run, self._run = self.run, None
        left, self._overdue = [*self._overdue, *run.kill_left(_LEFT_LIMIT_S)], []
        code = run.await_end()
        self._launches += 1
        if run.logs.is_dir():  # the next launch would begin new ones
            run.logs.rename(self.report.with_name(f"logs{self._launches}"))
        last = tuple(line.rstrip("\n") for line in run.lines[-_LAST_LINES:])
        return DeploymentEnded(at_s, expected, code, run.report, tuple(left), last)

    def await_end(self) -> None:
        """Wait until `cairn up` has ended, and all that it has printed is in `new_lines`.

        If it does not end in time it is killed, and counts as left in `close`.
        """
        run = self.run
        try:
            run.await_end(_END_LIMIT_S)
        except AssertionError:
            self._overdue.append(f"{run.process.pid} cairn up, within {_END_LIMIT_S:g} s,")
            run.process.kill()
            run.await_end()

    def new_lines(self, at_s: float) -> list[LogLine]:
        """Return what `cairn up` has printed since the last call."""
        if self._run is None:
            return []
        lines = self._run.lines[self._lines :]
        self._lines += len(lines)
        return [LogLine.parsed(at_s, line) for line in lines if line.strip()]

    def processes(self) -> Processes:
        """Return a sample of all processes of the run."""
        found: dict[int, ProcessSample] = {}
        if self._run is None:
            return found
        names: dict[int, str] = {}
        listed = self._run.processes()
        for process in listed:
            names[process.pid] = self._name_of(process)
        for process in listed:
            with suppress(psutil.NoSuchProcess), process.oneshot():
                name, parent = names[process.pid], names.get(process.ppid(), "")
                found[process.pid] = ProcessSample(
                    pid=process.pid,
                    name=name,
                    parent=parent,
                    is_component=name in self.components and parent != name,
                    created_s=process.create_time(),
                    memory_mib=process.memory_info().rss / 2**20,
                    descriptors=process.num_fds(),
                    threads=process.num_threads(),
                )
        return found

    def process(self, name: str) -> psutil.Process:
        """Return the process of a component, the `root` or the `zygote`.

        Raises `SkippedFault` if it does not run, or is just being forked.
        """
        if name == ROOT:
            return psutil.Process(self.run.process.pid)
        names = {one.pid: self._name_of(one) for one in self.run.processes()}
        found = []
        for pid in [pid for pid, known in names.items() if known == name]:
            with suppress(psutil.NoSuchProcess):
                process = psutil.Process(pid)
                if names.get(process.ppid()) != name:  # not one that it has forked
                    found.append(process)
        if len(found) != 1:
            raise SkippedFault(f"{name} does not run" if not found else f"{name} just starts")
        return found[0]

    def matching(self, patterns: tuple[str, ...], exclude: tuple[str, ...]) -> list[str]:
        """Return the components with a process of their own whose names match, in start order."""
        return [
            name
            for name in self.components
            if any(fnmatchcase(name, one) for one in patterns)
            and not any(fnmatchcase(name, one) for one in exclude)
        ]

    def subscribed_topics(
        self, patterns: tuple[str, ...], exclude: tuple[str, ...]
    ) -> list[tuple[str, str]]:
        """Return the topics (full names) that components subscribe to, and their data keys, sorted.

        The patterns are those of names without the robot's.
        """
        found: dict[tuple[str, str], None] = {}
        for end in self._topics:
            short = end.topic.removeprefix(f"/{self.deployment.robot}/")
            if any(fnmatchcase(short, one) for one in patterns) and not any(
                fnmatchcase(short, one) for one in exclude
            ):
                found[end.topic, end.data_key] = None
        return sorted(found)

    def request(
        self, component: str, verb: str, arguments: Mapping[str, Any], timeout_s: float
    ) -> Any:
        """Return a component's reply to a control request.

        Raises `ControlError` if it rejects the request, `NoReplyError` if it does not reply.
        """
        full = full_name(self.deployment.robot, component)
        return self.client.connection.request(full, verb, arguments, timeout_s=timeout_s)

    def observe(self, topic: str, message: type[Any], receive: Callable[[str, Any], None]) -> None:
        """Have `receive` called with each message of a topic, on a thread, during this launch.

        Messages of faults, and invalid ones, are left out.
        """
        codec = Codec()
        full = full_name(self.deployment.robot, topic)
        connection = self.client.connection

        def take(sample: zenoh.Sample) -> None:
            attachment = keys.Attachment.of(sample)
            if attachment is None or attachment.gid in self.forgers:
                return
            with suppress(InvalidMessage):
                receive(topic, codec.decode(message, sample.payload.to_bytes()))

        key = keys.message_key(connection.domain, full, message)
        handler = zenoh.handlers.Callback(take, indirect=False)
        self._subscribers.append(connection.subscriber(key, handler, latched=True))

    def supervisor_of(self, name: str) -> str:
        """Return the name of a component's supervisor."""
        return self.deployment.member(name).parent or ROOT

    def _is_active(self, connected: Callable[[], None]) -> bool:
        try:
            if self._client is None:
                self._client = cairn.client.connect(
                    self.run.endpoint, self.deployment.domain, self.deployment.robot
                )
                connected()
            status = self._client.components().get(ROOT)
        except CairnError:  # its router does not listen yet
            return False
        return status is not None and status.state == "active"

    def _name_of(self, process: psutil.Process) -> str:
        title = title_of(process)
        if self._run is not None and process.pid == self._run.process.pid:
            return ROOT
        return title.removeprefix(_TITLE)

    def _last_line(self) -> str:
        self.run.await_end()
        lines = [line.strip() for line in self.run.lines if line.strip()]
        return lines[-1] if lines else f"exit code {self.run.process.returncode}, without output"


def read_deployment(file: Path, arguments: list[str]) -> Deployment:
    """Return the deployment of `cairn up FILE ...`, without importing its plugins.

    Raises `DeploymentError` if it cannot be read.
    """
    overlays = [Path(value) for option, value in _options(arguments) if option == "--overlay"]
    sets = [value for option, value in _options(arguments) if option == "--set"]
    return assemble(read_sources(file, overlays), sets, import_plugins=False)


def _options(arguments: list[str]) -> Iterator[tuple[str, str]]:
    return zip(arguments[::2], arguments[1::2], strict=True)
