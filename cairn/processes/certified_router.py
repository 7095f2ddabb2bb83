"""Routers with certificates of `cairn security`, which are opened again when others are in force.

Zenoh reads certificates and access control when a session opens. The components here do not notice
a new router: their links to each other outlive the old one, and they connect to the new one.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Generic, TypeAlias, TypeVar, get_args

import zenoh

from cairn.bus.discovery import DiscoveryBarrier
from cairn.bus.roles import Role
from cairn.bus.session import Gateway, MachineLinks, close_session
from cairn.deployment.access_control import admitted
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.limits.files import read_bounded
from cairn.processes.machine_identity import machine_identity, own_machine
from cairn.security.folder import PEM_BYTES, RobotFolder
from cairn.system.files import explained

_FETCH_S: Final = 2.0
"""So often the roster is fetched, and a second later at most it is in force: within 5 s."""
_READ_S: Final = 1.0
"""So often the files are read, which `cairn security` may change, too."""
_RETRY_S: Final = 60.0  # of a renewal that has failed
_JOIN_LIMIT_S: Final = 1.0  # a request to the authority may take longer; its thread is a daemon
_CLOSE_LIMIT_S: Final = 2.0

Links = TypeVar("Links", MachineLinks, Gateway)
"""With what a router is opened: its certificate, and who may do what."""


def machine_links(deployment: Deployment, machine: str, access: Mapping[str, Any]) -> MachineLinks:
    """Return the links of a machine's router, with the certificates in force now.

    `access` is its `machine_access`. Raises `CairnError` if this machine's own identity is not in
    force.
    """
    identity = machine_identity(deployment.robot.name, machine)
    names = list(deployment.machines)
    before = names[: names.index(machine)]
    return MachineLinks(
        machine=machine,
        listen=deployment.machines[machine].endpoint,
        connect=tuple(deployment.machines[other].endpoint for other in before),
        ca=str(identity.ca),
        certificate=str(identity.certificate),
        key=str(identity.key),
        access_control=admitted(access, identity.common_names),
    )


def gateway_for_operators(gateway: Gateway, robot: str, identity: str) -> Gateway:
    """Return a gateway that admits the operators in force now, with their roles in the roster.

    Raises `CairnError` if the identity of this computer is not in force.
    """
    own = own_machine(robot, identity)
    from cairn.security.roster import read_roster  # which needs `cryptography`, as `own_machine`

    roster = read_roster(RobotFolder.of(robot))
    names = {role: roster.common_names("operator", role) for role in get_args(Role)}
    return replace(
        gateway,
        certificate=str(own.certificate),
        key=str(own.key),
        ca=str(own.ca),
        client_certificates=True,
        access_control=admitted(gateway.access_control, names),
    )


class CertifiedRouter(Generic[Links]):
    """Keeps a router open with the certificates in force; `close` closes it.

    It reads only files of this computer, so that nothing on the network delays a revocation that
    has arrived here.
    """

    def __init__(
        self,
        what: str,
        read: Callable[[], Links],
        open_router: Callable[[Links | None], Callable[[], None]],
    ) -> None:
        """Open the router.

        Args:
            what: what it is for, in the log.
            read: return the links that are in force now; `CairnError` if there may be none.
            open_router: open it with links, or without if there may be none; return what closes it.

        Raises `CairnError` as `read` and `open_router`.
        """
        self.log = _root_log()
        self._what = what
        self._read: Callable[[], Links] = read
        self._open_router: Callable[[Links | None], Callable[[], None]] = open_router
        self._links: Links | None = read()
        self._certificate = _content(self._links)
        self._close: Callable[[], None] | None = open_router(self._links)
        self._problem = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cairn certificates", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the router."""
        self._closed.set()
        self._thread.join()
        self._close_router()

    def _run(self) -> None:
        while not self._closed.wait(_READ_S):
            self._update()

    def _update(self) -> None:
        """Open the router again if other certificates are in force now."""
        links: Links | None = None
        try:
            links = self._read()
            certificate = _content(links)
        except CairnError as error:
            links, certificate, reason = None, b"", str(error)
        if (links, certificate) == (self._links, self._certificate) and self._close is not None:
            return
        if links is None and self._links is not None:
            self.log.critical("%s closed: %s", self._what, reason)
        self._links, self._certificate = links, certificate
        self._close_router()
        try:
            self._close = self._open_router(links)
        except CairnError as error:  # the next turn tries it again
            if str(error) != self._problem:
                self.log.error("%s: the router cannot be opened again: %s", self._what, error)
            self._problem = str(error)
        else:
            self._problem = ""
            if links is not None:  # they were interrupted for a moment
                self.log.warning("%s opened again: other certificates are in force", self._what)

    def _close_router(self) -> None:
        close, self._close = self._close, None
        if close is not None:
            close()


