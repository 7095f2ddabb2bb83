"""The contract of every driver: life cycle, parameters, unplugging and stopping."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
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
from cairn.testing.timing import falls_silent

_WARM_UP = 2  # cycles; after them, everything that is allocated only once has been allocated
_MORE = 2  # threads or files that may appear by chance
_OF_THE_BUS = re.compile(r"(acc|app|net|rx|tx)-\d+")
"""Names of Zenoh's threads, which it starts and ends as needed."""


class Contract:
    """The settings of every contract. A derived class sets those of its driver."""

    deployment: ClassVar[str | Path]
    """Deployment with the driver under test: a file, or YAML text with `components`."""

    overlays: ClassVar[Sequence[Path]] = ()
    """Overlays, as in `cairn up --overlay`."""

    sets: ClassVar[Sequence[str]] = ()
    """Settings, as in `cairn up --set NAME=VALUE`."""

    component: ClassVar[str]
    """The driver's name in the deployment."""

    port: ClassVar[str]
    """Output port whose messages show that the driver works."""

    message: ClassVar[type[Any]]
    """Message type of that port."""

    rate_hz: ClassVar[float]
    """Nominal rate of that port, in the deployment's time [Hz]."""

    return_limit_s: ClassVar[float] = 5.0
    """Time limit until the driver publishes after activation or after the device's return [s]."""

    live_parameters: ClassVar[Mapping[str, Any]] = {}
    """Parameters that can change while the driver runs, each with a valid value to try."""

    cycles: ClassVar[int] = 8
    """Number of cycles: deactivate, clean up, configure, activate.

    Fewer than 6 cycles do not distinguish leaks from chance; the tests of leaks are skipped.
    """

    leak_mb: ClassVar[float] = 8.0
    """Allowed growth of the process's memory over the cycles [MB]."""

    @pytest.fixture
    def robot(self, bench: Bench) -> RunningDeployment:
        """Return the running deployment, with the driver active."""
        return bench.robot(self.component)

    @pytest.fixture
    def output(self, robot: RunningDeployment) -> Iterator[Reading[Any]]:
        """Collect the messages that the driver publishes from now on."""
        with robot.read(self.topic(robot, self.port), self.message) as reading:
            yield reading

    @classmethod
    def port_of(cls, robot: RunningDeployment, port: str) -> PortStatus | None:
        """Return the status of one of the driver's ports; None if it has no such port."""
        ports = {status.port: status for status in robot.status(cls.component).ports}
        return ports.get(port)

    @classmethod
    def topic(cls, robot: RunningDeployment, port: str) -> str:
        """Return the topic of one of the driver's ports in this deployment.

        Raises `AssertionError` if the driver has no such port, or if another component publishes
        the topic as well.
        """
        status = cls.port_of(robot, port)
        ports = [other.port for other in robot.status(cls.component).ports]
        assert status is not None, f"{cls.component} has no port {port}, only {', '.join(ports)}"
        others = cls.other_writers(robot, status.topic)
        assert status.direction == PortStatus.IN or not others, (
            f"{status.topic} is published by {', '.join(others)} as well; give the driver "
            "under test a topic of its own in the deployment"
        )
        return status.topic

    @classmethod
    def other_writers(cls, robot: RunningDeployment, topic: str) -> list[str]:
        """Return the full names of the other components that publish a topic."""
        return sorted(robot.writers(topic) - {f"/{robot.name}/{cls.component}"})

    @classmethod
    def sample(cls, reading: Reading[Any], count: int, *, after: int = 0) -> list[Arrival[Any]]:
        """Wait for `count` messages after the first `after` ones; allow three periods each."""
        limit_s = cls.return_limit_s + 3.0 * count / cls.rate_hz
        return reading.await_count(count, after=after, limit_s=limit_s)

    @classmethod
    def silence_s(cls) -> float:
        """Return how long a driver that publishes nothing is observed [s]: five periods or more."""
        return max(0.5, 5.0 / cls.rate_hz)

    @classmethod
    def await_working(cls, output: Reading[Any], after: int) -> None:
        """Wait until the driver publishes two more messages."""
        output.await_count(2, after=after, limit_s=cls.return_limit_s + 2.0 / cls.rate_hz)


class StampedContract(Contract):
    """The settings of the contracts of what is published at a rate, with stamps."""

    rate_tolerance: ClassVar[float] = 0.1
    """Allowed relative deviation of the rate from the nominal rate."""

    jitter: ClassVar[float] = 0.3
    """Allowed relative deviation of an interval between stamps from the median interval."""

    oldest_s: ClassVar[float] = 0.5
    """Maximum age of a message on arrival [s]."""

    early_s: ClassVar[float] = 0.005
    """How far in the future a stamp may be [s]."""


@dataclass
class Cycles:
    """Resource usage after each life cycle, and the error if a cycle failed."""

    usages: list[Usage] = field(default_factory=list)
    failure: str = ""


