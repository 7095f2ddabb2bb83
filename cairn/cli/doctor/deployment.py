"""A deployment: whether it is right, and whether the files and devices that it names are there."""

from __future__ import annotations

import getpass
import os
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from cairn.cli.doctor.access import access, connected_to
from cairn.cli.doctor.finding import Finding
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment, Member
from cairn.deployment.plugins import load_plugin
from cairn.deployment.problems import DeploymentError
from cairn.driver.device_names import TCP, devices_named
from cairn.errors import CairnError
from cairn.runtime.parameters import Config, ReadPathMark, marked_parameters

_LIMIT_S = 2.0


def loaded(
    file: Path, overlays: Sequence[Path], sets: Sequence[str]
) -> tuple[Deployment | None, list[Finding]]:
    """The deployment, None if it is not right, and what is found of it."""
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
    """Every file that a component of the deployment reads: is it there, may it be read?"""
    topic = f"files of {file.name}"
    for member in deployment.members():
        for read in marked_parameters(_config(member), ReadPathMark):
            what = f"{member.name}.{read.name}"
            if os.access(read.value, os.R_OK):
                yield Finding(topic, str(read.value), "ok", what)
            elif os.path.exists(read.value):  # which does not fail in a closed folder
                remedy = f"let {getpass.getuser()} read it: see `ls -l`, `chmod` and `chown`"
                yield Finding(topic, str(read.value), "fail", f"{what}: may not be read", remedy)
            else:
                remedy = f"make it, or name another one: --set {_key(member, read.name)}=PATH"
                yield Finding(topic, str(read.value), "fail", f"{what}: is not there", remedy)


def devices(file: Path, deployment: Deployment) -> Iterator[Finding]:
    """Every device that a driver of the deployment names: is it there, may it be opened?"""
    for member in deployment.members():
        yield from _devices_of(f"devices of {file.name}", member)


def _devices_of(topic: str, member: Member) -> Iterator[Finding]:
    for device in devices_named(_config(member)):
        what = f"{member.name}.{device.parameter}"
        try:
            found = device.find()
        except CairnError as error:
            key = _key(member, device.parameter)
            remedy = f"plug it in, or name another one: --set {key}=NAME"
            yield Finding(topic, what, "fail", str(error), remedy)
            continue
        if found.startswith(TCP):
            yield _on_network(topic, what, found.removeprefix(TCP))
        else:
            yield access(topic, Path(found), what)


def _config(member: Member) -> Config:
    return load_plugin(member.spec.plugin).config_class().model_validate(member.spec.parameters)


def _key(member: Member, parameter: str) -> str:
    return f"{member.key}.parameters.{parameter}"


def _on_network(topic: str, what: str, address: str) -> Finding:
    host, _, port = address.rpartition(":")
    if user := connected_to(host, int(port)):  # a scanner may take one client alone
        return Finding(topic, address, "ok", f"{what}; in use by {user}")
    try:
        socket.create_connection((host, int(port)), _LIMIT_S).close()
    except (OSError, ValueError) as error:
        remedy = f"try `ping {host}`: this computer needs an address of the same network"
        return Finding(topic, address, "fail", f"{what}: does not answer ({error})", remedy)
    return Finding(topic, address, "ok", f"{what}: answers")
