"""Open the Zenoh session of a process: Unix sockets, no multicast, no implicit shared memory."""

import json
import os
import re
import secrets
import threading
import time
from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any

import zenoh

from cairn.bus.endpoints import UNIX
from cairn.errors import CairnError
from cairn.runtime_folder import (
    LONGEST_SOCKET_PATH,
    check_length,
    open_to_group,
    private_folder,
    runtime_folder,
)

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


def open_peer(connect: Sequence[str], socket: Path | None = None) -> zenoh.Session:
    """Open the session of a component's process.

    It connects to the router at `connect` and, as the router announces other processes, to each
    of them directly; those links outlive the router. The others reach it at `socket`, by default
    one in the user's runtime folder. Raises `CairnError` if no router answers.
    """
    listen = [UNIX + str(check_length(socket or _own_socket()))]
    session = _open(_config("peer", listen, connect), f"cannot open a session to {connect}")
    if not _has_router(session, _JOIN_TIMEOUT_S):
        session.close()
        raise CairnError(_no_router(connect))
    return session


def peer_socket(folder: Path, name: str) -> Path:
    """Return the path of the socket at which other peers reach the process of this name.

    It is the same whenever the process restarts, and replaces that of a killed process.
    """
    path = folder / f"{name}.sock"
    if len(os.fsencode(path)) <= LONGEST_SOCKET_PATH:
        return path
    return folder / f"{blake2b(name.encode(), digest_size=8).hexdigest()}.sock"


def _own_socket() -> Path:
    """Return the path of a new socket for a peer that belongs to no run."""
    folder = private_folder(private_folder(runtime_folder()) / "peers")
    for old in folder.iterdir():  # those of killed processes
        if not Path("/proc", old.name.partition("-")[0]).exists():
            old.unlink(missing_ok=True)
    return folder / f"{os.getpid()}-{secrets.token_hex(4)}.sock"


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


def open_router(
    socket: Path, listen: Sequence[str] = (), group: str | None = None
) -> zenoh.Session:
    """Open the session that is the deployment's router, at a Unix socket in a private folder.

    Only this user can connect to the socket, and the members of `group`. `listen` are further
    endpoints. Raises `CairnError` if the folder is not private or an endpoint is in use.
    """
    private_folder(socket.parent, group)
    endpoints = [UNIX + str(check_length(socket)), *listen]
    session = _open(
        _config("router", endpoints, ()),
        f"cannot listen on {', '.join(endpoints)}: probably another deployment or a ROS 2 router "
        "uses it; stop that one, join it (`--set bus.connect=[...]`), or use another domain "
        "(`--set domain=N`) or socket (`--set bus.socket=PATH`)",
    )
    if group is not None:
        try:
            open_to_group(socket, group)
        except CairnError:
            session.close()
            raise
    return session


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
