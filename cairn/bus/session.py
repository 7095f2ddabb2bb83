"""Opens the Zenoh session of a process: loopback, no multicast, no implicit shared memory."""

import json
import secrets
import threading
import time
from collections.abc import Sequence
from typing import Any

import zenoh

from cairn.errors import CairnError

CONNECT_LIMIT_S = 2.0
"""A router on the same machine answers in milliseconds."""

MARK = "ca1c0de5"
"""The ids of a component's, or its deployment's, session begin so: such a one can be met."""

LEASE_MS = 5000
"""A silent peer's link is given up after so long; that of a killed one at once.

Longer than a busy machine pauses: with the link, requests under way and their answers are lost.
"""


def open_peer(connect: Sequence[str]) -> zenoh.Session:
    """Open the session of a component's process or of a command.

    It links to the router at `connect` and, told by it, to every other process directly; those
    links outlive the router. Raises `CairnError` if nobody listens at `connect`.
    """
    listen = ["tcp/127.0.0.1:0"]
    session = _open(_config("peer", listen, connect), f"cannot open a session to {connect}")
    if not is_connected(session):
        session.close()
        raise CairnError(_nobody(connect))
    return session


def open_client(connect: Sequence[str]) -> zenoh.Session:
    """Open the session of a command: one link, to the router, which knows and reaches everybody.

    Unlike a peer it need not wait until it knows all others, and it ends with the router. Raises
    `CairnError` if nobody listens at `connect`.
    """
    config = _config("client", [], connect)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise CairnError(_nobody(connect)) from error


def open_router(listen: str, connect: Sequence[str] = ()) -> zenoh.Session:
    """Open the session that is the deployment's router; `CairnError` if the port is taken."""
    return _open(
        _config("router", [listen], connect),
        f"cannot listen on {listen}: the port is probably taken, by another deployment or a ROS 2 "
        "router. Stop that one, join it (`--set bus.connect=[...]`), or take another port "
        "(`--set bus.listen=tcp/127.0.0.1:PORT`)",
    )


def is_connected(session: zenoh.Session) -> bool:
    """Whether the session has a link to a router, or gets one within `CONNECT_LIMIT_S`.

    A link that was lost comes back by itself, if the router is still there.
    """
    changed = threading.Event()
    callback: Any = zenoh.handlers.Callback(lambda _: changed.set(), indirect=False)
    listener = session.info.declare_transport_events_listener(callback, history=True)
    try:
        deadline = time.monotonic() + CONNECT_LIMIT_S
        while not list(session.info.routers_zid()):
            if not changed.wait(max(0.0, deadline - time.monotonic())):
                return False
            changed.clear()
        return True
    finally:
        listener.undeclare()


def _nobody(connect: Sequence[str]) -> str:
    return (
        f"no router answers at {', '.join(connect)}: is a deployment running (`cairn up`)? "
        "Name another endpoint with --connect, or in CAIRN_CONNECT"
    )


def _open(config: zenoh.Config, refusal: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = str(error).partition(" at /")[0]
        raise CairnError(f"{refusal}. ({reason})") from error


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
        # Opening waits for nobody: by default it lasts half a second, for peers now and then.
        "open/return_conditions/connect_scouted": False,
        "scouting/delay": 0,
        # The router tells who is linked to it: `cairn.bus.discovery`.
        "adminspace/enabled": mode == "router",
        "timestamping/enabled": True,
        "transport/link/tx/lease": LEASE_MS,
        "transport/shared_memory/enabled": False,
    }
    if mode != "client":
        settings["id"] = MARK + secrets.token_hex(12)
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
