"""The contract of every driver: life cycle, parameters, unplugging, stopping; its settings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import psutil
import pytest

from cairn.bus.control import ControlError
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.diagnostic_msgs import DiagnosticArray, DiagnosticStatus
from cairn.testing.device import Unpluggable
from cairn.testing.robot import Arrival, Bench, Reading, RunningDeployment

_WARM_UP = 2  # cycles, after which everything that is allocated only once has been allocated
_MORE = 2  # threads, files or children that may come and go by chance
_OF_THE_BUS = re.compile(r"(acc|app|net|rx|tx)-\d+")
"""Names of Zenoh's threads, which start and end with its work."""


class Contract:
    """The settings of a contract: a user's class overrides those that do not fit its driver."""

    deployment: ClassVar[str | Path]
    """A file, or a text with `components` (and `settings`), that holds the driver under test."""

    overlays: ClassVar[Sequence[Path]] = ()
    """Overlays of the deployment."""

    sets: ClassVar[Sequence[str]] = ()
    """Assignments, as in `cairn up --set NAME=VALUE`."""

    robot_name: ClassVar[str] = "robot"
    """The robot's name in the deployment."""

    component: ClassVar[str]
    """The driver's name in the deployment."""

    port: ClassVar[str]
    """The output whose messages show that the driver works."""

    message: ClassVar[type[Any]]
    """The type of these messages."""

    rate_hz: ClassVar[float]
    """Their nominal rate, in the deployment's time [Hz]."""

    return_limit_s: ClassVar[float] = 5.0
    """Time limit for their publication after activation, or after the device's return [s]."""

    live_parameters: ClassVar[Mapping[str, Any]] = {}
    """Parameters that may be changed while the driver runs, each with another valid value."""

    cycles: ClassVar[int] = 8
    """How often the driver is deactivated, cleaned up, configured and activated.

    Fewer than 6 cycles do not distinguish leaks from chance; leaks are not tested then.
    """

    leak_mb: ClassVar[float] = 8.0
    """How much more memory its process may hold after the cycles [MB]."""

    @pytest.fixture
    def robot(self, bench: Bench) -> RunningDeployment:
        """The running deployment, the driver active."""
        return bench.robot(self.component)

    @pytest.fixture
    def output(self, robot: RunningDeployment) -> Iterator[Reading[Any]]:
        """A reading of the messages that the driver publishes from now on."""
        with robot.read(self.topic(robot, self.port), self.message) as reading:
            yield reading

    @classmethod
    def port_of(cls, robot: RunningDeployment, port: str) -> PortStatus | None:
        """Return a port of the driver in this deployment, None if it has no such port."""
        ports = {status.port: status for status in robot.status(cls.component).ports}
        return ports.get(port)

    @classmethod
    def topic(cls, robot: RunningDeployment, port: str) -> str:
        """Return the topic of a port of the driver in this deployment, renamed or not.

        Raises `AssertionError` if it has no such port, or if other components publish the topic.
        """
        status = cls.port_of(robot, port)
        ports = [other.port for other in robot.status(cls.component).ports]
        assert status is not None, f"{cls.component} has no port {port}, but {', '.join(ports)}"
        others = cls.other_writers(robot, status.topic)
        assert status.direction == PortStatus.IN or not others, (
            f"{status.topic} is published by {', '.join(others)} as well; give the driver "
            "under test a topic of its own in the deployment"
        )
        return status.topic

    @classmethod
    def other_writers(cls, robot: RunningDeployment, topic: str) -> list[str]:
        """Return the other components (full names) that publish a topic."""
        return sorted(robot.writers(topic) - {f"/{robot.name}/{cls.component}"})

    @classmethod
    def sample(cls, reading: Reading[Any], count: int, *, after: int = 0) -> list[Arrival[Any]]:
        """Wait for `count` messages after the first `after`; the limit suits a slow computer."""
        limit_s = cls.return_limit_s + 3.0 * count / cls.rate_hz
        return reading.await_count(count, after=after, limit_s=limit_s)

    @classmethod
    def await_working(cls, output: Reading[Any], after: int) -> None:
        """Wait until the driver publishes again."""
        output.await_count(2, after=after, limit_s=cls.return_limit_s + 2.0 / cls.rate_hz)


