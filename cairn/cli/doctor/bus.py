"""The deployment's port, who answers there, and what a former run has left."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import suppress

import psutil

from cairn.cli.doctor.finding import Finding
from cairn.client import connect
from cairn.errors import CairnError
from cairn.supervision.orphan_cleanup import MARK

_TOPIC = "deployments"
_LIMIT_S = 1.0


def bus(endpoint: str, domain: int) -> Iterator[Finding]:
    """Who is at the router's endpoint, and processes without their deployment."""
    yield _router(endpoint, domain)
    yield from _leftovers()


def _router(endpoint: str, domain: int) -> Finding:
    if not _answers(endpoint):
        return Finding(_TOPIC, endpoint, "ok", "free: no deployment runs")
    try:
        with connect(endpoint, domain) as client:
            names = sorted(client.connection.statuses())
    except CairnError:
        owner = _listener(endpoint)
        remedy = (
            "end that program, or use another port: cairn up --set bus.listen=tcp/127.0.0.1:7448"
        )
        return Finding(_TOPIC, endpoint, "fail", f"taken by {owner}, which is no router", remedy)
    if not names:
        found = "a router without a deployment: one of ROS 2, perhaps"
        remedy = f"join it (--set bus.connect=[{endpoint}]), or end it"
        return Finding(_TOPIC, endpoint, "warn", found, remedy)
    robots = ", ".join(sorted({name.split("/")[1] for name in names}))
    return Finding(_TOPIC, endpoint, "ok", f"robot {robots} runs, {len(names)} components")


def _answers(endpoint: str) -> bool:
    host, _, port = _address(endpoint).rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _LIMIT_S):
            return True
    except OSError:
        return False


def _address(endpoint: str) -> str:
    return re.split(r"[?#]", endpoint.partition("/")[2], maxsplit=1)[0]


def _listener(endpoint: str) -> str:
    """Who listens on a port, as far as this user is told."""
    port = int(_address(endpoint).rpartition(":")[2])
    with suppress(psutil.Error):
        for connection in psutil.net_connections("tcp"):
            listens = connection.status == psutil.CONN_LISTEN and connection.laddr[1:] == (port,)
            if listens and connection.pid:
                return f"{psutil.Process(connection.pid).name()} ({connection.pid})"
    return "another program"


def _leftovers() -> Iterator[Finding]:
    """Processes of trees whose zygote has gone: it should have taken them with it."""
    trees: dict[str, list[psutil.Process]] = {}
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            mark = process.environ().get(MARK)
            if mark and process.status() != psutil.STATUS_ZOMBIE:
                trees.setdefault(mark, []).append(process)
    left = [one for tree in trees.values() if not any(map(_is_zygote, tree)) for one in tree]
    if left:
        pids = " ".join(str(process.pid) for process in left)
        found = f"{len(left)} processes have outlived their deployment"
        yield Finding(_TOPIC, "leftovers", "fail", found, f"kill -9 {pids}")
    else:
        yield Finding(_TOPIC, "leftovers", "ok", "none of a former run")


def _is_zygote(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        title = " ".join(process.cmdline())
        return title.startswith("cairn: zygote") or "cairn.supervision.zygote" in title
    return False
