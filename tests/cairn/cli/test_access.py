"""Who may connect to a running deployment, and read what it writes."""

import grp
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.bus.endpoints import socket_path
from cairn.client import connect
from cairn.schemas.geometry_msgs import Twist
from cairn.testing.launching import Launching, Run, free_port, new_endpoint
from tests.commands import Answer, all_answered, await_answer, await_status, cairn
from tests.disk import open_to_others
from tests.patience import LIMIT_S
from tests.wording import assert_words

pytestmark = pytest.mark.processes

NOBODY = 65534
TALK = """
    components:
      listener: {plugin: test_listener}
      talker: {plugin: test_talker}
    """
CONNECT = """
import os, sys
import zenoh
user = int(sys.argv[1])
os.setgroups([])
os.setresgid(user, user, user)  # after the imports: another user may not read this Python
os.setresuid(user, user, user)
for endpoint in sys.argv[2:]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    try:
        zenoh.open(config).close()
        print("open")
    except zenoh.ZError:
        print("refused")
"""


def sockets_of(run: Run) -> list[Path]:
    """Return the sockets of the router and of all processes of a run."""
    listening = Path("/proc/net/unix").read_text(encoding="utf-8").splitlines()
    inodes = {line.split()[6]: line.split()[-1] for line in listening if line.count("/")}
    found = set()
    for pid in run.pids():
        for link in links_of(pid):
            if link.startswith("socket:[") and (path := inodes.get(link[8:-1])):
                found.add(Path(path))
    return sorted(found)


def links_of(pid: int) -> list[str]:
    """Return what the open files of a process are."""
    links = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            links.append(os.readlink(descriptor))
    return links


def tcp_listeners(run: Run) -> list[str]:
    """Return the TCP sockets on which processes of a run listen."""
    listening = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            if line.split()[3] == "0A":
                listening.add(f"socket:[{line.split()[9]}]")
    return [link for pid in run.pids() for link in links_of(pid) if link in listening]


@pytest.mark.accuracy
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may run a program as another user")
def test_other_users_cannot_connect_to_any_process_nor_read_what_it_writes(
    launch: Launching,
) -> None:
    run = launch(TALK, umask=0)
    run.await_line("received 1,")
    sockets = sockets_of(run)
    names = {path.name for path in sockets}

    assert {"listener.sock", "talker.sock"} <= names
    assert socket_path(run.endpoint) in sockets
    assert tcp_listeners(run) == []
    endpoints = [f"unixsock-stream/{path}" for path in sockets if "zygote" not in path.name]
    for user, answer in ((0, "open"), (NOBODY, "refused")):
        program = [sys.executable, "-c", CONNECT, str(user), *endpoints]
        tried = subprocess.run(program, capture_output=True, text=True, timeout=LIMIT_S)
        assert tried.stdout.split() == [answer] * len(endpoints), tried
    assert run.stop() == 0
    assert open_to_others(run.report) == []
    assert not any(path.exists() for path in sockets)


@pytest.mark.accuracy
def test_group_may_use_the_socket_and_the_rest_may_not(launch: Launching) -> None:
    endpoint = new_endpoint()
    path = socket_path(endpoint)
    assert path is not None
    folder = path.parent / "group"
    own = str(os.getegid())
    run = launch(TALK, "--set", f"bus.socket={folder}/a.sock", "--set", f"bus.group={group_name()}")
    run.await_line("child active: talker")

    assert (folder.stat().st_mode & 0o777, (folder / "a.sock").stat().st_mode & 0o777) == (
        0o750,
        0o660,
    )
    assert str((folder / "a.sock").stat().st_gid) == own
    assert run.stop() == 0


def group_name() -> str:
    """Return the name of this user's group."""
    return grp.getgrgid(os.getegid()).gr_name


def test_user_on_the_network_does_what_the_role_allows(
    launch: Launching, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    password = tmp_path / "password"
    password.touch(mode=0o600)
    password.write_text("correct horse\n")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    users = f"bus.users={{vera: {{role: view, password_file: {password}}}}}"
    run = launch(TALK, "--set", users, "--set", f"bus.listen=[{endpoint}]")
    run.await_line("received 1,")

    def remote(*arguments: str) -> Answer:
        return cairn(*arguments, connect=endpoint)

    assert_words(remote("ps").err, endpoint, "CAIRN_USER")
    monkeypatch.setenv("CAIRN_USER", "vera")
    assert_words(remote("ps").err, "CAIRN_PASSWORD_FILE", "set both")
    monkeypatch.setenv("CAIRN_PASSWORD_FILE", str(password))
    shown = await_answer(lambda: remote("ps", "--json"), all_answered)
    assert {row["component"] for row in shown.json} == {
        "/robot/root",
        "/robot/listener",
        "/robot/talker",
    }
    assert remote("param", "list", "talker").code == 0
    assert_words(remote("restart", "talker").err, "role does not allow")
    with connect(endpoint) as robot, pytest.raises(CairnError, match="role does not allow"):
        robot.publish("words", Twist())
    assert cairn("restart", "talker", connect=run.endpoint).code == 0
    log = [file.read_text(encoding="utf-8") for file in run.logs.iterdir()]
    for pid in run.pids():
        for file in ("environ", "cmdline"):
            assert b"correct horse" not in Path(f"/proc/{pid}/{file}").read_bytes()
    assert run.stop() == 0
    assert "correct horse" not in "".join([*run.lines, *log])


def test_deployment_that_would_let_in_anyone_does_not_start(launch: Launching) -> None:
    run = launch(TALK, "--set", f"bus.listen=[tcp/127.0.0.1:{free_port()}]")

    assert run.await_end() == 1
    run.await_line("could drive the robot; add `users` with passwords")


@pytest.mark.accuracy
def test_deployment_joins_another_one_with_a_password(launch: Launching, tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.touch(mode=0o600)
    password.write_text("correct horse\n")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    users = f"bus.users={{fleet: {{role: administer, password_file: {password}}}}}"
    user = ("--set", "bus.user=fleet", "--set", f"bus.password_file={password}")
    first = launch(TALK, "--set", users, "--set", f"bus.listen=[{endpoint}]", robot="alpha")
    first.await_line("received 1,")
    second = launch(TALK, *user, robot="beta", connect=endpoint)
    second.await_line("received 1,")

    for talker in ("/alpha/talker", "/beta/talker"):
        await_status(talker, lambda row: row["state"] == "active", first.endpoint)
    for log in second.logs.iterdir():
        assert "WARNING" not in log.read_text(encoding="utf-8")
    assert second.stop() == 0
    assert first.stop() == 0


@pytest.mark.accuracy
def test_endpoint_for_any_local_user_is_announced_and_needs_no_password(launch: Launching) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = launch(TALK, "--set", f"bus={{listen: [{endpoint}], allow_any_local_user: true}}")

    run.await_line(f"any user and program of this computer may drive the robot through {endpoint}")
    run.await_line("received 1,")
    assert cairn("restart", "talker", connect=endpoint).code == 0
    assert run.stop() == 0
