"""Keeps a deployment running for many tests, and starts it anew for the next if one broke it."""

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from cairn.bus.control import ControlError
from cairn.testing.launching import launching
from cairn.testing.robot import Robot

_STEPS = {"unconfigured": ("configure", "activate"), "inactive": ("activate",), "active": ()}


class Bench:
    """A deployment that is launched when it is first asked for; a context manager.

    At the end of the context it is stopped, and nothing of it must be left running.
    """

    def __init__(
        self,
        folder: Path,
        deployment: str | Path,
        arguments: Sequence[str] = (),
        *,
        robot: str = "robot",
        connect: str | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """`deployment` is a file, or a text with its keys; `arguments` are those of `cairn up`.

        `connect` is the endpoint of a router to join; by default the deployment opens its own.
        """
        self._deployment = deployment
        self._arguments = arguments
        self._name = robot
        self._connect = connect
        self._environment = environment
        self._stack = ExitStack()
        self._launch = self._stack.enter_context(launching(folder))
        self._robot: Robot | None = None
        self._refusal = ""

    def robot(self, component: str) -> Robot:
        """The running deployment, with that component active.

        If a test has left the component inactive, it is activated; if that cannot be done, or the
        deployment has ended, it is launched anew. Raises `AssertionError` if it does not start.
        """
        if self._robot is not None and not _brought_back(self._robot, component):
            self.drop()
        if self._robot is None:
            assert not self._refusal, self._refusal
            run = self._launch(
                self._deployment,
                *self._arguments,
                robot=self._name,
                connect=self._connect,
                environment=self._environment,
            )
            try:
                self._robot = Robot(run, self._name)
                self._robot.await_state(component, "active")
            except AssertionError as error:
                self._refusal = str(error)  # it would be the same for every test of the contract
                raise
        return self._robot

    def drop(self) -> None:
        """End the running deployment, however that can be done; the next is launched anew."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()
            if robot.run.process.poll() is None:
                robot.run.process.kill()
            robot.run.await_nothing_left()

    def __enter__(self) -> "Bench":
        """Nothing is launched yet."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop what runs, and prove that nothing of it is left."""
        if self._robot is not None:
            self._robot.close()
        self._stack.__exit__(kind, error, trace)


def settings(values: Mapping[str, object]) -> list[str]:
    """The words that give `cairn up` these settings."""
    return [word for name, value in values.items() for word in ("--set", _assigned(name, value))]


def _assigned(name: str, value: object) -> str:
    return f"{name}={json.dumps(value)}"  # JSON is YAML


def _brought_back(robot: Robot, component: str) -> bool:
    if robot.run.process.poll() is not None:
        return False
    try:
        for verb in _STEPS.get(robot.status(component).state, ()):
            robot.request(component, verb)
        robot.await_state(component, "active")
    except (AssertionError, ControlError):
        return False
    return True
