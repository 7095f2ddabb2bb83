"""What every driver of a sensor or a base keeps to: settings of a contract, and its life."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import pytest

from cairn.bus.control import ControlError
from cairn.schemas.cairn_msgs import PortStatus
from cairn.testing.bench import Bench
from cairn.testing.reading import Arrival, Reading
from cairn.testing.robot import Robot
from cairn.testing.usage import Usage

_WARM_UP = 2  # cycles after which what is allocated once has been
_MORE = 2  # threads, files or children that may come and go by chance


class Contract:
    """The settings of a contract: a user's class overrides those that are not right for it."""

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
    """How often they come nominally, in the deployment's time [Hz]."""

    return_limit_s: ClassVar[float] = 5.0
    """Until they come (again) after activation, or after the device's return [s]."""

    live_parameters: ClassVar[Mapping[str, Any]] = {}
    """Parameters that may be changed while the driver runs, each with another valid value."""

    cycles: ClassVar[int] = 8
    """How often the driver is deactivated, cleaned up, configured and activated.

    In fewer than 6 cycles no leak is told from chance, and that is not tested.
    """

    leak_mb: ClassVar[float] = 8.0
    """How much more memory its process may hold after these [MB]."""

    @pytest.fixture
    def robot(self, bench: Bench) -> Robot:
        """The running deployment, the driver active."""
        return bench.robot(self.component)

    @pytest.fixture
    def output(self, robot: Robot) -> Iterator[Reading[Any]]:
        """What the driver publishes from now on."""
        with robot.read(self.topic(robot, self.port), self.message) as reading:
            yield reading

    @classmethod
    def port_of(cls, robot: Robot, port: str) -> PortStatus | None:
        """A port of the driver in this deployment, None if it has no such port."""
        ports = {status.port: status for status in robot.status(cls.component).ports}
        return ports.get(port)

    @classmethod
    def topic(cls, robot: Robot, port: str) -> str:
        """The topic of a port of the driver in this deployment, whatever it was renamed to.

        Raises `AssertionError` if it has no such port, or if others write what it writes.
        """
        status = cls.port_of(robot, port)
        ports = [other.port for other in robot.status(cls.component).ports]
        assert status is not None, f"{cls.component} has no port {port}, but {', '.join(ports)}"
        others = cls.other_writers(robot, status.topic)
        assert status.direction == PortStatus.IN or not others, (
            f"{status.topic} is written by {', '.join(others)} as well: give the driver under test "
            "a topic of its own in the deployment"
        )
        return status.topic

    @classmethod
    def other_writers(cls, robot: Robot, topic: str) -> list[str]:
        """Who writes a topic (full names), but for the driver under test."""
        return sorted(robot.writers(topic) - {f"/{robot.name}/{cls.component}"})

    @classmethod
    def sample(cls, reading: Reading[Any], count: int, *, after: int = 0) -> list[Arrival[Any]]:
        """So many messages after the first `after`; the limit leaves a slow machine room."""
        limit_s = cls.return_limit_s + 3.0 * count / cls.rate_hz
        return reading.await_count(count, after=after, limit_s=limit_s)

    @classmethod
    def await_working(cls, output: Reading[Any], after: int) -> None:
        """Wait until the driver publishes again."""
        output.await_count(2, after=after, limit_s=cls.return_limit_s + 2.0 / cls.rate_hz)


@dataclass
class Cycles:
    """How the driver came through its cycles of the life cycle."""

    usages: list[Usage] = field(default_factory=list)
    failure: str = ""