class LifeCycleContract(Contract):
    """Tests the life cycle: repeated transitions, restarts, leaks."""

    @pytest.fixture(scope="class")
    @classmethod
    def cycled(cls, bench: Bench) -> Cycles:
        """Repeat the life cycle `cycles` times; return the resource usage, which tests share."""
        robot = bench.robot(cls.component)
        cycles = Cycles()
        try:
            with robot.read(cls.topic(robot, cls.port), cls.message) as output:
                cls._cycle(robot, output, cycles)
        except (AssertionError, ControlError) as error:
            cycles.failure = str(error)
        return cycles

    def test_inactive_driver_publishes_nothing(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """An inactive driver publishes nothing; reactivated, it publishes again."""
        self.await_working(output, 0)
        robot.request(self.component, "deactivate")
        silent = falls_silent(output, self.silence_s())
        before = output.count
        robot.request(self.component, "activate")

        assert silent, f"{self.component} publishes {output.topic} although it is inactive"
        self.await_working(output, before)

    def test_driver_publishes_after_every_cycle(self, cycled: Cycles) -> None:
        """`on_configure` acquires again what `on_cleanup` released."""
        done = len(cycled.usages)
        assert not cycled.failure, f"in cycle {done + 1} of {self.cycles}: {cycled.failure}"

    def test_cycles_leak_no_threads(self, cycled: Cycles) -> None:
        """Threads end with `on_cleanup`; a leaked thread still uses the device."""
        self._check_growth(cycled, "threads", _MORE)

    def test_cycles_leak_no_files(self, cycled: Cycles) -> None:
        """`on_cleanup` closes files, sockets and devices."""
        self._check_growth(cycled, "files", _MORE)

    def test_cycles_leak_no_processes(self, cycled: Cycles) -> None:
        """Child processes end in the cycle that started them."""
        self._check_growth(cycled, "children", 0)

    def test_cycles_leak_no_memory(self, cycled: Cycles) -> None:
        """Memory grows by at most `leak_mb` over the cycles."""
        self._check_growth(cycled, "memory", self.leak_mb * 1e6)

    def test_driver_publishes_after_restart(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """After an orderly restart, the driver works in a new process on the same device."""
        robot.restart(self.component)
        self.await_working(output, output.count)

    def test_killed_driver_is_restarted_and_publishes(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """After a kill, the restarted driver works, whatever state the device was left in."""
        pid = robot.kill(self.component)
        robot.await_active(self.component, other_than=pid)
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
            f"{self.component} uses {used[-1]} {what} after {len(used) - 1} more cycles, {grown} "
            f"more than before (allowed: {allowed:g}); by cycle: {used}"
        )


class ParametersContract(Contract):
    """Tests parameters: descriptions, bounds, rejected values, changes at run time."""

    def test_each_parameter_is_described_and_bounded(self, robot: RunningDeployment) -> None:
        """Each parameter has a description; each number has a lower and an upper bound."""
        for name, parameter in self._parameters(robot).items():
            assert parameter["description"], f"parameter {name} has no description"
            if _is_number(parameter):
                assert _bounds(parameter).keys() >= {"<", ">"}, (
                    f"parameter {name} is a number with the bounds {parameter['bounds']!r}; give "
                    "its Field a lower and an upper bound (gt or ge, lt or le)"
                )

    def test_invalid_values_are_rejected_and_change_nothing(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """Values out of bounds, values of a wrong type and unknown names change nothing."""
        before = self._parameters(robot)
        for name, parameter in before.items():
            for value in _bad_values(parameter):
                self._check_rejected(robot, {name: value})
                after = robot.parameters(self.component)
                assert after == before, (
                    f"{name} = {value!r} was rejected, but parameters have changed"
                )
        self._check_rejected(robot, {"there_is_no_such_parameter": 1})
        self.await_working(output, output.count)

    def test_live_parameters_can_be_changed(
        self, robot: RunningDeployment, output: Reading[Any]
    ) -> None:
        """Each parameter in `live_parameters` can be changed and set back while the driver runs."""
        if not self.live_parameters:
            pytest.skip("live_parameters is empty")
        before = robot.parameters(self.component)
        for name, value in self.live_parameters.items():
            robot.set_parameters(self.component, {name: value})
            listed = robot.parameters(self.component)[name]["value"]
            assert listed == value, f"{name} was set to {value!r}, but its value is {listed!r}"
            self.await_working(output, output.count)
            robot.set_parameters(self.component, {name: before[name]["value"]})
        assert robot.parameters(self.component) == before

    def _parameters(self, robot: RunningDeployment) -> dict[str, dict[str, Any]]:
        parameters = robot.parameters(self.component)
        if not parameters:
            pytest.skip(f"{self.component} has no parameters")
        return parameters

    def _check_rejected(self, robot: RunningDeployment, changes: Mapping[str, Any]) -> None:
        reason = None
        try:
            robot.set_parameters(self.component, changes)
        except ControlError as error:
            reason = str(error)
        assert reason is not None, f"{self.component} accepts {changes}, which is invalid"
        assert reason, f"{changes} is rejected without a reason"


def _is_number(parameter: Mapping[str, Any]) -> bool:
    return parameter["type"].split(" | ")[0] in ("int", "float")


def _bounds(parameter: Mapping[str, Any]) -> dict[str, float]:
    """Return the bounds by their sign: `<` for the upper, `>` for the lower one."""
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
    """Tests unplugging: the driver survives it and reports it."""

    report_limit_s: ClassVar[float] = 5.0
    """Time limit until the driver reports that its device is gone [s]."""

    def test_driver_survives_unplugging_and_reports_it(
        self, robot: RunningDeployment, output: Reading[Any], device: object
    ) -> None:
        """Without its device, the driver stays alive, publishes no measurements and reports it.

        The report is a warning in the log, or a status worse than OK on `diagnostics`.
        """
        plug = _unpluggable(device)
        self.await_working(output, 0)
        before = robot.status(self.component)
        mark = len(robot.run.lines)
        with ExitStack() as stack:
            # All is open before the device and, with some, the deployment's router are gone.
            diagnosed = self.port_of(robot, "diagnostics")
            if diagnosed is not None:
                shared = bool(self.other_writers(robot, diagnosed.topic))
                diagnostics = stack.enter_context(robot.read(diagnosed.topic, DiagnosticArray))
                heard = diagnostics.count
            plug.unplug()
            try:
                if diagnosed is None:
                    self._await_warning(robot, mark)
                else:
                    self._await_diagnosis(diagnostics, heard, shared=shared)
                silent = falls_silent(output, self.silence_s())
                now = robot.await_active(self.component)
            finally:
                plug.plug_in()
        assert now.pid == before.pid, (
            f"{self.component} was restarted ({now.reason}) when its device was unplugged; a "
            "driver waits for its device's return"
        )
        assert silent, f"{self.component} publishes {output.topic} without its device"

    def test_driver_publishes_after_the_device_returns(
        self, output: Reading[Any], device: object
    ) -> None:
        """The driver publishes within `return_limit_s` after the device returns."""
        plug = _unpluggable(device)
        self.await_working(output, 0)
        plug.unplug()
        try:
            output.await_silence(self.silence_s(), self.return_limit_s)
        finally:
            plug.plug_in()
        self.await_working(output, output.count)

    def _await_warning(self, robot: RunningDeployment, mark: int) -> None:
        try:
            robot.run.await_line(
                rf"(WARNING|ERROR) +{robot.name}\.{self.component}: ",
                after=mark,
                limit_s=self.report_limit_s,
            )
        except AssertionError:
            raise AssertionError(
                f"{self.component} does not report that its device is gone: there is neither a "
                "warning in its log, nor a port `diagnostics`"
            ) from None

    def _await_diagnosis(
        self, diagnostics: Reading[DiagnosticArray], after: int, *, shared: bool
    ) -> None:
        """Wait for the report; on a topic that is shared, names distinguish the driver's own."""

        def is_reported(arrivals: Sequence[Arrival[DiagnosticArray]]) -> bool:
            return any(
                status.level > DiagnosticStatus.OK
                for arrival in arrivals
                for status in arrival.message.status
                if not shared or self.component in status.name
            )

        what = "a status worse than OK of the unplugged device"
        diagnostics.await_that(is_reported, what, after=after, limit_s=self.report_limit_s)


class StopContract(Contract):
    """Tests that the supervisor can stop the driver."""

    def test_driver_stops_cleanly(self, robot: RunningDeployment, output: Reading[Any]) -> None:
        """The driver stops by itself within the deployment's `stop_timeout_s`."""
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
    """Tests that the end of a deployment leaves no process."""

    def test_ctrl_c_stops_everything_cleanly(self, robot: RunningDeployment) -> None:
        """After SIGINT, `cairn up` ends with exit status 0 and leaves no process."""
        code = robot.run.stop()
        robot.run.await_nothing_left()

        assert code == 0, f"cairn up ended with exit status {code}; {robot.run}"

    def test_killing_cairn_up_leaves_no_process(self, bench: Bench) -> None:
        """After SIGKILL of `cairn up`, which cannot stop its children, no process is left."""
        robot = bench.robot(self.component)
        robot.run.process.kill()
        robot.run.await_nothing_left()


class DriverContract(
    EndContract, StopContract, UnplugContract, LifeCycleContract, ParametersContract
):
    """All tests that do not depend on what a driver publishes."""


def _unpluggable(device: object) -> Unpluggable:
    if not isinstance(device, Unpluggable):
        pytest.skip(
            "the device cannot be unplugged: the fixture `device` has no unplug and plug_in"
        )
    return device


@dataclass(frozen=True)
class Usage:
    """The resources that a process uses; `memory` excludes shared memory [bytes].

    Threads of the bus are not counted, because they do not belong to the component.
    """

    threads: int
    files: int
    children: int
    memory: int

    @classmethod
    def of(cls, pid: int) -> Usage:
        """Return the current usage of a process; raises `psutil.Error` if it does not exist."""
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
