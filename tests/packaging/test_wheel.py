"""The built wheel, installed where this source tree is not seen, beside a user's own packages."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from textwrap import dedent

import pytest

from cairn.testing.launching import new_socket
from tests.installed import ROOT, Environment, build_source, build_wheels, fresh_environment
from tests.packaging.third_party import run_time_packages
from tests.wording import words_in_order

pytestmark = [pytest.mark.processes, pytest.mark.timeout(600)]

# A user's project may have packages of these names, which Cairn's rooms have, too.
USER_PROJECT = {
    "pyproject.toml": """
        [build-system]
        requires = ["hatchling"]
        build-backend = "hatchling.build"
        [project]
        name = "user-project"
        version = "1.0"
        [tool.hatch.build.targets.wheel]
        packages = ["components", "schemas", "supervisors", "vision"]
        """,
    "components/__init__.py": "",
    "components/greeter.py": """
        import cairn.components.localizer
        import cairn.supervisors
        import cairn.vision
        from cairn import Component, Out, every
        from schemas.words import Word
        from supervisors import NAME
        from vision import COLOR

        class Greeter(Component):
            words: Out[Word] = Out()

            @every(hz=10)
            def greet(self):
                self.words.publish(Word(text=NAME))
                self.finish(f"greeted in {COLOR} by {NAME}")
        """,
    "schemas/__init__.py": "",
    "schemas/words.py": """
        from cairn.schemas.field_types import String
        from cairn.schemas.message import message

        @message("user_msgs/msg/Word")
        class Word:
            text: String = ""
        """,
    "supervisors/__init__.py": "NAME = 'the user'",
    "vision/__init__.py": "COLOR = 'green'",
}
DEPLOYMENT = """
    cairn: 1
    components:
      greeter: {plugin: "components.greeter:Greeter", restart: transient, significant: true}
    """

BASE_COMPONENT = """
    from cairn import SENSOR, Component, In, on
    from cairn.schemas.sensor_msgs import LaserScan

    class Listener(Component):
        scan: In[LaserScan] = In(qos=SENSOR)

        @on("scan")
        def hear(self, scan):
            self.finish(f"received {len(scan.ranges)} ranges")
    """
BASE_DEPLOYMENT = """
    cairn: 1
    components:
      recorder: {plugin: recorder, parameters: {file: scans.mcap}}
      listener: {plugin: "listener:Listener", restart: transient, significant: true}
      scanner: {plugin: hokuyo_scanner, parameters: {port: PORT}}
    """
BASE_LIMIT_MB = 150  # of which numpy and zenoh are 91
PYTHONS = ("3.11", "3.12", "3.13", "3.14")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheels")
    (wheel,) = build_wheels(folder, build_source(folder))
    return wheel


@pytest.fixture(scope="module")
def base(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """An environment with the wheel and what it needs without an extra."""
    folder = tmp_path_factory.mktemp("base")
    environment = fresh_environment(folder / "venv", run_time_packages("").values())
    environment.install(wheel)
    return environment


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """An environment with the wheel and with the user's project."""
    folder = tmp_path_factory.mktemp("fresh")
    for name, text in USER_PROJECT.items():
        file = folder / "project" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(dedent(text), encoding="utf-8")
    environment = fresh_environment(folder / "venv")
    environment.install(wheel, folder / "project")
    environment.copy_kernels()
    return environment


