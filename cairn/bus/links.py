"""Knows which processes there are, from the router, and waits for the direct links to them.

A process that has just opened its session is told by the router of the others and links to each
directly. Until that link stands, what they have declared is known to neither side.
"""

import json
import threading
import time
from typing import Any

import zenoh

_LOOK_AGAIN_S = 0.05
"""Between two looks at whether a process that is waited for is still there."""


class Links:
    """The links of one session; `close` ends the following."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._zid = str(session.info.zid())
        self._changed = threading.Condition()
        callback: Any = zenoh.handlers.Callback(self._note, indirect=False)
        self._listener = session.info.declare_transport_events_listener(callback, history=False)

    def others(self, timeout_s: float) -> dict[str, bool]:
        """The ids of the other processes; whether there is, or will be, a direct link to each.

        Those linked here, routers among them, and those that a router (its admin space) has links
        to.
        """
        found = {str(zid): True for zid in self._session.info.peers_zid()}
        routers = {str(zid): False for zid in self._session.info.routers_zid()}
        for router in routers:
            for reply in self._session.get(f"@/{router}/router", timeout=timeout_s):
                if reply.ok is not None:
                    found |= _sessions(reply.ok.payload.to_bytes())
        own_is_peer = found.pop(self._zid, True)
        return routers | {zid: peer and own_is_peer for zid, peer in found.items()}

    def wait(self, zid: str, deadline: float) -> bool:
        """Whether a link to that process stands, at the latest at `deadline` (monotonic) [s].

        False at once if the router has lost it meanwhile.
        """
        while not self._stands(zid):
            left = deadline - time.monotonic()
            if left <= 0 or zid not in self.others(left):
                return False
            with self._changed:
                self._changed.wait_for(lambda: self._stands(zid), min(left, _LOOK_AGAIN_S))
        return True

    def close(self) -> None:
        """Follow the links no more."""
        self._listener.undeclare()

    def _stands(self, zid: str) -> bool:
        return any(str(peer) == zid for peer in self._session.info.peers_zid())

    def _note(self, _: Any) -> None:
        with self._changed:
            self._changed.notify_all()


def _sessions(answer: bytes) -> dict[str, bool]:
    """From a router's own description: the processes linked to it, and whether each is a peer."""
    try:
        sessions = json.loads(answer)["sessions"]
        kinds = {str(one["peer"]): str(one["whatami"]) for one in sessions}
    except (ValueError, KeyError, TypeError):
        return {}  # another version's; what is linked here has to do
    return {zid: kind == "peer" for zid, kind in kinds.items() if kind in ("peer", "client")}
