"""Open the Zenoh session of a process: Unix sockets, no multicast, no implicit shared memory."""

from __future__ import annotations

import json
import os
import re
import secrets
import socket as sockets
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final, Literal

import zenoh

from cairn.bus.credentials import (
    NO_CREDENTIALS,
    TLS_BUFFERS,
    Credentials,
    check_authorities,
    check_pair,
    read_password,
    write_dictionary,
)
from cairn.bus.endpoints import (
    UNIX,
    domains_hint,
    is_encrypted,
    listening_domains,
    socket_path,
    tcp_address,
)
from cairn.bus.keys import CAIRN_ID_PREFIX, PID_DIGITS, process_id
from cairn.bus.message_limits import DEFAULT_LIMITS, MessageLimits
from cairn.errors import CairnError
from cairn.system.runtime_folder import (
    LONGEST_SOCKET_PATH,
    check_length,
    open_to_group,
    private_folder,
    runtime_folder,
)

CONNECT_TIMEOUT_S = 2.0
"""A router on the same machine answers in milliseconds."""

_CLIENT_QUERY_MS = 1000

_JOIN_TIMEOUT_S = 10.0
"""A new process waits so long for its router, which may get no processor while many start."""

_TAG_DIGITS = 8

LEASE_MS = 5000
"""The link to a silent peer is closed after this time; that to a killed process at once.

Longer than a busy machine pauses, because requests in progress and their replies are lost with the
link.
"""

LINK_LEASE_MS = 2000
"""A router that links machines closes a silent link after this time.

What waited on the link is discarded with it: measurements that arrive seconds late, after a cut,
would be worse than none.
"""

_REFUSED = (
    "Does it accept your user name and password (CAIRN_USER, CAIRN_PASSWORD_FILE) or certificate "
    "(CAIRN_TLS_CA, CAIRN_TLS_CERTIFICATE, CAIRN_TLS_KEY)? "
)

_TLS_NAME = "; with TLS, the robot's certificate must contain the host name that you connect to"

_STUCK_US: Final = {
    "gateway": 1_000_000,
    "router": 1_500_000,
    "peer": 2_000_000,
    "client": 2_000_000,
}
"""A link on which services wait so long [us] for a reader that reads nothing is closed.

A reader keeps those waiting who send to it through others, too: the one next to it closes first.
"""

_PORT_TIMEOUT_S = 1.0
"""A message about a refused connection waits so long to learn whether the port is open."""

_RUST_LOCATION = re.compile(r" at /\S+\.rs:\d+\.?")


def open_peer(
    connect: Sequence[str],
    socket: Path | None = None,
    credentials: Credentials = NO_CREDENTIALS,
    limits: MessageLimits = DEFAULT_LIMITS,
    secret: str = "",
) -> zenoh.Session:
    """Open the session of a component's process, of the run with this secret.

    It connects to the router at `connect` and, as the router announces other processes, to each
    of them directly; those links outlive the router. The others reach it at `socket`, by default
    one in the user's runtime folder. Raises `CairnError` if no router answers.
    """
    socket = check_length(socket or _own_socket())
    dictionary = socket.with_suffix(".users")
    settings = credentials.session_settings(dictionary) | limits.transport_settings()
    try:
        session = _open(
            _config("peer", [UNIX + str(socket)], connect, settings, secret),
            f"cannot open a session to {connect}",
        )
    finally:
        dictionary.unlink(missing_ok=True)  # Zenoh has read it
    if not _has_router(session, _JOIN_TIMEOUT_S):
        session.close()
        raise CairnError(_no_router(connect, credentials))
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


def open_client(connect: Sequence[str], credentials: Credentials = NO_CREDENTIALS) -> zenoh.Session:
    """Open the session of a command: one link, to the router, which reaches all processes.

    Unlike a peer it need not wait until it knows all others, and it ends with the router. Raises
    `CairnError` if no router answers.
    """
    settings = credentials.session_settings() | DEFAULT_LIMITS.transport_settings()
    # Caches that do not answer delay the messages on a latched topic for so long.
    settings["queries_default_timeout"] = _CLIENT_QUERY_MS
    config = _config("client", [], connect, settings)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise CairnError(_no_router(connect, credentials)) from error


def open_router(
    socket: Path,
    listen: Sequence[str] = (),
    group: str | None = None,
    limits: MessageLimits = DEFAULT_LIMITS,
    secret: str = "",
    links: MachineLinks | None = None,
) -> zenoh.Session:
    """Open the session that is the deployment's router, at a Unix socket in a private folder.

    Only this user can connect to the socket, and the members of `group`. `listen` are further
    endpoints, `links` are those to the routers of the robot's other machines. Raises `CairnError`
    if the folder is not private or an endpoint is in use.
    """
    private_folder(socket.parent, group)
    endpoints = [UNIX + str(check_length(socket)), *listen]
    connect: tuple[str, ...] = ()
    settings = limits.transport_settings()
    failure = (
        f"cannot listen on {', '.join(endpoints)}: probably another deployment or a ROS 2 router "
        "uses it; stop that one, join it (`--set bus.connect=[...]`), or use another domain "
        "(`--set domain=N`) or socket (`--set bus.socket=PATH`)"
    )
    if links is not None:
        endpoints.append(links.listen)
        connect = links.connect
        settings |= links.settings()
        failure = (
            f"cannot listen on {', '.join(endpoints)}: an address is in use by another deployment, "
            f"or is not one of this computer; is this the machine {links.machine}?"
        )
    session = _open(_config("router", endpoints, connect, settings, secret), failure)
    if group is not None:
        try:
            open_to_group(socket, group)
        except CairnError:
            session.close()
            raise
    return session


