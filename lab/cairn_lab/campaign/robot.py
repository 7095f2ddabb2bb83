"""The deployment under a campaign: launched by `cairn up`, observed and disturbed from outside."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import zenoh

import cairn.client
from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.codec import Codec
from cairn.deployment.model import root_name
from cairn.errors import CairnError
from cairn.processes.orphan_cleanup import set_parent_death_signal
from cairn.schemas.message import InvalidMessage
from cairn.testing.launching import Launching, Run, await_any_end, title_of
from cairn_lab.campaign.fault import SkippedFault
from cairn_lab.campaign.growth import anonymous_memory_mib
from cairn_lab.campaign.model import CampaignDeployment
from cairn_lab.campaign.network import Network
from cairn_lab.campaign.observations import (
    ROOT,
    ZYGOTE,
    DeploymentEnded,
    LogLine,
    Processes,
    ProcessSample,
    Role,
)
from cairn_lab.campaign.parameters import Patterns, matching
from cairn_lab.campaign.programs import Programs
from cairn_lab.campaign.stepped_clock import Clocks

_START_LIMIT_S = 180.0
_POLL_S = 0.2
_END_LIMIT_S = 60.0
_LEFT_LIMIT_S = 10.0
_LAST_LINES = 12
_TITLE = "cairn: "


class CampaignRobot:
    """A deployment that runs, its processes, its topics, and a client connected to it.

    A deployment with `machines` runs with all of them on this computer.
    """

    def __init__(
        self,
        launch: Launching,
        deployment: CampaignDeployment,
        folder: Path,
        programs: Programs,
        network: Network,
        clocks: Clocks,
    ) -> None:
        """Take what runs; nothing is launched yet.

        The folder gets the report folder of `cairn up`, `run`, and its logs; those of a further
        machine have its name at the end.
        """
        self._launch = launch
        self._file = deployment.file
        self._arguments = deployment.arguments
        self._folder = folder
        self.deployment = deployment.deployment
        self.machines = network.machines
        """The machines, the main one first; "" is that of a deployment without machines."""
        self.roots = {one: root_name(one, self.machines[0]) for one in self.machines}
        """The name of the root on each machine."""
        self.zygotes = {one: root.replace(ROOT, ZYGOTE, 1) for one, root in self.roots.items()}
        """The name of the zygote on each machine."""
        self.components = tuple(
            member.name
            for member in self.deployment.members()
            if member.spec.placement == "process"
        )
        """The components that have a process of their own, in start order."""
        self._loggers = self._loggers_by_machine()
        self.programs = programs
        """The programs that run beside it."""
        self.network = network
        """The links between its machines."""
        self.clocks = clocks
        """The clocks of its machines."""
        self.runs: dict[str, Run] = {}
        """The present launch: `cairn up` on each machine; empty if it is not launched."""
        self._launches = 0
        self._first_ended: Run | None = None
        self._overdue: list[str] = []
        self._client: cairn.client.Robot | None = None
        self._lines: dict[str, int] = {}
        self._topics: list[keys.EndpointEntity] = []
        self._subscribers: list[Any] = []
        self.forgers: set[bytes] = set()
        """The identities (gid) under which faults publish: `observe` leaves out their messages."""

    @property
    def endpoint(self) -> str:
        """Where clients connect to the present launch: the router of the main machine."""
        return self.runs[self.machines[0]].endpoint

    @property
    def client(self) -> cairn.client.Robot:
        """A client of the present launch."""
        assert self._client is not None, "the deployment is not launched"
        return self._client

    def launch(self, connected: Callable[[], None] = lambda: None) -> None:
        """Launch the deployment, again in the same report folders, until all roots are active.

        `connected` is called as soon as `client` is connected. Raises `CairnError` with the last
        line of `cairn up` if they do not become active.
        """
        for machine in self.machines:
            self.runs[machine] = self._launch(
                self._file,
                "--plain",
                *self._arguments,
                *self.network.arguments(machine),
                report=self._folder_of("run", machine),
                environment={**self.network.environment, **self.clocks.environment(machine)},
                process_group=0,  # Ctrl-C is for the campaign, which stops the deployment itself
                preexec_fn=lambda: set_parent_death_signal(signal.SIGTERM),
            )
        self._lines.clear()
        deadline = time.monotonic() + _START_LIMIT_S
        while not self._is_active(connected):
            for run in self.runs.values():
                if run.process.poll() is not None:
                    raise CairnError(f"the deployment does not start: {_last_line(run)}")
            if time.monotonic() > deadline:
                logs = ", ".join(str(run.logs) for run in self.runs.values())
                raise CairnError(
                    f"the deployment is not active after {_START_LIMIT_S:g} s; see {logs}"
                )
            time.sleep(_POLL_S)
        self._topics = sorted(
            (end for end in self.client.connection.endpoints() if end.kind == "MS"),
            key=lambda end: (end.topic, end.node.name),
        )

    @property
    def is_launched(self) -> bool:
        """Whether it was launched, and its end is not handled yet by `close`."""
        return bool(self.runs)

    def has_ended(self) -> bool:
        """Return whether `cairn up` has ended on one of the machines, or is not launched."""
        return not self.runs or self._ended() is not None

    def stop(self) -> None:
        """Stop the deployment, as Ctrl-C on the main machine does, and then on the others."""
        self.runs[self.machines[0]].process.send_signal(signal.SIGINT)
        self.await_end()

    def await_end(self) -> None:
        """Wait until `cairn up` has ended, and all that it has printed is in `new_lines`.

        When it has ended on one machine, it is stopped on the others. What does not end in time is
        killed, and counts as left in `close`.
        """
        deadline = time.monotonic() + _END_LIMIT_S
        await_any_end([run.process.pid for run in self.runs.values()], _END_LIMIT_S)
        self._first_ended = self._ended()
        for run in self.runs.values():
            if self._first_ended is not None and run.process.poll() is None:
                run.process.send_signal(signal.SIGINT)
            try:
                run.await_end(max(0.0, deadline - time.monotonic()))
            except AssertionError:
                self._overdue.append(f"{run.process.pid} cairn up, within {_END_LIMIT_S:g} s,")
                run.process.kill()
                run.await_end()

    def close(self, at_s: float, *, expected: bool) -> DeploymentEnded:
        """Disconnect from a deployment after `await_end`; return how it has ended."""
        self._subscribers.clear()  # they end with their session
        if self._client is not None:
            with suppress(CairnError, zenoh.ZError):
                self._client.close()
            self._client = None
        left, self._overdue = self._overdue, []
        self._launches += 1
        for machine, run in self.runs.items():
            left += run.kill_left(_LEFT_LIMIT_S)
            if run.logs.is_dir():  # the next launch would begin new ones
                run.logs.rename(self._folder_of(f"logs{self._launches}", machine))
        first = self._first_ended or self.runs[self.machines[0]]
        end = DeploymentEnded(
            at_s,
            expected,
            code=first.await_end(),
            reports=tuple(run.report for run in self.runs.values()),
            left=tuple(left),
            last_lines=tuple(_lines_of(first)[-_LAST_LINES:]),
        )
        self.runs.clear()
        return end

    def new_lines(self, at_s: float) -> list[LogLine]:
        """Return what `cairn up` has printed since the last call, on all machines.

        `cairn up` prints what is logged on the machines that it reaches; a record is taken from its
        own machine alone.
        """
        found = []
        for machine, run in self.runs.items():
            lines = run.lines[self._lines.get(machine, 0) :]
            self._lines[machine] = self._lines.get(machine, 0) + len(lines)
            parsed = (LogLine.parsed(at_s, line) for line in lines if line.strip())
            found += [one for one in parsed if self._loggers.get(one.logger, machine) == machine]
        return found

    def processes(self) -> Processes:
        """Return a sample of all processes of the run, on all machines."""
        return {one.pid: one for machine in self.runs for one in self._sample(machine)}

    def process(self, name: str) -> psutil.Process:
        """Return the process of a component, a root or a zygote.

        Raises `SkippedFault` if it does not run, or is just being forked.
        """
        found = [
            one.pid
            for one in self.processes().values()
            if one.name == name and one.role != "helper"
        ]
        if len(found) == 1:
            with suppress(psutil.NoSuchProcess):
                return psutil.Process(found[0])
        raise SkippedFault(f"{name} just starts" if len(found) > 1 else f"{name} does not run")

    def subscribed_topics(self, patterns: Patterns, exclude: Patterns) -> list[tuple[str, str]]:
        """Return the topics (full names) that components subscribe to, and their data keys, sorted.

        The patterns are those of names without the robot's.
        """
        prefix = f"/{self.deployment.robot.name}/"
        ends = {(end.topic, end.data_key) for end in self._topics}
        names = {topic: topic.removeprefix(prefix) for topic, _ in ends}
        drawn = set(matching(names.values(), patterns, exclude))
        return sorted((topic, key) for topic, key in ends if names[topic] in drawn)

    def request(
        self, component: str, verb: str, arguments: Mapping[str, Any], timeout_s: float
    ) -> Any:
        """Return a component's reply to a control request.

        Raises `ControlError` if it rejects the request, `NoReplyError` if it does not reply.
        """
        full = full_name(self.deployment.robot.name, component)
        return self.client.connection.request(full, verb, arguments, timeout_s=timeout_s)

    def observe(self, topic: str, message: type[Any], receive: Callable[[str, Any], None]) -> None:
        """Have `receive` called with each message of a topic, on a thread, during this launch.

        Messages of faults, and invalid ones, are left out.
        """
        codec = Codec()
        full = full_name(self.deployment.robot.name, topic)
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
                    self.endpoint, self.deployment.domain, self.deployment.robot.name
                )
                connected()
            statuses = self._client.components()
        except CairnError:  # its router does not listen yet
            return False
        roots = [statuses.get(name) for name in self.roots.values()]
        return all(status is not None and status.state == "active" for status in roots)

    def _loggers_by_machine(self) -> dict[str, str]:
        """Return the machine of each component and root, by the name under which it logs."""
        if not self.deployment.machines:
            return {}
        names = {
            one.name: self.deployment.machine_of(one.name) for one in self.deployment.members()
        }
        names |= {root: machine for machine, root in self.roots.items()}
        return {f"{self.deployment.robot.name}.{name}": machine for name, machine in names.items()}

    def _ended(self) -> Run | None:
        ended = (run for run in self.runs.values() if run.process.poll() is not None)
        return next(ended, None)

    def _sample(self, machine: str) -> Iterator[ProcessSample]:
        run = self.runs[machine]
        listed = run.processes()
        names = {process.pid: self._name_of(process, machine) for process in listed}
        for process in listed:
            with suppress(psutil.NoSuchProcess), process.oneshot():
                name, parent = names[process.pid], names.get(process.ppid(), "")
                yield ProcessSample(
                    pid=process.pid,
                    name=name,
                    parent=parent,
                    role=self._role_of(name, parent, machine),
                    created_s=process.create_time(),
                    memory_mib=anonymous_memory_mib(process),
                    descriptors=process.num_fds(),
                    threads=process.num_threads(),
                )

    def _name_of(self, process: psutil.Process, machine: str) -> str:
        if process.pid == self.runs[machine].process.pid:
            return self.roots[machine]
        name = title_of(process).removeprefix(_TITLE)
        return self.zygotes[machine] if name == ZYGOTE else name

    def _role_of(self, name: str, parent: str, machine: str) -> Role:
        if name == self.roots[machine]:
            return "root"
        if name == parent:  # just forked
            return "helper"
        if name == self.zygotes[machine]:
            return "zygote"
        return "component" if name in self.components else "helper"

    def _folder_of(self, name: str, machine: str) -> Path:
        is_main = machine == self.machines[0]
        return self._folder / (name if is_main else f"{name}_{machine}")


def _last_line(run: Run) -> str:
    run.await_end()
    lines = _lines_of(run)
    return lines[-1] if lines else f"exit code {run.process.returncode}, without output"


def _lines_of(run: Run) -> list[str]:
    return [line.strip() for line in run.lines if line.strip()]
