"""`cairn init`: the skeleton's names, style and types. Its own tests run with the built wheel."""

import subprocess
import sys
from pathlib import Path

import pytest

from cairn.deployment.load import load_deployment
from tests.commands import cairn

ROOT = Path(__file__).parents[3]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_skeleton_has_the_requested_names_and_no_placeholder(folder: Path) -> None:
    answer = cairn("init", "field_rover")

    assert (answer.code, answer.err) == (0, "")
    project = folder / "field_rover"
    assert (project / "field_rover" / "gauge.py").exists()
    assert (project / "deploy" / "field_rover.yaml").exists()
    assert (project / ".gitignore").exists()
    texts = {file: file.read_text() for file in project.rglob("*") if file.is_file()}
    assert 'name = "field-rover"' in texts[project / "pyproject.toml"]
    assert not [file for file, text in texts.items() if "package}" in text or "$p" in text]
    assert not list(project.rglob("*.in"))


def test_robot_of_the_skeleton_drives_and_maps_with_its_own_name(folder: Path) -> None:
    assert cairn("init", "field_rover").code == 0
    robot = folder / "field_rover" / "deploy" / "robot.yaml"

    deployment = load_deployment(robot)

    assert deployment.robot.name == "field_rover"
    assert "maps/ground_floor.yaml" in robot.read_text()
    overlays = ["--overlay", "robot_without_camera", "--overlay", "robot_mapping"]
    assert cairn("check", str(robot), *overlays).code == 0


@pytest.mark.parametrize(
    "name",
    ["My_Robot", "my-robot", "1robot", "class", "cairn", "tests", "numpy", "json"],
)
def test_name_that_no_package_can_have_is_rejected(folder: Path, name: str) -> None:
    answer = cairn("init", name)

    assert answer.code == 1
    assert name in answer.err
    assert not (folder / name).exists()


def test_folder_with_files_is_not_changed(folder: Path) -> None:
    (folder / "rover").mkdir()
    (folder / "rover" / "thesis.txt").write_text("all of it")

    answer = cairn("init", "rover")

    assert answer.code == 1
    assert "not an empty folder" in answer.err
    assert [file.name for file in (folder / "rover").iterdir()] == ["thesis.txt"]


def test_empty_folder_is_filled(folder: Path) -> None:
    (folder / "rover").mkdir()

    assert cairn("init", "rover").code == 0
    assert (folder / "rover" / "pyproject.toml").exists()


@pytest.mark.processes
@pytest.mark.parametrize("check", [("ruff", "check"), ("ruff", "format", "--check"), ("mypy",)])
def test_skeleton_passes_its_own_checks(folder: Path, check: tuple[str, ...]) -> None:
    cairn("init", "my_robot")
    # Checking Cairn itself takes seconds; what has changed since the last time is checked again.
    mypy = [sys.executable, "-m", "mypy", "--cache-dir", str(ROOT / ".mypy_cache" / "skeleton")]
    program = mypy if check == ("mypy",) else [_ruff(), *check[1:]]

    done = subprocess.run([*program, "."], cwd="my_robot", capture_output=True, text=True)

    assert done.returncode == 0, done.stdout + done.stderr


def _ruff() -> str:
    return str(Path(sys.executable).with_name("ruff"))