@pytest.mark.accuracy
def test_wheel_contains_one_package_with_its_data(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()

    top = {name.partition("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == {"cairn"}
    for file in (
        "cairn/py.typed",
        "cairn/schemas/py.typed",
        "cairn/schemas/SOURCES.md",
        "cairn/schemas/std_srvs/srv/__init__.py",
        "cairn/schemas/std_srvs/srv/__init__.pyi",
        "cairn/deploy/sim.yaml",
        "cairn/deploy/maps/room.cairn",
        "cairn/deploy/worlds/hall.yaml",
        "cairn/deploy/worlds/textures/aloe.jpg",
        "cairn/deploy/recordings/fr079_corrected.log.gz",
        "cairn/deploy/deployment.schema.json",
        "cairn/deploy/robot/70-cairn.rules",
        "cairn/cli/skeleton/package/gauge.py.in",
    ):
        assert file in names
    assert not [name for name in names if "__pycache__" in name]
    definitions = {
        f"cairn/schemas/{file.relative_to(ROOT / 'schemas')}"
        for kind in ("msg", "srv", "action")
        for file in (ROOT / "schemas").glob(f"*/{kind}/*.*")
    }
    assert len(definitions) > 300
    assert definitions <= set(names)


@pytest.mark.accuracy
def test_base_is_small(base: Environment) -> None:
    sizes = [
        Path(folder, file).stat().st_size
        for folder, _, files in os.walk(base.site, followlinks=True)
        for file in files
        if not {"pip", "__pycache__"}.intersection(Path(folder).parts)
    ]

    assert sum(sizes) / 1e6 <= BASE_LIMIT_MB


@pytest.mark.accuracy
def test_base_runs_a_driver_and_records(base: Environment, tmp_path: Path) -> None:
    port = tmp_path / "port"
    (base.site / "listener.py").write_text(dedent(BASE_COMPONENT), encoding="utf-8")
    deployment = dedent(BASE_DEPLOYMENT).replace("PORT", str(port))
    (tmp_path / "base.yaml").write_text(deployment, encoding="utf-8")
    router = ("--set", f"bus.socket={new_socket()}")
    cairn = str(base.folder / "bin" / "cairn")

    assert "Run a robot" in base.run("cairn", "--help")
    assert "no problem" in base.run("cairn", "check", "base.yaml", folder=tmp_path)
    with subprocess.Popen(
        [cairn, "emulate", "hokuyo", "--pty", str(port)], env=base.variables()
    ) as emulator:
        try:
            ran = base.run(
                "cairn", "up", "base.yaml", *router, "--report", "report", folder=tmp_path
            )
        finally:
            emulator.terminate()

    assert "received 1081 ranges" in ran
    assert "/scan" in base.run("cairn", "recording", "info", "scans.mcap", folder=tmp_path)


@pytest.mark.accuracy
def test_base_names_what_a_component_and_a_command_lack(base: Environment, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("cairn: 1\ncomponents: {pose: {plugin: localizer}}\n", encoding="utf-8")
    navigation = "which is not installed; pip install 'cairn-robotics[navigation]'"

    with pytest.raises(AssertionError, match=words_in_order("localizer needs numba", navigation)):
        base.run("cairn", "check", str(file))
    with pytest.raises(AssertionError, match=words_in_order("command map needs", navigation)):
        base.run("cairn", "map", "build", "recording")
    with pytest.raises(AssertionError, match=words_in_order("installed: none", "security lacks")):
        base.run("cairn", "doctor", str(file))


@pytest.mark.accuracy
@pytest.mark.parametrize("installer", ["pip", "uv", "pipx"])
@pytest.mark.parametrize("version", PYTHONS)
def test_wheel_is_installed_by(installer: str, version: str, wheel: Path, tmp_path: Path) -> None:
    python = _python(version)
    command = "" if installer == "pip" else _program(installer)
    _skip_without_index(tmp_path)
    venv, cairn = tmp_path / "venv", tmp_path / "venv" / "bin" / "cairn"
    if installer == "pip":
        _call(python, "-m", "venv", str(venv))
        # Python compiles the few modules that are imported below.
        install = ("-m", "pip", "install", "--quiet", "--no-compile", str(wheel))
        _call(str(venv / "bin" / "python"), *install)
    elif installer == "uv":
        _call(command, "venv", "--quiet", "--python", python, str(venv))
        _call(command, "pip", "install", "--quiet", "--python", str(venv), str(wheel))
    else:
        folders = {"PIPX_HOME": str(tmp_path / "pipx"), "PIPX_BIN_DIR": str(tmp_path / "bin")}
        _call(command, "install", "--python", python, str(wheel), **folders)
        cairn = tmp_path / "bin" / "cairn"

    assert "Run a robot" in _call(str(cairn), "--help")
    assert "hokuyo_scanner" in _call(str(cairn), "plugins")


@pytest.mark.accuracy
def test_installed_package_finds_definitions_and_their_sources(
    installed: Environment, tmp_path: Path
) -> None:
    shown = installed.run("cairn", "schema", "show", "nav2_msgs/action/Spin", folder=tmp_path)

    assert "float32 target_yaw" in shown
    assert "std_srvs/srv/Trigger" in installed.run("cairn", "schema", "list", folder=tmp_path)


@pytest.mark.accuracy
def test_packages_of_the_user_may_have_the_names_of_cairns_folders(
    installed: Environment, tmp_path: Path
) -> None:
    (tmp_path / "user.yaml").write_text(dedent(DEPLOYMENT), encoding="utf-8")
    router = ("--set", f"bus.socket={new_socket()}")
    report = ("--report", str(tmp_path / "report"))

    ran = installed.run("cairn", "up", "user.yaml", *router, *report, folder=tmp_path)

    assert "greeted in green by the user" in ran
    where = "import cairn.components, components; print(components.__file__)"
    assert str(installed.site / "components") in installed.run("python", "-c", where)


@pytest.mark.accuracy
def test_shipped_robot_reaches_a_goal_in_an_empty_folder(
    installed: Environment, tmp_path: Path
) -> None:
    before = _files(installed.site / "cairn")
    sets = ["mission=[[1.8, 1.0, 0.0]]", "finish=true", f"bus.socket={new_socket()}"]
    words = [word for value in sets for word in ("--set", value)]

    ran = installed.run("cairn", "up", "sim", *words, "--report", "report", folder=tmp_path)

    assert "the mission succeeded" in ran
    assert (tmp_path / "report" / "logs" / "localizer.log").exists()
    assert _files(installed.site / "cairn") == before
    assert [file.name for file in tmp_path.iterdir()] == ["report"]


@pytest.mark.accuracy
def test_shipped_deployment_without_its_recording_asks_for_one(
    installed: Environment, tmp_path: Path
) -> None:
    with pytest.raises(
        AssertionError, match=words_in_order("not part of the installed package", "name your own")
    ):
        installed.run("cairn", "up", "replay_mrclam", "--report", "report", folder=tmp_path)


@pytest.mark.accuracy
def test_new_package_passes_its_own_tests(installed: Environment, tmp_path: Path) -> None:
    installed.run("cairn", "init", "my_robot", folder=tmp_path)
    project = tmp_path / "my_robot"
    installed.install(project)

    installed.check_tests_pass(folder=project)
    assert "my_robot_gauge: " in installed.run(
        "cairn", "plugins", "my_robot_gauge", folder=tmp_path
    )
    assert "no problem" in installed.run("cairn", "check", "deploy/my_robot.yaml", folder=project)


def _python(version: str) -> str:
    """Return the path of a Python of this version; skip the test if there is none."""
    of_pyenv = (Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python3")
    names = [sys.executable, _found(f"python{version}"), *map(str, of_pyenv)]
    for name in filter(None, names):
        code = "import sys; print('%d.%d' % sys.version_info[:2], sys._base_executable)"
        done = subprocess.run([name, "-c", code], capture_output=True, text=True, check=False)
        if done.returncode == 0 and done.stdout.split()[0] == version:
            return done.stdout.split()[1]
    pytest.skip(f"this computer has no Python {version}")


def _program(name: str) -> str:
    return _found(name) or pytest.skip(f"{name} is not installed")


def _found(name: str) -> str | None:
    beside = shutil.which(name, path=str(Path(sys.executable).parent))
    return beside or shutil.which(name)


def _skip_without_index(folder: Path) -> None:
    small = ("pip", "download", "--quiet", "--no-deps", "--dest", str(folder), "shellingham")
    command = [sys.executable, "-m", *small]
    if subprocess.run(command, capture_output=True, timeout=120, check=False).returncode:
        pytest.skip("no package index can be reached")


def _call(*words: str, **variables: str) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        words, env=environment | variables, capture_output=True, text=True, timeout=500,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _files(folder: Path) -> set[Path]:
    """Return all files but those that Python and Numba cache."""
    return {file for file in folder.rglob("*") if "__pycache__" not in file.parts}
