"""Whether a device may be opened by this user, and who else has it open."""

from __future__ import annotations

import getpass
import grp
import os
import socket
import stat
from contextlib import suppress
from pathlib import Path

import psutil

from cairn.cli.doctor.finding import Finding

_MAKERS = {"/dev/ptmx", "/dev/pts/ptmx"}
"""Who has these open makes a port in software, and is the device itself."""


def opened_by(path: Path, *, ours_too: bool = True) -> list[str]:
    """Processes that have a device open, as `name (pid)`; of other users' only root is told."""
    wanted = os.path.realpath(path)
    users = []
    for process in psutil.process_iter():
        with suppress(OSError, psutil.Error):
            folder = Path(f"/proc/{process.pid}/fd")
            links = {os.readlink(one) for one in folder.iterdir()}
            if wanted in links and not links & _MAKERS:
                name = _named(process)
                if ours_too or not name.startswith("cairn:"):
                    users.append(name)
    return users


def _named(process: psutil.Process) -> str:
    title = " ".join(process.cmdline()).strip()  # a title that was set is padded
    return f"{title if title.startswith('cairn:') else process.name()} ({process.pid})"


def connected_to(host: str, port: int) -> str:
    """The process that is connected to a device on the network, as `name (pid)`; else empty."""
    with suppress(OSError, psutil.Error):
        there = {address[4] for address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}
        for one in psutil.net_connections("tcp"):
            if one.status == psutil.CONN_ESTABLISHED and one.pid and one.raddr in there:
                return _named(psutil.Process(one.pid))
    return ""


def access(topic: str, path: Path, what: str) -> Finding:
    """Whether a device may be opened and is free; it is not opened, which could reset it."""
    if not path.exists():
        remedy = "plug it in, or correct the name; the kernel's log tells what came and went"
        return Finding(topic, str(path), "fail", f"{what}: is not there", remedy)
    if not stat.S_ISCHR(path.stat().st_mode):
        remedy = "remove it, and plug the device in anew"
        return Finding(topic, str(path), "fail", f"{what}: is no device, but a file", remedy)
    if not os.access(path, os.R_OK | os.W_OK):
        return Finding(topic, str(path), "fail", f"{what}: may not be opened", _remedy(path))
    if users := opened_by(path, ours_too=False):
        remedy = "end that process: two that read one device take each other's answers"
        found = f"{what}: in use by {', '.join(users)}"
        return Finding(topic, str(path), "warn", found, remedy)
    ours = opened_by(path)
    found = f"{what}; in use by {', '.join(ours)}" if ours else what
    return Finding(topic, str(path), "ok", found)


def _remedy(path: Path) -> str:
    status = path.stat()
    user = getpass.getuser()
    try:
        group = grp.getgrgid(status.st_gid)
    except KeyError:
        return "install Cairn's udev rules (docs/robot.md), and plug the device in anew"
    if not status.st_mode & stat.S_IRGRP or group.gr_name == "root":
        return "install Cairn's udev rules (docs/robot.md), and plug the device in anew"
    if user in group.gr_mem and status.st_gid not in os.getgroups():
        return f"log out and in again: {user} is in group {group.gr_name} since this session began"
    return f"sudo usermod -aG {group.gr_name} {user}, then log out and in again"
