"""A deployment is code: what `cairn check --no-import` and commands that only read run of it."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from tests.commands import cairn
from tests.wording import assert_words

DEPLOYMENT = """\
cairn: 1
components:
  listed: {plugin: test_talker, parameters: {unknown: 1}, topics: {unknown: there}}
  direct: {plugin: "untrusted_plugin:Harmful"}
"""
PLUGIN = """\
import pathlib
from cairn import Component
pathlib.Path(__file__).with_name("was_imported").touch()
class Harmful(Component):
    pass
"""
# Runs commands with an audit hook; prints each program started, file changed and server opened.
WATCHED = """\
import json, os, sys
CALLS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty",
         "os.spawn", "os.startfile", "pty.spawn", "socket.bind", "os.rename", "os.remove",
         "os.rmdir", "os.chmod", "os.chown", "os.symlink", "os.link", "os.truncate", "os.mkdir",
         "os.kill", "shutil.copyfile", "shutil.move", "shutil.rmtree", "tempfile.mkstemp"}
WRITES = os.O_WRONLY | os.O_RDWR
seen = []
def hook(event, arguments):
    if event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITES:
        seen.append([event, str(arguments[0])])
    elif event in CALLS and not (event == "os.kill" and arguments[1] == 0):
        seen.append([event, str(arguments[0])])
from cairn.cli.main import main
sys.addaudithook(hook)
for words in json.loads(sys.argv[1]):
    sys.argv = ["cairn", *words]
    try:
        main()
    except SystemExit:
        pass
ours = [name for name in sys.modules if name.startswith(("cairn.components", "cairn_test_plugins"))]
print(json.dumps({"seen": seen, "imported": ours}), file=sys.stderr)
"""


@pytest.fixture
def deployment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "untrusted_plugin.py").write_text(PLUGIN)
    (tmp_path / "untrusted.yaml").write_text(DEPLOYMENT)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "untrusted.yaml"


def test_check_without_imports_runs_no_code_of_the_deployment(deployment: Path) -> None:
    done = _watched(["check", str(deployment), "--no-import"], folder=deployment.parent)

    assert done == {"seen": [], "imported": []}
    assert not (deployment.parent / "was_imported").exists()


def test_check_imports_the_modules_that_a_deployment_names(deployment: Path) -> None:
    """The opposite, so that the test above proves something."""
    cairn("check", str(deployment))

    assert (deployment.parent / "was_imported").exists()


def test_check_without_imports_states_what_it_has_not_checked(deployment: Path) -> None:
    answer = cairn("check", str(deployment), "--no-import")

    assert answer.code == 0
    assert_words(answer.out, "2 components, no problem", "not checked", "parameters", "ports")
    listed = cairn("check", str(deployment), "--no-import", "--json").json
    assert listed["valid"] is True
    assert "parameters" in listed["not_checked"]


def test_check_without_imports_reports_keys_names_and_missing_plugins(deployment: Path) -> None:
    deployment.write_text(
        dedent(
            """\
            cairn: 1
            components:
              first: {plugin: test_takler}
              second: {plugin: "no_such_module:Class", restrat: never}
              supervisor: {plugin: test_talker}
            """
        )
    )

    answer = cairn("check", str(deployment), "--no-import")

    assert answer.code == 1
    assert_words(answer.err, ":3:", "test_takler", "test_talker", ":4:", "restrat", "restart")
    assert "no_such_module" not in answer.err


def test_commands_that_only_read_start_no_program_and_change_no_file(tmp_path: Path) -> None:
    """Not counted: what is cached for an import; files of `tempfile`; whether a process exists."""
    file = tmp_path / "robot.yaml"
    file.write_text("cairn: 1\ncomponents: {talker: {plugin: test_talker}}\n")

    done = _watched(
        ["check", str(file)],
        ["doctor", str(file)],
        ["plugins", "test_talker"],
        ["deployments"],
        ["schema", "show", "sensor_msgs/msg/LaserScan"],
        folder=tmp_path,
    )

    assert [
        (event, what)
        for event, what in done["seen"]
        if "__pycache__" not in what and os.path.dirname(what) != tempfile.gettempdir()
    ] == []
    assert sorted(one.name for one in tmp_path.iterdir()) == ["robot.yaml"]


def _watched(*commands: list[str], folder: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, json.dumps(commands)],
        cwd=folder,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stderr.splitlines()[-1])
    return found
