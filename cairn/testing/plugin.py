"""The pytest plugin: `pytest_plugins = ["cairn.testing.plugin"]` in a package's conftest.py.

Its fixtures launch deployments; a `Bench` keeps one running for many tests, and launches it again
if a test has broken it. A failed test shows the warnings and errors of its deployments.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from cairn.testing.device import Located, Routed
from cairn.testing.driver_contract import EndContract
from cairn.testing.launching import Launching, Run, launching
from cairn.testing.robot import Bench, RunningDeployment, settings

_SHOWN_LINES = 25
_LAUNCHING = pytest.StashKey[dict[str, Bench | Launching]]()
"""The fixtures of the session that launch deployments, by name, while they are set up."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run tests that end a class's deployment last: the next would have to launch it again."""
    classes = groupby(items, key=lambda item: item.getparent(pytest.Class))
    items[:] = [item for _, tests in classes for item in sorted(tests, key=_ends)]


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """Remember which fixtures launch deployments, whatever their names."""
    value = yield
    if isinstance(value, Bench | Launching):
        request.session.stash.setdefault(_LAUNCHING, {})[fixturedef.argname] = value
    return value


def pytest_fixture_post_finalizer(
    fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
) -> None:
    """Forget a fixture at its end."""
    request.session.stash.get(_LAUNCHING, {}).pop(fixturedef.argname, None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add to the report of a failed test what its deployments logged."""
    report = yield
    if report.failed:
        known = item.session.stash.get(_LAUNCHING, {})
        for name in getattr(item, "fixturenames", ()):
            if name in known:
                report.sections += [("cairn up", _problems_of(run)) for run in _last(known[name])]
    return report


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

    def start(deployment: str | Path, *arguments: str, **how: Any) -> RunningDeployment:
        robots.append(RunningDeployment(launch(deployment, *arguments, **how)))
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
    for setting in ("deployment", "component"):
        assert hasattr(contract, setting), f"{contract.__name__}.{setting} is not set"
    words = [word for file in contract.overlays for word in ("--overlay", str(file))]
    words += [word for value in contract.sets for word in ("--set", value)]
    if isinstance(device, Located):
        words += settings(device.settings)
    connect = device.router if isinstance(device, Routed) else None
    folder = tmp_path_factory.mktemp(contract.__name__)
    with Bench(folder, contract.deployment, words, connect=connect) as bench:
        bench.check_component(contract.component, f"{contract.__name__}.component")
        yield bench


def _last(launching: Bench | Launching) -> list[Run]:
    """Return the runs that a test may have used; a bench's earlier ones belong to other tests."""
    return launching.runs[-1:] if isinstance(launching, Bench) else launching.runs


def _problems_of(run: Run) -> str:
    """Return the log folder of a run and the last lines of its warnings and errors."""
    lines = run.problems(_SHOWN_LINES)
    text = "\n".join(["warnings and errors:", *lines] if lines else ["no warnings, no errors"])
    return f"logs: {run.logs}\n{text}"


def _ends(item: pytest.Item) -> bool:
    return isinstance(item, pytest.Function) and hasattr(EndContract, item.originalname)
