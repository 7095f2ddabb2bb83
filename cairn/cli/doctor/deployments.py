"""Deployments: the running ones, leftovers, and what a deployment file needs of this computer."""

from __future__ import annotations

import getpass
import os
import re
import socket
import stat
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import psutil

from cairn.bus.endpoints import domain_socket, endpoint_for, is_encrypted, is_loopback, socket_path
from cairn.cli.doctor import Finding
from cairn.cli.doctor.devices import access, connected_to
from cairn.cli.doctor.machines import links
from cairn.client import connect
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment, Member
from cairn.deployment.plugins import load_plugin
from cairn.deployment.problems import DeploymentError
from cairn.driver.device_names import TCP, devices_named
from cairn.errors import CairnError
from cairn.processes.orphan_cleanup import MARK
from cairn.runtime.parameters import Config, ReadPathMark, marked_parameters
from cairn.schemas.cairn_msgs import MachineStatus

_TOPIC = "deployments"
_ROUTER_LIMIT_S = 1.0
_DEVICE_LIMIT_S = 2.0
_ENDING_LIMIT_S = 5.0
"""The processes of a deployment that is ending are gone within this time."""


def running(endpoint: str, domain: int) -> Iterator[Finding]:
    """Report what listens at the router's endpoint, and processes without their deployment."""
    machines: dict[str, list[MachineStatus]] = {}
    yield _router(endpoint, domain, machines)
    yield _leftovers()
    for robot, statuses in sorted(machines.items()):
        yield from links(robot, statuses)


def loaded(
    file: Path, overlays: Sequence[Path], sets: Sequence[str]
) -> tuple[Deployment | None, list[Finding]]:
    """Return the deployment, None if it has problems, and the findings."""
    topic = file.name
    try:
        deployment = load_deployment(file, overlays, sets)
    except DeploymentError as error:
        return None, [
            Finding(topic, f"{problem.at}: {problem.path}", "fail", problem.found, problem.remedy)
            for problem in error.problems
        ]
    count = len(list(deployment.members()))
    return deployment, [Finding(topic, "deployment", "ok", f"{count} components, no problem")]


def files(file: Path, deployment: Deployment) -> Iterator[Finding]:
    """Check every file that a component of the deployment reads: does it exist, is it readable?"""
    topic = f"files of {file.name}"
    for member in deployment.members():
        for read in marked_parameters(_config(member), ReadPathMark):
            name = f"{member.name}.{read.name}"
            if os.access(read.value, os.R_OK):
                yield Finding(topic, str(read.value), "ok", name)
            elif os.path.exists(read.value):  # this does not fail in a closed folder
                remedy = f"let {getpass.getuser()} read it: see `ls -l`, `chmod` and `chown`"
                yield Finding(topic, str(read.value), "fail", f"{name}: may not be read", remedy)
            else:
                key = _setting(deployment, read.value) or _key(member, read.name)
                remedy = f"create it, or name another one: --set {key}=PATH"
                yield Finding(topic, str(read.value), "fail", f"{name}: does not exist", remedy)


def devices(file: Path, deployment: Deployment) -> Iterator[Finding]:
    """Check every device that a driver of the deployment names: does it exist, is it free?"""
    for member in deployment.members():
        yield from _devices_of(f"devices of {file.name}", member)


def _closed_to_group(deployment: Deployment) -> Path | None:
    """Return a folder above the router's socket that only its owner may enter, if there is one.

    Cairn opens the socket's own folder to the group, but none above it, such as /run/user/1000.
    """
    given = deployment.bus.socket
    socket_file = Path(given) if given is not None else domain_socket(deployment.domain)
    for folder in socket_file.absolute().parent.parents:
        with suppress(OSError):
            if not folder.stat().st_mode & (stat.S_IXGRP | stat.S_IXOTH):
                return folder
    return None


def who_may_connect(file: Path, deployment: Deployment) -> Iterator[Finding]:
    """Report who may connect to a deployment: on this computer, and at each network endpoint."""
    topic, bus = f"access to {file.name}", deployment.bus
    if bus.connect:
        found = f"those who may connect to {', '.join(bus.connect)}, which it joins"
        yield Finding(topic, "all users", "ok", found)
        return
    local = "the user who runs it"
    if bus.group is not None:
        local += f", and the members of group {bus.group}"
    if bus.group is not None and (closed := _closed_to_group(deployment)):
        found = f"{local}, but {closed} is open to its owner alone"
        remedy = "set bus.socket to a path in a folder of yours that the group can reach"
        yield Finding(topic, "Unix socket", "warn", found, remedy)
    else:
        yield Finding(topic, "Unix socket", "ok", local)
    roles = {name: user.role for name, user in bus.users.items()} or (
        bus.tls.certificate_roles if bus.tls is not None else {}
    )
    by = "password" if bus.users else "certificate"
    for endpoint in bus.listen:
        if bus.allow_any_local_user:
            found = "every program of every user of this computer, who may drive the robot"
            remedy = "use bus.users or certificates unless you trust all: docs/how-to/connect.md"
            yield Finding(topic, endpoint, "warn", found, remedy)
            continue
        found = f"by {by}: " + ", ".join(f"{name} ({role})" for name, role in roles.items())
        if bus.tls is not None and bus.tls.identity is not None:
            found = "by certificate: the operators in the roster (cairn security list)"
        if is_loopback(endpoint) or is_encrypted(endpoint):
            yield Finding(topic, endpoint, "ok", found)
        else:
            remedy = "use a tls/ endpoint: docs/how-to/connect.md"
            yield Finding(topic, endpoint, "warn", f"{found}; not encrypted", remedy)


