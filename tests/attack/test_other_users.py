"""Another user of this computer opens the sockets and files of a run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest

import cairn.client
from tests.attack.conftest import Cases
from tests.attack.robot import AttackedRobot
from tests.cairn.cli.test_access import sockets_of, tcp_listeners
from tests.disk import open_to_others
from tests.navigation.processes import robot_in
from tests.patience import LIMIT_S

pytestmark = pytest.mark.skipif(
    os.geteuid() != 0, reason="only root may run a program as another user"
)

ANOTHER_USER: Final = 65534
AS_ANOTHER_USER: Final = """
import os, socket, sys
import zenoh
user, kind, *paths = sys.argv[1:]
os.setgroups([])
os.setresgid(int(user), int(user), int(user))  # after the imports
os.setresuid(int(user), int(user), int(user))
for path in paths:
    try:
        if kind == "connect":
            socket.socket(socket.AF_UNIX).connect(path)
        else:
            os.close(os.open(path, os.O_RDONLY if kind == "read" else os.O_WRONLY))
        print("accepted", path)
    except PermissionError as error:
        print("refused", path)
    except OSError as error:
        print(error, path)
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedRobot]:
    """A robot as it is by default: no endpoint but its user's socket."""
    with (
        robot_in(tmp_path_factory.mktemp("robot")) as observed,
        cairn.client.connect(observed.run.endpoint) as client,
    ):
        yield AttackedRobot(observed, "", client)


def attempts(user: int, kind: str, paths: list[Path]) -> dict[str, str]:
    """Return what a program of a user gets when it opens each path."""
    words = [sys.executable, "-c", AS_ANOTHER_USER, str(user), kind, *map(str, paths)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=True)
    found = (line.rsplit(" ", 1) for line in done.stdout.splitlines())
    return {path: result for result, path in found}


def test_sockets_are_closed_to_other_users(robot: AttackedRobot, cases: Cases) -> None:
    sockets = sockets_of(robot.run)
    cases(sockets)
    assert len(sockets) >= len(robot.pids)

    assert set(attempts(ANOTHER_USER, "connect", sockets).values()) == {"refused"}
    assert "accepted" in attempts(0, "connect", sockets).values()


def test_nothing_listens_on_the_network(robot: AttackedRobot) -> None:
    assert tcp_listeners(robot.run) == []


@pytest.mark.parametrize("kind", ["read", "write"])
def test_files_are_closed_to_other_users(robot: AttackedRobot, kind: str, cases: Cases) -> None:
    files = [path for path in robot.run.report.rglob("*") if path.is_file()]
    names = {path.name for path in files}
    cases(files)
    assert {"mission.json", "pose.json", "visual_map.cairn", "root.log"} <= names

    # The folder of the test is closed, too: the modes of the files must not depend on it.
    assert open_to_others(robot.run.report) == []
    assert set(attempts(ANOTHER_USER, kind, files).values()) == {"refused"}


def test_processes_are_closed_to_other_users(robot: AttackedRobot, cases: Cases) -> None:
    cases(robot.pids)
    memory = [Path(f"/proc/{pid}/mem") for pid in robot.pids.values()]

    assert set(attempts(ANOTHER_USER, "read", memory).values()) == {"refused"}


def test_secrets_are_neither_in_environments_nor_in_command_lines(
    robot: AttackedRobot, cases: Cases
) -> None:
    cases(robot.pids)
    for pid in robot.pids.values():
        for name in ("environ", "cmdline"):
            content = Path(f"/proc/{pid}/{name}").read_bytes().lower()
            assert b"secret" not in content
            assert b"exclusive" not in content


def test_afterward_the_robot_is_unharmed(
    robot: AttackedRobot, unharmed: Callable[[AttackedRobot], None]
) -> None:
    unharmed(robot)
