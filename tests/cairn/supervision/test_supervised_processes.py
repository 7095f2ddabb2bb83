"""A supervised deployment of real processes, whose parts are killed and which leaves nothing."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import LIMIT_S

from .reports import Report, Reports, Tree

pytestmark = pytest.mark.processes


COMPONENTS = ("base", "base's helper", "mobile", "localizer", "planner")


class Deployment:
    """The deployment of `supervised_program`, running."""

    def __init__(self, directory: Path, reports: Reports) -> None:
        self.reports = reports
        self.log = directory / "log"
        with (directory / "root.log").open("wb") as log:
            self.process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    f"{__package__}.supervised_program",
                    str(directory),
                    reports.path,
                ],
                stderr=log,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            )
        self.parts = {name: reports.of(name) for name in COMPONENTS}
        self.root = reports.of("root")

    def next_report(self, name: str) -> Report:
        """The report of a component's next incarnation."""
        self.parts[name] = self.reports.of(name)
        return self.parts[name]


@pytest.fixture
def deployment(tree: Tree, reports: Reports, tmp_path: Path) -> Iterator[Deployment]:
    deployment = Deployment(tmp_path, reports)
    yield deployment
    deployment.process.kill()
    deployment.process.wait(LIMIT_S)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stopping_the_root_leaves_nothing(
    deployment: Deployment, number: signal.Signals, tree: Tree
) -> None:
    deployment.process.send_signal(number)
    assert deployment.process.wait(LIMIT_S) == 0
    assert tree.processes() == []


def test_killing_the_root_leaves_nothing(deployment: Deployment, tree: Tree) -> None:
    deployment.process.kill()
    deployment.process.wait(LIMIT_S)
    tree.await_end()


def test_killing_the_root_leaves_nothing_even_of_stopped_processes(
    deployment: Deployment, tree: Tree
) -> None:
    for part in deployment.parts.values():
        os.kill(part.pid, signal.SIGSTOP)
    deployment.process.kill()
    deployment.process.wait(LIMIT_S)
    tree.await_end()


def test_a_killed_component_is_restarted_without_its_former_helper(
    deployment: Deployment,
) -> None:
    former_helper = deployment.parts["base's helper"]
    os.kill(deployment.parts["base"].pid, signal.SIGKILL)
    former_helper.await_end()
    assert deployment.next_report("base").facts["incarnation"] == 2
    assert deployment.next_report("base's helper").pid != former_helper.pid
    os.kill(deployment.parts["localizer"].pid, 0)


def test_a_killed_component_below_a_supervisor_is_restarted_by_that_one(
    deployment: Deployment,
) -> None:
    os.kill(deployment.parts["planner"].pid, signal.SIGKILL)
    assert deployment.next_report("planner").facts["incarnation"] == 2
    os.kill(deployment.parts["mobile"].pid, 0)
    os.kill(deployment.parts["localizer"].pid, 0)


def test_a_killed_supervisor_is_restarted_with_its_children(deployment: Deployment) -> None:
    below = [deployment.parts[name] for name in ("localizer", "planner")]
    os.kill(deployment.parts["mobile"].pid, signal.SIGKILL)
    for part in below:
        part.await_end()
    for name in ("mobile", "localizer", "planner"):
        assert deployment.next_report(name).pid not in [part.pid for part in below]
    os.kill(deployment.parts["base"].pid, 0)


def test_repeated_failures_escalate_to_the_root_which_leaves_nothing(
    deployment: Deployment, tree: Tree
) -> None:
    for incarnation in (1, 2, 3):
        assert deployment.parts["base"].facts["incarnation"] == incarnation
        os.kill(deployment.parts["base"].pid, signal.SIGKILL)
        if incarnation < 3:
            deployment.next_report("base")
    reason = deployment.reports.of("escalation").facts["reason"]
    assert reason.startswith("given up after more than 2 restarts within 60 s; last, base: ")
    assert reason.endswith("was killed by SIGKILL")
    assert deployment.process.wait(LIMIT_S) == 1
    assert tree.processes() == []


def test_a_supervisor_that_gives_up_is_restarted_by_the_root(
    deployment: Deployment,
) -> None:
    for incarnation in (1, 2, 3):
        assert deployment.parts["planner"].facts["incarnation"] == incarnation
        os.kill(deployment.parts["planner"].pid, signal.SIGKILL)
        if incarnation < 3:
            deployment.next_report("planner")
    assert deployment.next_report("mobile").facts["incarnation"] == 2
    assert deployment.next_report("planner").facts["incarnation"] == 1
    assert "given up after more than 2 restarts" in deployment.log.read_text()


def test_all_processes_end_with_a_killed_zygote_and_the_root_starts_again(
    deployment: Deployment, tree: Tree
) -> None:
    former = deployment.parts.copy()
    os.kill(deployment.root.facts["zygote"], signal.SIGKILL)
    for part in former.values():
        part.await_end()
    renewed = [deployment.next_report(name) for name in COMPONENTS]
    root = deployment.reports.of("root")
    assert root.facts["zygote"] != deployment.root.facts["zygote"]
    expected = {root.pid, root.facts["zygote"], *(part.pid for part in renewed)}
    assert {process.pid for process in tree.processes()} == expected