class LifeCycleContract(Contract):
    """The life cycle: an inactive driver is silent, and may be started and stopped for ever."""

    @pytest.fixture(scope="class")
    @classmethod
    def cycled(cls, bench: Bench) -> Cycles:
        """Lead the driver through its life cycle again and again."""
        robot = bench.robot(cls.component)
        cycles = Cycles()
        try:
            with robot.read(cls.topic(robot, cls.port), cls.message) as output:
                cls._cycle(robot, output, cycles)
        except (AssertionError, ControlError) as error:
            cycles.failure = str(error)
        return cycles

    def test_inactive_it_publishes_nothing(self, robot: Robot, output: Reading[Any]) -> None:
        """Whoever deactivates a driver relies on its device being at rest."""
        self.await_working(output, 0)
        robot.request(self.component, "deactivate")
        output.stays_silent(0.2)  # for what was under way
        silent = output.stays_silent(max(0.5, 5.0 / self.rate_hz))
        before = output.count
        robot.request(self.component, "activate")

        assert silent, f"{self.component} publishes {output.topic} although it is inactive"
        self.await_working(output, before)

    def test_it_works_after_every_cycle(self, cycled: Cycles) -> None:
        """What `on_cleanup` gives back, `on_configure` can take again."""
        done = len(cycled.usages)
        assert not cycled.failure, f"in cycle {done + 1} of {self.cycles}: {cycled.failure}"

    def test_cycles_leak_no_threads(self, cycled: Cycles) -> None:
        """A thread that outlives `on_deactivate` or `on_cleanup` goes on with the device."""
        self._check_growth(cycled, "threads", _MORE)

    def test_cycles_leak_no_files(self, cycled: Cycles) -> None:
        """Open files, sockets and devices are closed."""
        self._check_growth(cycled, "files", _MORE)

    def test_cycles_leak_no_processes(self, cycled: Cycles) -> None:
        """Helpers end with what they were started for."""
        self._check_growth(cycled, "children", 0)

    def test_cycles_leak_no_memory(self, cycled: Cycles) -> None:
        """Buffers are given back."""
        self._check_growth(cycled, "memory", self.leak_mb * 1e6)

    def test_restarted_it_works(self, robot: Robot, output: Reading[Any]) -> None:
        """Its supervisor stops it and starts it in a process of its own, on the same device."""
        robot.restart(self.component)
        self.await_working(output, output.count)

    def test_killed_it_comes_back(self, robot: Robot, output: Reading[Any]) -> None:
        """What a killed driver left of its device does not hinder the next."""
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
    def _cycle(cls, robot: Robot, output: Reading[Any], cycles: Cycles) -> None:
        for _ in range(cls.cycles):
            for verb in ("deactivate", "cleanup", "configure"):
                robot.request(cls.component, verb)
            before = output.count
            robot.request(cls.component, "activate")
            cls.await_working(output, before)
            cycles.usages.append(Usage.of(robot.status(cls.component).pid))

    def _check_growth(self, cycled: Cycles, what: str, allowed: float) -> None:
        if len(cycled.usages) < _WARM_UP + _MORE + 2:  # of one more each time, say
            pytest.skip(f"{len(cycled.usages)} cycles are too few to tell: see cycles")
        used = [getattr(usage, what) for usage in cycled.usages[_WARM_UP:]]
        grown = used[-1] - used[0]
        assert grown <= allowed, (
            f"{self.component} holds {used[-1]} {what} after {len(used) - 1} cycles more, {grown} "
            f"more than before (allowed: {allowed:g}); with each cycle: {used}"
        )


class ParametersContract(Contract):
    """Parameters: an operator is told what they mean, and cannot set what makes no sense."""

    def test_each_parameter_is_described_and_bounded(self, robot: Robot) -> None:
        """`cairn param list` tells an operator the meaning, unit and limits of each."""
        for name, parameter in self._parameters(robot).items():
            assert parameter["description"], f"parameter {name} has no description"
            if _is_number(parameter):
                assert _bounds(parameter).keys() >= {"<", ">"}, (
                    f"parameter {name} is a number with the bounds {parameter['bounds']!r}: give "
                    "its Field a lower and an upper one (gt or ge, lt or le)"
                )

    def test_bad_values_are_refused_and_change_nothing(
        self, robot: Robot, output: Reading[Any]
    ) -> None:
        """Neither a value out of bounds, nor one of another type, nor an unknown name."""
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

    def test_live_parameters_can_be_changed(self, robot: Robot, output: Reading[Any]) -> None:
        """Those that are named as such, to another value and back, while it runs."""
        if not self.live_parameters:
            pytest.skip("live_parameters names none that may be changed while it runs")
        before = robot.parameters(self.component)
        for name, value in self.live_parameters.items():
            robot.set_parameters(self.component, {name: value})
            listed = robot.parameters(self.component)[name]["value"]
            assert listed == value, f"{name} was set to {value!r}, but is {listed!r}"
            self.await_working(output, output.count)
            robot.set_parameters(self.component, {name: before[name]["value"]})
        assert robot.parameters(self.component) == before

    def _parameters(self, robot: Robot) -> dict[str, dict[str, Any]]:
        parameters = robot.parameters(self.component)
        if not parameters:
            pytest.skip(f"{self.component} has no parameters")
        return parameters

    def _check_refused(self, robot: Robot, changes: Mapping[str, Any]) -> None:
        try:
            robot.set_parameters(self.component, changes)
        except ControlError as error:
            assert str(error), f"{changes} is refused without a word"  # noqa: PT017 - not raised
        else:
            pytest.fail(f"{self.component} takes {changes}, which makes no sense")


def _is_number(parameter: Mapping[str, Any]) -> bool:
    return parameter["type"].split(" | ")[0] in ("int", "float")


def _bounds(parameter: Mapping[str, Any]) -> dict[str, float]:
    """Limits by their sign: `<` above, `>` below."""
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