@dataclass(frozen=True)
class MachineLinks:
    """The links of a machine's router to those of the robot's other machines, by mutual TLS.

    Every router is linked to every other one. Two that were linked by a third alone would keep
    what a lost machine has declared: zenoh 1.10 removes that at the routers next to it only.
    """

    machine: str
    listen: str
    """Where the router waits for the machines that come later in the deployment."""
    connect: tuple[str, ...]
    """The routers of the machines before it."""
    ca: str
    certificate: str
    key: str
    access_control: Mapping[str, Any]
    """What each of the other machines may do: Zenoh's setting of this name."""

    def settings(self) -> dict[str, Any]:
        """Return the settings of the router's session; raise `CairnError` for unusable files."""
        check_authorities(Path(self.ca))
        check_pair(Path(self.certificate), Path(self.key))
        return {
            "access_control": self.access_control,
            "transport/link/tx/lease": LINK_LEASE_MS,
            "transport/link/tls": {
                "root_ca_certificate": self.ca,
                "listen_certificate": self.certificate,
                "listen_private_key": self.key,
                "connect_certificate": self.certificate,
                "connect_private_key": self.key,
                "enable_mtls": True,
                "close_link_on_expiration": True,
                **TLS_BUFFERS,
            },
        }


@dataclass(frozen=True)
class Gateway:
    """How users on the network reach a deployment."""

    listen: tuple[str, ...]
    access_control: Mapping[str, Any]
    """What each of them may do: Zenoh's setting of this name."""
    password_files: Mapping[str, str]
    """The file with the password of each user; none if clients are known by certificates."""
    certificate: str | None = None
    key: str | None = None
    ca: str | None = None
    client_certificates: bool = False
    limits: MessageLimits = DEFAULT_LIMITS

    def open(self, router: Path, folder: Path) -> zenoh.Session:
        """Open the session between the network and the router at a Unix socket.

        It is a router of its own, so that access control costs nothing on local links. `folder` is
        private; for a moment it holds the passwords. Raises `CairnError` if an endpoint is in use,
        or a file cannot be used.
        """
        settings = {"access_control": self.access_control} | self.limits.transport_settings()
        dictionary = folder / "gateway.users"
        if self.password_files:
            files = self.password_files.items()
            write_dictionary(dictionary, {name: read_password(Path(file)) for name, file in files})
            settings["transport/auth/usrpwd"] = {"dictionary_file": str(dictionary)}
        if self.certificate is not None and self.key is not None:
            check_pair(Path(self.certificate), Path(self.key))
            settings["transport/link/tls"] = {
                "listen_certificate": self.certificate,
                "listen_private_key": self.key,
                **({"root_ca_certificate": self.ca} if self.ca else {}),
                "enable_mtls": self.client_certificates,
                "close_link_on_expiration": self.client_certificates,
                **TLS_BUFFERS,
            }
        endpoints = ", ".join(self.listen)
        try:
            session = _open(
                _config("gateway", self.listen, [UNIX + str(router)], settings),
                f"cannot listen on {endpoints}: an address is in use or not one of this computer, "
                "or TLS does not accept the certificate; correct bus.listen or bus.tls",
            )
        finally:
            dictionary.unlink(missing_ok=True)  # Zenoh has read it
        if not _has_router(session, _JOIN_TIMEOUT_S):
            session.close()
            raise CairnError(f"the gateway on {endpoints} does not reach the router at {router}")
        return session


def close_session(session: zenoh.Session, limit_s: float) -> None:
    """Close a session; one that takes longer [s] closes while its process goes on or ends.

    Zenoh waits up to 10 s for a stopped process or a busy router, and then raises `ZError`.
    """

    def close() -> None:
        with suppress(zenoh.ZError):
            session.close()

    closing = threading.Thread(target=close, name="cairn close", daemon=True)
    closing.start()
    closing.join(limit_s)


def process_of(zid: str) -> str:
    """Return the name of the process that has the session with this id, for messages."""
    pid = process_id(zid)
    return f"the foreign session {zid}" if pid is None else f"process {pid}"


def is_member(zid: str, secret: str) -> bool:
    """Return whether a session id proves that the session belongs to the run with this secret.

    Without a secret, every session of Cairn counts.
    """
    if not secret:
        return zid.startswith(CAIRN_ID_PREFIX)
    head, tag = zid[:-_TAG_DIGITS], zid[-_TAG_DIGITS:]
    known = zid.startswith(CAIRN_ID_PREFIX) and zid.isascii()
    return known and secrets.compare_digest(tag, _tag(head, secret))


