"""The router of one machine of a robot, which is opened again when certificates change.

Zenoh reads certificates and access control when a session opens. The components here do not notice
a new router: their links to each other outlive the old one, and they connect to the new one.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import zenoh

from cairn.bounded_files import read_bounded
from cairn.bus.discovery import DiscoveryBarrier
from cairn.bus.session import MachineLinks, close_session
from cairn.deployment.machine_access import admitted
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.files import explain_os_error
from cairn.placement.machine_identity import machine_identity
from cairn.security.folder import PEM_BYTES, RobotFolder

_log = logging.getLogger("cairn.root")

_PERIOD_S: Final = 2.0
"""So often the roster is fetched: a revocation works within 5 s."""
_RETRY_S: Final = 60.0  # of a renewal that has failed
_JOIN_LIMIT_S: Final = 1.0  # a request to the authority may take longer; its thread is a daemon
_CLOSE_LIMIT_S: Final = 2.0


def machine_links(deployment: Deployment, machine: str, access: Mapping[str, Any]) -> MachineLinks:
    """Return the links of a machine's router, with the certificates in force now.

    `access` is its `machine_access`. Raises `CairnError` if this machine's own identity is not in
    force.
    """
    identity = machine_identity(deployment.robot, machine)
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


class MachineRouter:
    """Keeps a machine's router open with the certificates in force; `close` closes it."""

    def __init__(
        self,
        deployment: Deployment,
        machine: str,
        access: Mapping[str, Any],
        open_router: Callable[[MachineLinks | None], zenoh.Session],
        secret: str,
    ) -> None:
        """Open the router by `open_router`, which gets None when it may have no links.

        `secret` is that of the run: the router answers discovery queries, as every session does.

        Raises `CairnError` if this machine's identity is not in force, or as `open_router`.
        """
        self._folder = RobotFolder.of(deployment.robot)
        self._machine = machine
        self._make_links = partial(machine_links, deployment, machine, access)
        self._open_router = open_router
        self._links: MachineLinks | None = self._make_links()
        self._certificate = _content(self._links)
        self._secret = secret
        self._session: zenoh.Session | None = open_router(self._links)
        self._barrier = DiscoveryBarrier(self._session, secret)
        self._renew_after = 0.0
        self._problem = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cairn certificates", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the router."""
        self._closed.set()
        self._thread.join(_JOIN_LIMIT_S)
        self._close_session()

    def _run(self) -> None:
        while not self._closed.wait(_PERIOD_S):
            self._note_problem(self._ask_authority())
            self._update()

    def _ask_authority(self) -> str:
        """Fetch the newest roster, and renew the certificate in time, if an authority is known.

        Returns what is wrong, "" if nothing is.
        """
        from cairn.security.enrollment import (
            AuthorityUnreachable,
            fetch_roster,
            read_url,
            renew_own,
        )
        from cairn.security.identity import is_renewal_due, own_identity

        folder, machine = self._folder, self._machine
        try:
            if not folder.authority.exists():
                return ""
            url = read_url(folder, "enroll again")
            fetch_roster(folder, machine, url)
            if time.monotonic() >= self._renew_after and is_renewal_due(
                own_identity(folder, machine), time.time()
            ):
                self._renew_after = time.monotonic() + _RETRY_S
                renew_own(folder, machine, url)
                _log.info("certificate renewed: machine %s", machine)
        except AuthorityUnreachable:
            return ""  # what is known remains in force
        except CairnError as error:
            return str(error)
        return ""

    def _note_problem(self, problem: str) -> None:
        """Log what is wrong with the authority, once."""
        if problem and problem != self._problem:
            _log.error("certificates of machine %s: %s", self._machine, problem)
        self._problem = problem

    def _update(self) -> None:
        """Open the router again if other certificates are in force now."""
        links: MachineLinks | None = None
        try:
            links = self._make_links()
            certificate = _content(links)
        except CairnError as error:
            certificate, reason = b"", str(error)
        if (links, certificate) == (self._links, self._certificate) and self._session is not None:
            return
        if links is None and self._links is not None:
            _log.critical("links to other machines closed: %s", reason)
        self._links, self._certificate = links, certificate
        self._close_session()
        if self._closed.is_set():
            return
        try:
            self._session = self._open_router(links)
            self._barrier = DiscoveryBarrier(self._session, self._secret)
        except CairnError as error:  # the next turn tries it again
            self._note_problem(f"the router cannot be opened again: {error}")
        else:
            _log.info("router opened again: other certificates are in force")

    def _close_session(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            self._barrier.close()
            close_session(session, _CLOSE_LIMIT_S)


def _content(links: MachineLinks) -> bytes:
    """Return a machine's own certificate: a renewed one has the same path."""
    try:
        return read_bounded(Path(links.certificate), PEM_BYTES)
    except OSError as error:
        raise CairnError(f"{links.certificate}: {explain_os_error(error)}") from error