def _router(given: str, domain: int, machines: dict[str, list[MachineStatus]]) -> Finding:
    """Report what is at an endpoint; add the statuses of the machines of robots there."""
    try:
        endpoint = endpoint_for(given, domain)
    except CairnError as error:
        found, _, remedy = str(error).partition("; ")
        return Finding(_TOPIC, given or f"domain {domain}", "fail", found, remedy)
    if not _accepts_connections(endpoint):
        return Finding(_TOPIC, endpoint, "ok", "free: no deployment runs")
    try:
        with connect(endpoint, domain) as client:
            names = sorted(client.connection.statuses())
            machines |= client.connection.machine_statuses()
    except CairnError:
        owner = _listener(endpoint)
        remedy = (
            "end that program, or use another endpoint (--set bus.socket=PATH, --set bus.listen=[])"
        )
        return Finding(_TOPIC, endpoint, "fail", f"taken by {owner}, which is not a router", remedy)
    if not names:
        found = "a router without a deployment, perhaps one of ROS 2"
        remedy = f"join it (--set bus.connect=[{endpoint}]), or end it"
        return Finding(_TOPIC, endpoint, "warn", found, remedy)
    robots = ", ".join(sorted({name.split("/")[1] for name in names}))
    return Finding(_TOPIC, endpoint, "ok", f"robot {robots} runs, {len(names)} components")


def _accepts_connections(endpoint: str) -> bool:
    if path := socket_path(endpoint):
        with socket.socket(socket.AF_UNIX) as probe, suppress(OSError):
            probe.settimeout(_ROUTER_LIMIT_S)
            probe.connect(os.fspath(path))
            return True
        return False
    host, _, port = _address(endpoint).rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _ROUTER_LIMIT_S):
            return True
    except OSError:
        return False


def _address(endpoint: str) -> str:
    return re.split(r"[?#]", endpoint.partition("/")[2], maxsplit=1)[0]


def _listener(endpoint: str) -> str:
    """Return the process that listens at an endpoint, if this user may know it."""
    if path := socket_path(endpoint):
        with suppress(psutil.Error):
            for connection in psutil.net_connections("unix"):
                if str(connection.laddr) == os.fspath(path) and connection.pid:
                    return f"{psutil.Process(connection.pid).name()} ({connection.pid})"
        return "another program"
    port = int(_address(endpoint).rpartition(":")[2])
    with suppress(psutil.Error):
        for connection in psutil.net_connections("tcp"):
            listens = connection.status == psutil.CONN_LISTEN and connection.laddr[1:] == (port,)
            if listens and connection.pid:
                return f"{psutil.Process(connection.pid).name()} ({connection.pid})"
    return "another program"


def _leftovers() -> Finding:
    """Find processes that outlive their zygote: it should have terminated them."""
    deadline = time.monotonic() + _ENDING_LIMIT_S
    left = _without_zygote()
    while left and (left_s := deadline - time.monotonic()) > 0:
        psutil.wait_procs(left, timeout=left_s)
        left = _without_zygote()
    if not left:
        return Finding(_TOPIC, "leftovers", "ok", "no process of an earlier run")
    pids = " ".join(str(process.pid) for process in left)
    found = f"{len(left)} processes have outlived their deployment"
    return Finding(_TOPIC, "leftovers", "fail", found, f"kill -9 {pids}")


def _without_zygote() -> list[psutil.Process]:
    """Return the processes of deployments whose zygote has ended, perhaps a moment ago."""
    trees: dict[str, list[psutil.Process]] = {}
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            mark = process.environ().get(MARK)
            if mark and process.status() != psutil.STATUS_ZOMBIE:
                trees.setdefault(mark, []).append(process)
    return [one for tree in trees.values() if not any(map(_is_zygote, tree)) for one in tree]


def _is_zygote(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        title = " ".join(process.cmdline())
        return title.startswith("cairn: zygote") or "cairn.processes.zygote:main" in title
    return False


def _devices_of(topic: str, member: Member) -> Iterator[Finding]:
    for device in devices_named(_config(member)):
        name = f"{member.name}.{device.parameter}"
        try:
            found = device.find()
        except CairnError as error:
            key = _key(member, device.parameter)
            remedy = f"plug it in, or name another one: --set {key}=NAME"
            yield Finding(topic, name, "fail", str(error), remedy)
            continue
        if found.startswith(TCP):
            yield _on_network(topic, name, found.removeprefix(TCP))
        else:
            yield access(topic, Path(found), name)


def _on_network(topic: str, name: str, address: str) -> Finding:
    host, _, port = address.rpartition(":")
    if user := connected_to(host, int(port)):  # a scanner may accept one client only
        return Finding(topic, address, "ok", f"{name}; in use by {user}")
    try:
        socket.create_connection((host, int(port)), _DEVICE_LIMIT_S).close()
    except (OSError, ValueError) as error:
        remedy = f"try `ping {host}`: this computer needs an address in the same network"
        return Finding(topic, address, "fail", f"{name}: does not answer ({error})", remedy)
    return Finding(topic, address, "ok", f"{name}: answers")


def _config(member: Member) -> Config:
    return load_plugin(member.spec.plugin).config_class().model_validate(member.spec.parameters)


def _setting(deployment: Deployment, file: Path) -> str | None:
    """Return the top-level setting that names the file; None if there is none, or several."""
    names = [
        name
        for name, value in deployment.settings.items()
        if isinstance(value, str) and Path(value) == file
    ]
    return f"settings.{names[0]}" if len(names) == 1 else None


def _key(member: Member, parameter: str) -> str:
    return f"{member.key}.parameters.{parameter}"
