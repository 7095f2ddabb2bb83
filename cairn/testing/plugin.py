"""The pytest plugin: `pytest_plugins = ["cairn.testing.plugin"]` in a package's conftest.py.

Its fixtures launch deployments; a `Bench` keeps one running for many tests, and launches it again
if a test has broken it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from cairn.testing.device import Located, Routed
from cairn.testing.driver_contract import EndContract
from cairn.testing.launching import Launching, launching
from cairn.testing.robot import Bench, RunningDeployment, settings


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