@dataclass
class Cycles:
    """Usage after each cycle of the life cycle, and the failure, if one failed."""

    usages: list[Usage] = field(default_factory=list)
    failure: str = ""


class LifeCycleContract(Contract):
    """Life cycle: an inactive driver publishes nothing, and can be activated repeatedly."""

    @pytest.fixture(scope="class")
    @classmethod
    def cycled(cls, bench: Bench) -> Cycles:
        """Lead the driver through its life cycle repeatedly."""
        robot = bench.robot(cls.component)
        cycles = Cycles()
        try:
            with robot.read(cls.topic(robot, cls.port), cls.message) as output:
                cls._cycle(robot, output, cycles)
        except (AssertionError, ControlError) as error:
            cycles.failure = str(error)
        return cycles

    def test_inactive_it_publishes_nothing(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """An operator deactivates a driver to have its device at rest."""
        self.await_working(output, 0)
        robot.request(self.component, "deactivate")
        output.stays_silent(0.2)  # for messages still in transit
        silent = output.stays_silent(max(0.5, 5.0 / self.rate_hz))
        before = output.count
        robot.request(self.component, "activate")

        assert silent, f"{self.component} publishes {output.topic} although it is inactive"
        self.await_working(output, before)

    def test_it_publishes_after_every_cycle(self, cycled: Cycles) -> None:
        """`on_configure` can acquire again what `on_cleanup` has released."""
        done = len(cycled.usages)
        assert not cycled.failure, f"in cycle {done + 1} of {self.cycles}: {cycled.failure}"

    def test_cycles_leak_no_threads(self, cycled: Cycles) -> None:
        """A thread that outlives `on_deactivate` or `on_cleanup` still uses the device."""
        self._check_growth(cycled, "threads", _MORE)

    def test_cycles_leak_no_files(self, cycled: Cycles) -> None:
        """Open files, sockets and devices are closed."""
        self._check_growth(cycled, "files", _MORE)

    def test_cycles_leak_no_processes(self, cycled: Cycles) -> None:
        """Helper processes end with the cycle that started them."""
        self._check_growth(cycled, "children", 0)

    def test_cycles_leak_no_memory(self, cycled: Cycles) -> None:
        """Buffers are released."""
        self._check_growth(cycled, "memory", self.leak_mb * 1e6)

    def test_restarted_it_publishes(self, robot: RunningDeployment, output: Reading[Any]) -> None:
        """Its supervisor stops it and starts it in another process, on the same device."""
        robot.restart(self.component)
        self.await_working(output, output.count)

    def test_killed_it_is_restarted_and_publishes(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """The state in which a killed driver left its device does not prevent the next start."""
        pid = robot.status(self.component).pid
        robot.kill(self.component)
        robot.await_status(
            self.component,
            lambda status: status.pid != pid and status.state == "active",
            "active in another process",
            limit_s=20.0,
        )
        self.await_working(output, output.count)

    @classmethod
    def _cycle(cls, robot: RunningDeployment, output: Reading[Any], cycles: Cycles) -> None:
        for _ in range(cls.cycles):
            for verb in ("deactivate", "cleanup", "configure"):
                robot.request(cls.component, verb)
            before = output.count
            robot.request(cls.component, "activate")
            cls.await_working(output, before)
            cycles.usages.append(Usage.of(robot.status(cls.component).pid))

    def _check_growth(self, cycled: Cycles, what: str, allowed: float) -> None:
        if len(cycled.usages) < _WARM_UP + _MORE + 2:  # to detect one more in each
            pytest.skip(f"{len(cycled.usages)} cycles are too few to detect leaks; see `cycles`")
        used = [getattr(usage, what) for usage in cycled.usages[_WARM_UP:]]
        grown = used[-1] - used[0]
        assert grown <= allowed, (
            f"{self.component} holds {used[-1]} {what} after {len(used) - 1} more cycles, {grown} "
            f"more than before (allowed: {allowed:g}); in each cycle: {used}"
        )


class ParametersContract(Contract):
    """Parameters: each is described, and no invalid value is accepted."""

    def test_each_parameter_is_described_and_bounded(self, robot: RunningDeployment) -> None:
        """`cairn param list` shows an operator the meaning, unit and limits of each."""
        for name, parameter in self._parameters(robot).items():
            assert parameter["description"], f"parameter {name} has no description"
            if _is_number(parameter):
                assert _bounds(parameter).keys() >= {"<", ">"}, (
                    f"parameter {name} is a number with the bounds {parameter['bounds']!r}; give "
                    "its Field a lower and an upper one (gt or ge, lt or le)"
                )

    def test_bad_values_are_refused_and_change_nothing(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """Values out of bounds, of another type, and unknown names are refused."""
        before = self._parameters(robot)
        for name, parameter in before.items():
            for value in _bad_values(parameter):
                self._check_refused(robot, {name: value})
                after = robot.parameters(self.component)
                assert after == before, (
                    f"{name} = {value!r} was refused, but parameters have changed"
                )
        self._check_refused(robot, {"there_is_no_such_parameter": 1})
        self.await_working(output, output.count)

    def test_live_parameters_can_be_changed(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """Those listed in `live_parameters`, to another value and back, while it runs."""
        if not self.live_parameters:
            pytest.skip("live_parameters is empty")
        before = robot.parameters(self.component)
        for name, value in self.live_parameters.items():
            robot.set_parameters(self.component, {name: value})
            listed = robot.parameters(self.component)[name]["value"]
            assert listed == value, f"{name} was set to {value!r}, but is {listed!r}"
            self.await_working(output, output.count)
            robot.set_parameters(self.component, {name: before[name]["value"]})
        assert robot.parameters(self.component) == before

    def _parameters(self, robot: RunningDeployment) -> dict[str, dict[str, Any]]:
        parameters = robot.parameters(self.component)
        if not parameters:
            pytest.skip(f"{self.component} has no parameters")
        return parameters

    def _check_refused(self, robot: RunningDeployment, changes: Mapping[str, Any]) -> None:
        try:
            robot.set_parameters(self.component, changes)
        except ControlError as error:
            assert str(error), f"{changes} is refused without a reason"  # noqa: PT017 - not raised
        else:
            pytest.fail(f"{self.component} accepts {changes}, which is invalid")


def _is_number(parameter: Mapping[str, Any]) -> bool:
    return parameter["type"].split(" | ")[0] in ("int", "float")


def _bounds(parameter: Mapping[str, Any]) -> dict[str, float]:
    """Return limits by their sign: `<` above, `>` below."""
    found = re.findall(r"([<>])=? (-?[0-9.e+-]+)", parameter["bounds"])
    return {sign: float(limit) for sign, limit in found}


def _bad_values(parameter: Mapping[str, Any]) -> list[Any]:
    kind = parameter["type"].split(" | ")[0]
    if kind.startswith("Literal["):
        return ["there_is_no_such_choice"]
    if kind == "str":
        return [12345]
    if kind == "bool":
        return ["perhaps"]
    if not _is_number(parameter):
        return []
    limits = _bounds(parameter)
    beyond = {"<": lambda limit: limit + abs(limit) + 1, ">": lambda limit: limit - abs(limit) - 1}
    return ["much", *(beyond[sign](limit) for sign, limit in limits.items())]


class UnplugContract(Contract):
    """Unplugging: a driver survives a loose cable."""

    tell_limit_s: ClassVar[float] = 5.0
    """Time limit for the driver's report that its device is gone [s]."""

    def test_unplugged_it_stays_alive_and_reports_it(
        self, robot: RunningDeployment, output: Reading[Any], device: object
    ) -> None:
        """It does not terminate, does not repeat its last measurement, and reports the loss."""
        plug = _unpluggable(device)
        self.await_working(output, 0)
        before = robot.status(self.component)
        mark = len(robot.run.lines)
        diagnosed = self.port_of(robot, "diagnostics")
        plug.unplug()
        try:
            if diagnosed is None:
                self._await_warning(robot, mark)
            else:
                self._await_diagnosis(robot, diagnosed.topic)
            silent = output.stays_silent(max(0.5, 5.0 / self.rate_hz))
            robot.await_state(self.component, "active")
            now = robot.status(self.component)
        finally:
            plug.plug_in()
        assert now.pid == before.pid, (
            f"{self.component} was restarted ({now.reason}) when its device was unplugged; a "
            "driver waits for its device's return"
        )
        assert silent, f"{self.component} publishes {output.topic} without its device"

    def test_plugged_in_again_it_publishes(self, output: Reading[Any], device: object) -> None:
        """Within a limit, without help."""
        plug = _unpluggable(device)
        self.await_working(output, 0)
        plug.unplug()
        try:
            output.await_silence(3.0 / self.rate_hz, self.return_limit_s)
        finally:
            plug.plug_in()
        self.await_working(output, output.count)

    def _await_warning(self, robot: RunningDeployment, mark: int) -> None:
        try:
            robot.run.await_line(
                rf"(WARNING|ERROR) +{robot.name}\.{self.component}: ",
                after=mark,
                limit_s=self.tell_limit_s,
            )
        except AssertionError:
            raise AssertionError(
                f"{self.component} does not report that its device is gone: there is neither a "
                "warning in its log, nor a port `diagnostics`"
            ) from None

    def _await_diagnosis(self, robot: RunningDeployment, topic: str) -> None:
        shared = bool(self.other_writers(robot, topic))  # then names distinguish its own

        def is_reported(arrivals: Sequence[Arrival[DiagnosticArray]]) -> bool:
            return any(
                status.level > DiagnosticStatus.OK
                for arrival in arrivals
                for status in arrival.message.status
                if not shared or self.component in status.name
            )

        with robot.read(topic, DiagnosticArray) as diagnostics:
            what = "a status worse than OK, when the device was unplugged"
            diagnostics.await_that(is_reported, what, limit_s=self.tell_limit_s)


class StopContract(Contract):
    """Stopping: the supervisor relies on the driver to stop in time."""

    def test_it_stops_cleanly(self, robot: RunningDeployment, output: Reading[Any]) -> None:
        """It stops within the deployment's `stop_timeout_s`; otherwise the supervisor kills it."""
        mark = len(robot.run.lines)
        robot.unload(self.component)
        stopped = f"child (stop failed|stopped): {self.component}: "
        robot.run.await_line(stopped, after=mark)
        lines = [line for line in robot.run.lines[mark:] if re.search(stopped, line)]
        robot.load(self.component)

        assert lines[0].rstrip().endswith("shut down"), (
            f"it did not stop by itself: {lines[0].strip()}"
        )
        self.await_working(output, output.count)


class EndContract(Contract):
    """The end of a deployment, by a signal or by force: no process is left."""

    def test_ctrl_c_stops_everything_cleanly(self, robot: RunningDeployment) -> None:
        """`cairn up` ends with exit status 0, and no process is left."""
        code = robot.run.stop()
        robot.run.await_nothing_left()

        assert code == 0, f"cairn up ended with exit status {code}; {robot.run}"

    def test_nothing_is_left_after_a_kill_of_cairn_up(self, bench: Bench) -> None:
        """A killed `cairn up` cannot stop the driver; the driver ends nevertheless."""
        robot = bench.robot(self.component)
        robot.run.process.kill()
        robot.run.await_nothing_left()


def _unpluggable(device: object) -> Unpluggable:
    if not isinstance(device, Unpluggable):
        pytest.skip("the device cannot be unplugged: no fixture `device` with unplug, plug_in")
    return device


@dataclass(frozen=True)
class Usage:
    """The resources that a process holds at a moment; `memory` without shared memory [bytes].

    Threads of the bus are not counted: they are not the component's.
    """

    threads: int
    files: int
    children: int
    memory: int

    @classmethod
    def of(cls, pid: int) -> Usage:
        """Return what a process holds now; raises `psutil.Error` if the process does not exist."""
        process = psutil.Process(pid)
        return cls(
            threads=sum(not _OF_THE_BUS.fullmatch(name) for name in _threads_of(process)),
            files=process.num_fds(),
            children=len(process.children()),
            memory=process.memory_full_info().uss,
        )


def _threads_of(process: psutil.Process) -> list[str]:
    names = []
    for thread in process.threads():
        with suppress(OSError):  # it has just ended
            name = Path(f"/proc/{process.pid}/task/{thread.id}/comm").read_text(encoding="utf-8")
            names.append(name.rstrip("\n"))
    return names
