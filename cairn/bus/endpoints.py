"""Endpoints: where a router listens, and where one finds the router of a deployment."""

import ipaddress
import os
import re
import socket
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from cairn.errors import CairnError
from cairn.system.runtime_folder import LONGEST_SOCKET_PATH, check_private, runtime_folder

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
MAX_DOMAIN = 232
"""Largest domain: ROS 2 derives UDP ports from it, which end there."""

UNIX = "unixsock-stream/"
"""Protocol of Unix sockets, which only programs on this computer can open."""

_PROBE_LIMIT_S = 0.2
_NETWORK = re.compile(r"(?:tcp|tls|quic|udp|ws)/(\[[^\]]+\]|[^:/\[\]]+):(\d+)(?:[?#].*)?")


def parse_endpoint(text: str) -> str:
    """Return an endpoint as Zenoh writes it; a path (`/run/cairn/domain-0.sock`) is a Unix socket.

    Raises `ValueError` if it is neither a path nor an endpoint with a host and a port from 1 to
    65535.
    """
    path = text.removeprefix(UNIX)
    if path.startswith("/"):
        if len(path.encode()) > LONGEST_SOCKET_PATH:
            raise ValueError(
                f"{path!r} is too long for a Unix socket, whose path has at most "
                f"{LONGEST_SOCKET_PATH} bytes; use a shorter path"
            )
        return UNIX + path
    match = _NETWORK.fullmatch(text)
    if match is None or not 0 < int(match[2]) < 65536:
        raise ValueError(
            f"{text!r} is not an endpoint; write protocol/host:port as in tcp/127.0.0.1:7447, "
            "with protocol tcp, tls, quic, udp or ws and a port from 1 to 65535, or the path of a "
            "Unix socket as in /run/cairn/domain-0.sock"
        )
    return text


def socket_path(endpoint: str) -> Path | None:
    """Return the path of an endpoint that is a Unix socket, else None."""
    return Path(endpoint.removeprefix(UNIX)) if endpoint.startswith(UNIX) else None


def tcp_address(endpoint: str) -> tuple[str, int] | None:
    """Return the host and port of an endpoint over TCP, None for all others."""
    match = _NETWORK.fullmatch(endpoint)
    if match is None or not endpoint.startswith(("tcp/", "tls/", "ws/")):
        return None
    return match[1].strip("[]"), int(match[2])


def is_loopback(endpoint: str) -> bool:
    """Return whether only this computer can reach an endpoint that `parse_endpoint` accepts."""
    match = _NETWORK.fullmatch(endpoint)
    if match is None:
        return True
    host = match[1].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_encrypted(endpoint: str) -> bool:
    """Return whether an endpoint uses TLS, and so certificates."""
    return endpoint.startswith(("tls/", "quic/"))


def default_domain() -> int:
    """Return the domain where none is given: that of `ROS_DOMAIN_ID`, else 0.

    Raises `CairnError` if the variable is not a domain.
    """
    text = os.environ.get(DOMAIN_VARIABLE, "")
    try:
        return parse_domain(text)
    except ValueError as error:
        raise CairnError(f"{DOMAIN_VARIABLE}={text!r} {error}, or remove it") from error


def parse_domain(text: str) -> int:
    """Return the domain that a text gives, 0 if it is blank; `ValueError` if it gives none."""
    text = text.strip()
    if not re.fullmatch("[0-9]{0,3}", text) or int(text or 0) > MAX_DOMAIN:
        raise ValueError(f"is not a domain; set it to a number from 0 to {MAX_DOMAIN}")
    return int(text or 0)


def domain_socket(domain: int) -> Path:
    """Return the path of the socket at which the router of a domain listens by default."""
    return runtime_folder() / f"domain-{domain}.sock"


def listening_domains() -> list[int]:
    """Return the domains whose default sockets in the user's runtime folder accept connections."""
    found = []
    for path in runtime_folder().glob("domain-*.sock"):
        number = path.stem.removeprefix("domain-")
        with suppress(OSError, ValueError), socket.socket(socket.AF_UNIX) as probe:
            probe.settimeout(_PROBE_LIMIT_S)
            probe.connect(str(path))
            found.append(int(number))
    return sorted(found)


def domains_hint(domains: Iterable[int], where: str) -> str:
    """Return the sentence about deployments in other domains, empty if there are none."""
    listed = [str(domain) for domain in domains]
    if not listed:
        return ""
    return (
        f"; {where} domain {', '.join(listed)}: give --domain {listed[0]}, or set "
        f"{DOMAIN_VARIABLE}={listed[0]}"
    )


def endpoint_for(given: str, domain: int) -> str:
    """Return the endpoint at which to find a deployment's router: the given one, else the default.

    The default is the socket of the domain in the user's runtime folder. Raises `CairnError` if
    the given endpoint is invalid, or if another user could have made the default one.
    """
    try:
        if given:
            return parse_endpoint(given)
        endpoint = parse_endpoint(str(domain_socket(domain)))
    except ValueError as error:
        raise CairnError(f"the endpoint (--connect) is invalid: {error}") from error
    folder = runtime_folder()
    if folder.is_symlink() or folder.exists():
        check_private(folder)
    return endpoint
