"""What every driver keeps to when its device goes, and when it is to stop."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, ClassVar

import pytest

from cairn.schemas.diagnostic_msgs import DiagnosticArray, DiagnosticStatus
from cairn.testing.bench import Bench
from cairn.testing.device import Unpluggable
from cairn.testing.driver_contract import Contract
from cairn.testing.reading import Arrival, Reading
from cairn.testing.robot import Robot


class UnplugContract(Contract):
    """Unplugging: a loose cable is an event, not the end of the driver."""

    tell_limit_s: ClassVar[float] = 5.0
    """Until the driver says that its device is gone [s]."""

    def test_unplugged_it_lives_and_says_so(
        self, robot: Robot, output: Reading[Any], device: object
    ) -> None:
        """Neither does it die, nor repeat what it measured last, nor keep silent about it."""
        plug = _unpluggable(device)
        self.await_working(output, 0)
        before = robot.status(self.component)
        said = len(robot.run.lines)
        diagnosed = self.port_of(robot, "diagnostics")
        plug.unplug()
        try:
            if diagnosed is None:
                self._await_warning(robot, said)
            else:
                self._await_diagnosis(robot, diagnosed.topic)
            silent = output.stays_silent(max(0.5, 5.0 / self.rate_hz))
            robot.await_state(self.component, "active")
            now = robot.status(self.component)
        finally:
            plug.plug_in()
        assert now.pid == before.pid, (
            f"{self.component} was started anew ({now.reason}) when its device was unplugged: "
            "a driver waits for its device's return"
        )
        assert silent, f"{self.component} publishes {output.topic} without its device"

    def test_plugged_in_again_it_works(self, output: Reading[Any], device: object) -> None:
        """Within a limit, without anybody's help."""
        plug = _unpluggable(device)
        self.await_working(output, 0)
        plug.unplug()
        try:
            output.await_silence(3.0 / self.rate_hz, self.return_limit_s)
        finally:
            plug.plug_in()
        self.await_working(output, output.count)

    def _await_warning(self, robot: Robot, said: int) -> None:
        try:
            robot.run.await_line(
                rf"(WARNING|ERROR) +{robot.name}\.{self.component}: ",
                after=said,
                limit_s=self.tell_limit_s,
            )
        except AssertionError:
            raise AssertionError(
                f"{self.component} says nothing of its device having gone: neither a warning in "
                "its log, nor on a port `diagnostics`"
            ) from None

    def _await_diagnosis(self, robot: Robot, topic: str) -> None:
        shared = bool(self.other_writers(robot, topic))  # then its name tells its own

        def told(arrivals: Sequence[Arrival[DiagnosticArray]]) -> bool:
            return any(
                status.level > DiagnosticStatus.OK
                for arrival in arrivals
                for status in arrival.message.status
                if not shared or self.component in status.name
            )

        with robot.read(topic, DiagnosticArray) as diagnostics:
            what = "a status worse than OK, when the device was unplugged"
            diagnostics.await_that(told, what, limit_s=self.tell_limit_s)


class StopContract(Contract):
    """Stopping: its supervisor has to be able to rely on it."""

    def test_it_stops_in_good_order(self, robot: Robot, output: Reading[Any]) -> None:
        """Within its deployment's `stop_timeout_s`; else its supervisor has to kill it."""
        said = len(robot.run.lines)
        robot.unload(self.component)
        stopped = rf"{self.component} (did not stop cleanly|stopped): "
        robot.run.await_line(stopped, after=said)
        lines = [line for line in robot.run.lines[said:] if re.search(stopped, line)]
        robot.load(self.component)

        assert "stopped: shut down" in lines[0], f"it did not stop by itself: {lines[0].strip()}"
        self.await_working(output, output.count)


class EndContract(Contract):
    """The end: a robot is switched off in good order, or by force; nothing runs on."""

    def test_ctrl_c_ends_all_in_good_order(self, robot: Robot) -> None:
        """`cairn up` ends with exit status 0, and no process is left."""
        code = robot.run.stop()
        robot.run.await_nothing_left()

        assert code == 0, f"cairn up ended with exit status {code}; {robot.run}"

    def test_killed_nothing_is_left(self, bench: Bench) -> None:
        """When `cairn up` is killed, nobody can tell the driver to stop; yet it ends."""
        robot = bench.robot(self.component)
        robot.run.process.kill()
        robot.run.await_nothing_left()


def _unpluggable(device: object) -> Unpluggable:
    if not isinstance(device, Unpluggable):
        pytest.skip("the device cannot be unplugged here: no fixture `device` with unplug, plug_in")
    return device
