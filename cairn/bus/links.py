"""Knows which processes there are, from the router, and waits for the direct links to them.

A process that has just opened its session is told by the router of the others and links to each
directly. Until that link stands, what they have declared is known to neither side.
"""

import json
import threading
import time
from typing import Any

import zenoh

from cairn.bus.arrival import Arrival

_JOIN_LIMIT_S = 1.0
"""After so long a router is taken for one without an admin space."""

_LOOK_AGAIN_S = 0.05
"""Between two looks at whether a process that is waited for is still there."""


class Links:
    """The links of one peer's or router's session; `close` ends the following."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._zid = str(session.info.zid())
        self._changed = threading.Condition()
        callback: Any = zenoh.handlers.Callback(self._note, indirect=False)
        self._listener = session.info.declare_transport_events_listener(callback, history=False)
        self._join()

    def others(self, timeout_s: float) -> set[str]:
        """The ids of those to which there is, or soon will be, a direct link.

        They are those linked already, and the peers of which a router's admin space tells.
        """
        found = self._standing()
        for router in self._session.info.routers_zid():
            for reply in self._session.get(_admin_key(router), timeout=timeout_s):
                if reply.ok is not None:
                    found |= _peers(reply.ok.payload.to_bytes())
        return found - {self._zid}

    def wait(self, zid: str, deadline: float) -> bool:
        """Whether a link to that one stands, at the latest at `deadline` (monotonic) [s].

        False at once if the router has lost it meanwhile.
        """
        while zid not in self._standing():
            left = deadline - time.monotonic()
            if left <= 0 or zid not in self.others(left):
                return False
            with self._changed:
                self._changed.wait_for(lambda: zid in self._standing(), min(left, _LOOK_AGAIN_S))
        return True

    def close(self) -> None:
        """Follow the links no more."""
        self._listener.undeclare()

    def _join(self) -> None:
        # At first a router's admin space is not known here, nor this process to the router; once
        # it has answered, both are, and all who ask it are told of this process.
        for router in self._session.info.routers_zid():
            with Arrival(self._session, _admin_key(router)) as arrival:
                arrival.wait(_JOIN_LIMIT_S)
        self.others(_JOIN_LIMIT_S)

    def _standing(self) -> set[str]:
        info = self._session.info
        return {str(zid) for zid in (*info.peers_zid(), *info.routers_zid())}

    def _note(self, _: Any) -> None:
        with self._changed:
            self._changed.notify_all()


def _admin_key(router: zenoh.ZenohId) -> str:
    return f"@/{router}/router"


def _peers(answer: bytes) -> set[str]:
    """From a router's own description: the peers linked to it."""
    try:
        sessions = json.loads(answer)["sessions"]
        return {str(one["peer"]) for one in sessions if one["whatami"] == "peer"}
    except (ValueError, KeyError, TypeError):
        return set()  # another version's; what is linked here has to do
