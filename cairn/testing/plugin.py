"""The pytest plugin: `pytest_plugins = ["cairn.testing.plugin"]` in a package's conftest.py.

Its fixtures launch deployments; `Bench` keeps one running for many tests, and launches it again if
a test has broken it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

from cairn.bus.control import ControlError
from cairn.testing.device import Located, Routed
from cairn.testing.driver_contract import EndContract
from cairn.testing.launching import Launching, launching
from cairn.testing.robot import RunningDeployment

_STEPS = {"unconfigured": ("configure", "activate"), "inactive": ("activate",), "active": ()}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run tests that end a class's deployment last: the next would have to launch it again."""
    classes = groupby(items, key=lambda item: item.getparent(pytest.Class))
    items[:] = [item for _, tests in classes for item in sorted(tests, key=_ends)]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Launching]:
    """Launch deployments as `cairn up` does; nothing of them is left after the test."""
    with launching(tmp_path) as launch:
        yield launch


@pytest.fixture
def deploy(launch: Launching) -> Iterator[Callable[..., RunningDeployment]]:
    """Launch deployments and return each once all of its components are active.

    Takes what `Launching` takes: a file or a text, then arguments of `cairn up`.
    """
    robots: list[RunningDeployment] = []

    def start(
        deployment: str | Path, *arguments: str, robot: str = "robot", **how: Any
    ) -> RunningDeployment:
        robots.append(RunningDeployment(launch(deployment, *arguments, robot=robot, **how), robot))
        return robots[-1]

    yield start
    for robot in robots:
        robot.close()


@pytest.fixture(scope="class")
def device() -> object:
    """The device under the driver of a contract: unknown, unless overridden."""
    return None


@pytest.fixture(scope="class")
def bench(
    request: pytest.FixtureRequest, device: object, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Bench]:
    """The deployment that the tests of a contract's class share."""
    contract = request.cls
    words = [word for file in contract.overlays for word in ("--overlay", str(file))]
    words += [word for value in contract.sets for word in ("--set", value)]
    if isinstance(device, Located):
        words += settings(device.settings)
    connect = device.router if isinstance(device, Routed) else None
    folder = tmp_path_factory.mktemp(contract.__name__)
    with Bench(
        folder, contract.deployment, words, robot=contract.robot_name, connect=connect
    ) as bench:
        yield bench


def _ends(item: pytest.Item) -> bool:
    return isinstance(item, pytest.Function) and hasattr(EndContract, item.originalname)


class Bench:
    """A deployment that is launched when it is first needed; a context manager.

    At the end of the context it is stopped, and nothing of it may be left running.
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
        self._robot: RunningDeployment | None = None
        self._refusal = ""

    def robot(self, component: str) -> RunningDeployment:
        """Return the running deployment, with that component active.

        If a test has left the component inactive, it is activated; if that fails, or the deployment
        has ended, it is launched again. Raises `AssertionError` if it does not start.
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
                self._robot = RunningDeployment(run, self._name)
                self._robot.await_state(component, "active")
            except AssertionError as error:
                self._refusal = str(error)  # it would be the same for every test of the contract
                raise
        return self._robot

    def drop(self) -> None:
        """Kill the running deployment; the next call of `robot` launches it again."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()
            if robot.run.process.poll() is None:
                robot.run.process.kill()
            robot.run.await_nothing_left()

    def __enter__(self) -> Bench:
        """Launch nothing yet."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the deployment, and check that nothing of it is left."""
        if self._robot is not None:
            self._robot.close()
        self._stack.__exit__(kind, error, trace)


def settings(values: Mapping[str, object]) -> list[str]:
    """Return the arguments that give `cairn up` these settings."""
    return [word for name, value in values.items() for word in ("--set", _assigned(name, value))]


def _assigned(name: str, value: object) -> str:
    return f"{name}={json.dumps(value)}"  # JSON is YAML


def _brought_back(robot: RunningDeployment, component: str) -> bool:
    if robot.run.process.poll() is not None:
        return False
    try:
        for verb in _STEPS.get(robot.status(component).state, ()):
            robot.request(component, verb)
        robot.await_state(component, "active")
    except (AssertionError, ControlError):
        return False
    return True
