"""Asks which liveliness tokens there are."""

import threading
import time

import zenoh

_TRIES = 8
_PAUSE_S = 0.001


def alive(session: zenoh.Session, keys: str, timeout_s: float) -> list[str]:
    """The keys of the tokens alive that match the key expression `keys`, sorted."""
    # In a peer, zenoh 1.10 may end the answer before all of it has come, on a busy computer often
    # with nothing: what was once told counts, and an answer counts when another one agrees.
    deadline = time.monotonic() + timeout_s
    pause = threading.Event()
    found: set[str] = set()
    for tried in range(_TRIES):
        replies = session.liveliness().get(keys, timeout=max(0.01, deadline - time.monotonic()))
        told = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        if (found and told == found) or time.monotonic() > deadline:
            break
        found |= told
        pause.wait(_PAUSE_S * tried)
    return sorted(found)
