"""The caches of latched publishers: what they keep for subscribers that come later."""

from collections.abc import Callable
from typing import Any

import zenoh

from cairn.bus import keys


def query_caches(
    session: zenoh.Session,
    key: str,
    on_reply: Callable[[zenoh.Reply], object],
    on_end: Callable[[], object],
    timeout_s: float,
) -> None:
    """Have the latched publishers of a data key send what they keep, without waiting.

    Zenoh's threads call `on_reply` with each sample, and `on_end` when all publishers have replied,
    or after the timeout [s]. Raises `zenoh.ZError` if the session is closed.
    """
    handler: Any = zenoh.handlers.Callback(on_reply, on_end, indirect=False)
    session.get(
        keys.cached_samples_key(key),
        handler,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        accept_replies=zenoh.ReplyKeyExpr.ANY,  # they carry the publisher's key
        timeout=timeout_s,
    )