def session_id(secret: str) -> str:
    """Return a new session id for this process; it proves that the session is of this run."""
    head = f"{CAIRN_ID_PREFIX}{os.getpid():0{PID_DIGITS}x}{secrets.token_hex(4)}"
    return head + (_tag(head, secret) if secret else secrets.token_hex(_TAG_DIGITS // 2))


def _tag(head: str, secret: str) -> str:
    text = b"session id " + head.encode()
    return blake2b(text, key=secret.encode()[:64], digest_size=_TAG_DIGITS // 2).hexdigest()


def is_connected(session: zenoh.Session, endpoint: str) -> bool:
    """Return whether the session has a link to the router at an endpoint, or can get one again.

    Zenoh restores a lost link by itself. A router that is stopped or too busy for that within
    `CONNECT_TIMEOUT_S` still has its endpoint open; that of one that has ended is closed.
    """
    return _has_router(session, CONNECT_TIMEOUT_S) or _is_open(endpoint)


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


def _no_router(connect: Sequence[str], credentials: Credentials) -> str:
    """Describe why no session could be opened, as far as this process can find out."""
    paths = [path for path in map(socket_path, connect) if path is not None]
    for path in paths:
        if not _may_open(path):
            return (
                f"no router answers at {path}: user {os.geteuid()} may not open it, only the user "
                "who runs the deployment, and the group that it names (`bus.group`); join that "
                "group, or give another endpoint by --connect or CAIRN_CONNECT"
            )
    no_router = f"no router answers at {', '.join(connect)}"
    ports = [endpoint for endpoint in connect if socket_path(endpoint) is None]
    if open_port := next(filter(_is_open, ports), None):
        return (
            f"{no_router}, but a program listens there: it rejected {credentials.presented()}, "
            f"or is not a Cairn router. {_REFUSED}`cairn doctor FILE` on the robot lists its "
            f"endpoints and users{_TLS_NAME if is_encrypted(open_port) else ''}"
        )
    refused = "" if len(paths) == len(connect) else _REFUSED
    others = domains_hint(listening_domains(), "deployments of yours run in") if paths else ""
    return (
        f"{no_router}: is a deployment running (`cairn up`)? "
        f"{refused}Give another endpoint by --connect or CAIRN_CONNECT{others}"
    )


def _is_open(endpoint: str) -> bool:
    """Return whether a program accepts connections at an endpoint."""
    path, address = socket_path(endpoint), tcp_address(endpoint)
    try:
        if path is not None:
            with sockets.socket(sockets.AF_UNIX) as socket:
                socket.settimeout(_PORT_TIMEOUT_S)
                socket.connect(str(path))
        elif address is not None:
            sockets.create_connection(address, _PORT_TIMEOUT_S).close()
    except OSError:
        return False
    return path is not None or address is not None


def _may_open(socket: Path) -> bool:
    """Return whether this user may connect to a socket, or it does not exist."""
    try:
        socket.stat()
    except PermissionError:
        return False
    except OSError:
        return True
    return os.access(socket, os.R_OK | os.W_OK, effective_ids=True)


def _open(config: zenoh.Config, failure: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = _RUST_LOCATION.sub("", str(error)).rstrip(".")
        raise CairnError(f"{failure} (Zenoh: {reason})") from error


def _config(
    kind: Literal["router", "gateway", "peer", "client"],
    listen: Sequence[str],
    connect: Sequence[str],
    more: Mapping[str, Any],
    secret: str = "",
) -> zenoh.Config:
    config = zenoh.Config()
    settings = {
        "mode": "router" if kind == "gateway" else kind,
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
        # Otherwise two peers that find each other connect twice, one from each side, and most pairs
        # keep both links: eclipse-zenoh/zenoh#1742.
        "scouting/gossip/autoconnect_strategy": {
            "peer": {"to_router": "always", "to_peer": "greater-zid"}
        },
        # Opening does not wait for peers: by default that takes half a second now and then.
        "open/return_conditions/connect_scouted": False,
        "scouting/delay": 0,
        # The router's description lists the sessions linked to it: `cairn.bus.discovery`.
        "adminspace/enabled": kind in ("router", "gateway"),
        "timestamping/enabled": True,
        "transport/link/tx/lease": LEASE_MS,
        # Bulk data of a link that wait for its reader: 1 MiB, as much as Zenoh allows, so that a
        # stereo camera's second image does not meet a queue that its first one has filled. With
        # 128 KiB, the default, a reader on a busy computer lost 1 to 4 % of the second images.
        "transport/link/tx/queue/size/data_low": 16,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _STUCK_US[kind],
        "transport/shared_memory/enabled": False,
        **more,
    }
    if kind in ("router", "peer"):  # those that answer discovery queries
        settings["id"] = session_id(secret)
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
