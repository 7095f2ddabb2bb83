"""Open the Zenoh session of a process: loopback, no multicast, no implicit shared memory."""

import json
import os
import re
import secrets
import threading
import time
from collections.abc import Sequence
from typing import Any

import zenoh

from cairn.errors import CairnError

CONNECT_TIMEOUT_S = 2.0
"""A router on the same machine answers in milliseconds."""

_JOIN_TIMEOUT_S = 10.0
"""A new process waits so long for its router, which may get no processor while many start."""

CAIRN_ID_PREFIX = "ca1c0de5"
"""Prefix of the session ids of components and routers, which answer discovery queries.

The process id follows, so that a process that does not answer can be named without asking it.
"""

LEASE_MS = 5000
"""The link to a silent peer is closed after this time; that to a killed process at once.

Longer than a busy machine pauses, because requests in progress and their replies are lost with the
link.
"""

_RUST_LOCATION = re.compile(r" at /\S+\.rs:\d+\.?")


def open_peer(connect: Sequence[str]) -> zenoh.Session:
    """Open the session of a component's process.

    It connects to the router at `connect` and, as the router announces other processes, to each
    of them directly; those links outlive the router. Raises `CairnError` if no router answers.
    """
    listen = ["tcp/127.0.0.1:0"]
    session = _open(_config("peer", listen, connect), f"cannot open a session to {connect}")
    if not _has_router(session, _JOIN_TIMEOUT_S):
        session.close()
        raise CairnError(_no_router(connect))
    return session


def open_client(connect: Sequence[str]) -> zenoh.Session:
    """Open the session of a command: one link, to the router, which reaches all processes.

    Unlike a peer it need not wait until it knows all others, and it ends with the router. Raises
    `CairnError` if no router answers.
    """
    config = _config("client", [], connect)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise CairnError(_no_router(connect)) from error


def open_router(listen: str, connect: Sequence[str] = ()) -> zenoh.Session:
    """Open the session that is the deployment's router; `CairnError` if the port is taken."""
    return _open(
        _config("router", [listen], connect),
        f"cannot listen on {listen}: the port is probably in use by another deployment or a ROS 2 "
        "router; stop that one, join it (`--set bus.connect=[...]`), or use another port "
        "(`--set bus.listen=tcp/127.0.0.1:PORT`)",
    )


def process_of(zid: str) -> str:
    """Return the name of the process that has the session with this id, for messages."""
    if not zid.startswith(CAIRN_ID_PREFIX):
        return f"the foreign session {zid}"
    digits = zid.removeprefix(CAIRN_ID_PREFIX)[:8]
    return f"process {int(digits, 16)}"


def is_connected(session: zenoh.Session) -> bool:
    """Return whether the session has a link to a router, or gets one in `CONNECT_TIMEOUT_S`.

    Zenoh restores a lost link by itself if the router still runs.
    """
    return _has_router(session, CONNECT_TIMEOUT_S)


def _has_router(session: zenoh.Session, timeout_s: float) -> bool:
    changed = threading.Event()
    callback: Any = zenoh.handlers.Callback(lambda _: changed.set(), indirect=False)
    listener = session.info.declare_transport_events_listener(callback, history=True)
    try:
        deadline = time.monotonic() + timeout_s
        while not list(session.info.routers_zid()):
            if not changed.wait(max(0.0, deadline - time.monotonic())):
                return False
            changed.clear()
        return True
    finally:
        listener.undeclare()


def _no_router(connect: Sequence[str]) -> str:
    return (
        f"no router answers at {', '.join(connect)}: is a deployment running (`cairn up`)? "
        "Give another endpoint by --connect or CAIRN_CONNECT"
    )


def _open(config: zenoh.Config, failure: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = _RUST_LOCATION.sub("", str(error)).rstrip(".")
        raise CairnError(f"{failure} (Zenoh: {reason})") from error


def _config(mode: str, listen: Sequence[str], connect: Sequence[str]) -> zenoh.Config:
    config = zenoh.Config()
    settings = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": 50,
            "period_max_ms": 200,
            "period_increase_factor": 1.5,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        # Opening does not wait for peers: by default that takes half a second now and then.
        "open/return_conditions/connect_scouted": False,
        "scouting/delay": 0,
        # The router's description lists the sessions linked to it: `cairn.bus.discovery`.
        "adminspace/enabled": mode == "router",
        "timestamping/enabled": True,
        "transport/link/tx/lease": LEASE_MS,
        "transport/shared_memory/enabled": False,
    }
    if mode != "client":
        settings["id"] = f"{CAIRN_ID_PREFIX}{os.getpid():08x}{secrets.token_hex(8)}"
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
