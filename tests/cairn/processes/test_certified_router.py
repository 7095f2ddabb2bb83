"""Routers follow the certificates that are in force, whatever the authority's service does."""

from __future__ import annotations

import os
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from cairn.bus.session import MachineLinks
from cairn.deployment.machine_access import machine_access
from cairn.deployment.model import Deployment
from cairn.processes.certified_router import AuthorityPoll, CertifiedRouter, machine_links
from cairn.security import enrollment
from cairn.security.authority import Authority, AuthorityMember
from cairn.security.enrollment import write_url
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import Launching, free_port
from tests.cairn.bus.network import eventually
from tests.commands import Answer, cairn
from tests.patience import LIMIT_S

ADDRESS = ("127.0.0.1",)


@pytest.fixture
def authority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Authority:
    """The authority of robot `robot`, on this computer."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "security"))
    members = [
        AuthorityMember("base", None, ADDRESS),
        AuthorityMember("brain", None, ADDRESS),
        AuthorityMember("alice", "administer"),
    ]
    return Authority.create(RobotFolder.of("robot"), members)


@contextmanager
def silent_service() -> Iterator[tuple[str, threading.Event]]:
    """Accept connections and never answer; yield the address, and whether one has come."""
    connected = threading.Event()
    accepted: list[socket.socket] = []

    def accept() -> None:
        while True:
            try:
                accepted.append(server.accept()[0])
            except OSError:  # it is closed
                return
            connected.set()

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=accept)
        thread.start()
        try:
            yield f"https://127.0.0.1:{server.getsockname()[1]}", connected
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join(LIMIT_S)
            for one in accepted:
                one.close()


def test_silent_service_of_the_authority_delays_no_revocation(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(enrollment, "_LIMIT_S", 10 * LIMIT_S)
    machines = {name: {"address": "127.0.0.1", "port": free_port()} for name in ("base", "brain")}
    deployment = Deployment.model_validate(
        {"cairn": 1, "machines": machines, "components": {"a": {"plugin": "supervisor"}}}
    )
    opened: list[MachineLinks | None] = []

    def open_router(links: MachineLinks | None) -> Callable[[], None]:
        opened.append(links)
        return lambda: None

    def admitted() -> set[str]:
        assert opened[-1] is not None
        return {one["id"] for one in opened[-1].access_control["subjects"]}

    read = partial(machine_links, deployment, "base", machine_access(deployment, "base"))
    with silent_service() as (url, asked):
        with authority.folder.locked():
            write_url(authority.folder, url)
        with (
            closing(AuthorityPoll("robot", "base")),
            closing(CertifiedRouter("links", read, open_router)),
        ):
            assert "brain" in admitted()
            assert asked.wait(LIMIT_S)  # its answer is awaited until the end of this test
            authority.revoke("brain")
            assert eventually(lambda: "brain" not in admitted())
            authority.revoke("base")  # the own one: no links at all
            assert eventually(lambda: opened[-1] is None)


class Operator:
    """A user on the network, on a computer with a copy of the own identity."""

    def __init__(self, folder: RobotFolder, name: str, home: Path, endpoint: str) -> None:
        self._endpoint = endpoint
        self._environment = {"CAIRN_TLS_CA": str(home / "ca.pem")}
        home.mkdir()
        for variable, path in (
            ("CAIRN_TLS_CA", folder.ca),
            ("CAIRN_TLS_CERTIFICATE", folder.certificate(name)),
            ("CAIRN_TLS_KEY", folder.key(name)),
        ):
            self._environment[variable] = str(shutil.copy2(path, home))

    def cairn(self, *arguments: str) -> Answer:
        """Run a command on the operator's computer."""
        with patch.dict(os.environ, self._environment):
            return cairn(*arguments, connect=self._endpoint)


@pytest.mark.accuracy
@pytest.mark.processes
def test_operators_of_the_roster_are_admitted_while_the_robot_runs(
    authority: Authority, launch: Launching, tmp_path: Path
) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    get = ("param", "get", "beacon", "log_level")
    alice = Operator(authority.folder, "alice", tmp_path / "alice", endpoint)
    tls: Any = ("--set", f"bus.listen=[{endpoint}]", "--set", "bus.tls={identity: base}")
    run = launch("components: {beacon: {plugin: test_beacon}}", *tls)
    run.await_line("root: child active: beacon")
    assert eventually(lambda: alice.cairn(*get).code == 0)

    authority.add(AuthorityMember("wall", "view"))
    authority.add(AuthorityMember("bob", "administer"))
    wall, bob = (Operator(authority.folder, name, tmp_path / name, endpoint)
                 for name in ("wall", "bob"))  # fmt: skip
    assert eventually(lambda: bob.cairn(*get).code == 0)
    authority.revoke("alice")
    assert eventually(
        lambda: (
            alice.cairn(*get).code == 1
            and bob.cairn(*get).code == 0  # the gateway is open again
            and alice.cairn(*get).code == 1
        )
    )
    change = ("param", "set", "beacon", "log_level=debug")
    assert eventually(lambda: wall.cairn(*get).code == 0)
    assert wall.cairn(*change).code == 1
    assert bob.cairn(*change).code == 0

    authority.revoke("base")
    assert eventually(lambda: bob.cairn(*get).code == 1)
    assert eventually(lambda: "network endpoints closed: " in run.log_of("root"))
    assert cairn(*get, connect=run.endpoint).code == 0
