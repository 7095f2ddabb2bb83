"""The example of docs/how-to/component.md works as the page says, as an installed package."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.commands import await_status, cairn
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


EXAMPLE = Path(__file__).parents[2] / "docs" / "example"
TURTLE = "deploy/turtle.yaml"


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the example's package with pip, outside of the project; return the folder."""
    folder = tmp_path_factory.mktemp("installed")
    source = folder / "source"
    shutil.copytree(EXAMPLE, source, ignore=shutil.ignore_patterns("__pycache__"))
    words = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target"]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *words, str(folder / "site"), str(source)],
        check=True,
        timeout=LIMIT_S,
    )
    return folder / "site"


@pytest.fixture
def user(shell: Callable[[Path, Path], Any], installed: Path) -> Any:
    """Return a shell in the example's folder, with its package installed."""
    return shell(EXAMPLE, installed)


def test_quoted_blocks_match_the_files(page_blocks: Callable[[str], Any]) -> None:
    quoted = [block for block in page_blocks("docs/how-to/component.md") if block.title]

    assert len(quoted) >= 8
    for block in quoted:
        file = (EXAMPLE / block.title).read_text(encoding="utf-8")
        for part in re.split(r"^    \.\.\.$", block.text, flags=re.MULTILINE):
            assert part.strip("\n") in file, f"not in {block.title}:\n{part}"


@pytest.mark.accuracy
def test_package_is_found_by_its_entry_points(user: Any) -> None:
    plugins = {plugin["plugin"]: plugin for plugin in json.loads(user.cairn("plugins", "--json"))}

    assert plugins["turtle_wanderer"]["package"] == "turtle-robot 0.1.0"
    assert "4 components, no problem" in user.cairn("check", TURTLE)
    schema = json.loads(user.cairn("schema", "show", "turtle_msgs/msg/BaseState", "--json"))
    assert "float32 charge" in schema["definition"]


@pytest.mark.accuracy
def test_class_is_found_without_an_entry_point(
    shell: Callable[[Path, Path], Any], endpoint: str
) -> None:
    user = shell(EXAMPLE, EXAMPLE)
    classes = {
        "turtle_supervisor": "turtle_robot.supervisor:TurtleSupervisor",
        "base": "turtle_robot.base:TurtleBase",
        "wanderer": "turtle_robot.wanderer:Wanderer",
    }
    sets = [f"--set=components.{name}.plugin={plugin}" for name, plugin in classes.items()]

    assert "no problem" in user.cairn("check", TURTLE, *sets)


@pytest.mark.accuracy
def test_lockstep_gives_the_same_run_for_the_same_seed(user: Any, tmp_path: Path) -> None:
    logs = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        words = ("--lockstep", "--seed", "3", "--set", "distance=5", "--report", str(folder))
        user.cairn("up", TURTLE, *words)
        logs.append((folder / "logs" / "lockstep.log").read_text(encoding="utf-8"))

    assert "5.0 m traveled" in logs[0]
    assert logs[0] == logs[1]


@pytest.mark.accuracy
def test_real_processes_can_be_inspected_and_tuned_as_on_the_page(
    user: Any, tmp_path: Path, endpoint: str
) -> None:
    with running(user, tmp_path, f"bus.socket={endpoint}") as turtle:
        wait_for(turtle, "child active: wanderer")
        # The wanderer is the first of them to be active, the root the last one.
        await_status("/turtle/root", lambda row: row["state"] == "active", endpoint)
        rows = {row["component"]: row for row in cairn("ps", "--json", connect=endpoint).json}
        # Only a program that finds the package knows the message type.
        echo = ("topic", "echo", "base_state", "--count=1", "--json", "--connect", endpoint)
        state = json.loads(user.cairn(*echo))
        refused = cairn("param", "set", "wanderer", "distance=1000000", connect=endpoint)
        tuned = cairn("param", "set", "wanderer", "speed=0.8", "turn_speed=3", connect=endpoint)
        speed = cairn("param", "get", "wanderer", "speed", connect=endpoint)
        turtle.send_signal(signal.SIGINT)
        assert turtle.wait(timeout=LIMIT_S) == 0

    names = ["root", "turtle_supervisor", "velocity_gate", "base", "wanderer"]
    assert {rows[f"/turtle/{name}"]["state"] for name in names} == {"active"}
    assert len({rows[f"/turtle/{name}"]["pid"] for name in names}) == len(names)
    assert 0.0 <= state["charge"] <= 1.0
    assert refused.code == 1
    assert "distance = 1000000" in refused.err
    assert tuned.code == 0
    assert speed.json == 0.8


@pytest.mark.accuracy
def test_component_runs_unchanged_in_its_parents_process(
    user: Any, tmp_path: Path, endpoint: str
) -> None:
    placement = "components.wanderer.placement=in_process"
    with running(user, tmp_path, f"bus.socket={endpoint}", placement, "distance=0.2") as turtle:
        assert "m traveled" in wait_for(turtle, "ended: ")
        assert turtle.wait(timeout=LIMIT_S) == 0

    logs = {log.stem for log in (tmp_path / "logs").iterdir()}
    assert logs == {"root", "turtle_supervisor", "velocity_gate", "base"}


@pytest.mark.accuracy
def test_packages_own_tests_pass(user: Any) -> None:
    done = user.run(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests")

    assert "passed" in done


@contextmanager
def running(user: Any, report: Path, *sets: str) -> "Iterator[subprocess.Popen[str]]":
    """Run `cairn up` in real processes, with a distance that the turtle does not reach."""
    words = [f"--set={value}" for value in ("distance=1000", *sets)]
    cairn = str(Path(sys.executable).with_name("cairn"))
    process = subprocess.Popen(
        [cairn, "up", TURTLE, "--report", str(report), *words],
        cwd=user.folder,
        env=user.environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=LIMIT_S)


def wait_for(process: "subprocess.Popen[str]", text: str) -> str:
    """Return the first printed line that contains the text; fail with all lines if none does."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        if text in line:
            return line
        lines.append(line)
    pytest.fail(f"{text!r} was not printed, but: {''.join(lines)}")