class AuthorityPoll:
    """Fetches a robot's roster and renews an identity of this computer in time; `close` ends it.

    While the authority's service does not answer, what is known remains in force. A request may
    take as long as it likes: nothing waits for it.
    """

    def __init__(self, robot: str, name: str) -> None:
        """Start, as the identity of this name, if the computer knows an authority's service."""
        self.log = _root_log()
        self._folder = RobotFolder.of(robot)
        self._name = name
        self._renew_after = 0.0
        self._problem = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cairn authority", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._closed.set()
        self._thread.join(_JOIN_LIMIT_S)

    def _run(self) -> None:
        while not self._closed.wait(_FETCH_S):
            problem = self._ask()
            if problem and problem != self._problem:
                self.log.error("certificates of %s: %s", self._name, problem)
            self._problem = problem

    def _ask(self) -> str:
        """Fetch the roster, and renew the certificate if that is due; return what is wrong."""
        from cairn.security.enrollment import (
            AuthorityUnreachable,
            fetch_roster,
            read_url,
            renew_own,
        )
        from cairn.security.identity import is_renewal_due, own_identity

        folder, name = self._folder, self._name
        try:
            if not folder.authority.exists():
                return ""
            url = read_url(folder, "enroll again")
            fetch_roster(folder, name, url)
            if time.monotonic() >= self._renew_after and is_renewal_due(
                own_identity(folder, name), time.time()
            ):
                self._renew_after = time.monotonic() + _RETRY_S
                renew_own(folder, name, url)
        except AuthorityUnreachable:
            return ""
        except CairnError as error:
            return str(error)
        return ""


Certified: TypeAlias = CertifiedRouter[Any] | AuthorityPoll
"""What keeps certificates current; `log` is replaced by that of the root when it has one."""


def opened_for_machines(
    open_router: Callable[[MachineLinks | None], zenoh.Session],
    secret: str,
    links: MachineLinks | None,
) -> Callable[[], None]:
    """Open the router of a machine; return what closes it.

    `secret` is that of the run: the router answers discovery queries, as every session does.
    """
    session = open_router(links)
    barrier = DiscoveryBarrier(session, secret)

    def close() -> None:
        barrier.close()
        close_session(session, _CLOSE_LIMIT_S)

    return close


def opened_for_operators(router: Path, folder: Path, gateway: Gateway | None) -> Callable[[], None]:
    """Open the gateway between the network and a router; return what closes it.

    Without one, as the identity of this computer is not in force, it opens nothing.
    """
    if gateway is None:
        return lambda: None
    session = gateway.open(router, folder)
    return lambda: close_session(session, _CLOSE_LIMIT_S)


def _root_log() -> logging.Logger | logging.LoggerAdapter[logging.Logger]:
    return logging.getLogger("cairn.root")


def _content(links: MachineLinks | Gateway) -> bytes:
    """Return the own certificate: a renewed one has the same path."""
    assert links.certificate is not None
    with explained(links.certificate):
        return read_bounded(Path(links.certificate), PEM_BYTES)
