"""Asks which liveliness tokens there are."""

import time

import zenoh

_TRIES = 4


def alive(session: zenoh.Session, keys: str, timeout_s: float) -> list[str]:
    """The keys of the tokens alive that match the key expression `keys`, sorted."""
    # Of several hundred such questions of a peer, zenoh 1.10 answers one with nothing, at once,
    # whatever there is; with some of it only, none.
    deadline = time.monotonic() + timeout_s
    for _ in range(_TRIES):
        left = max(0.01, deadline - time.monotonic())
        replies = session.liveliness().get(keys, timeout=left)
        found = sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
        if found or time.monotonic() > deadline:
            return found
    return []
