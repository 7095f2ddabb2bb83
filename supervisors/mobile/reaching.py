"""Finds the mobile supervisor on the bus, and waits for one that hangs until it is started anew."""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping

from cairn import CairnError
from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.session import is_connected
from cairn.cli.connection import STATUS_TOPIC, Connection, resolve
from cairn.cli.tables import note
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage

_PLUGIN, _AUTOMOVE = "mobile_supervisor", "automove"
_ACTIVE = "active"
# The supervisor above kills one that hangs after `hang_timeout_s` and 3 s more, and starts it anew.
PATIENCE_S = 30.0


def reach(connection: Connection, robot: str) -> str:
    """The full name of the mobile supervisor, once it takes orders.

    Raises `CairnError` if there is none, or if it does not answer within the limit.
    """
    statuses = connection.statuses()
    heard = {name for name, status in statuses.items() if status.plugin == _PLUGIN}
    found = sorted(heard | _expected(statuses) - statuses.keys())
    if not found:
        raise CairnError(
            f"no {_PLUGIN} runs here that takes orders to move; start one, as with "
            "`cairn up deploy/sim.yaml`"
        )
    name = resolve(found, found[0].rpartition("/")[2], robot)
    if name not in heard or statuses[name].state != _ACTIVE:
        await_active(connection, name)
    return name


def await_active(connection: Connection, name: str) -> None:
    """Wait for a component that does not answer; raises `CairnError` if it stays silent."""
    _, robot, component = name.split("/")
    note(
        f"{component} does not answer; if it hangs it is killed and started anew: "
        f"waiting up to {PATIENCE_S:g} s"
    )
    codec = Codec()
    key = keys.message_key(connection.domain, f"/{robot}/{STATUS_TOPIC}", ComponentStatus, codec)
    deadline = time.monotonic() + PATIENCE_S
    with connection.listen(key) as samples:
        while (left_s := deadline - time.monotonic()) > 0 and linked(connection):
            try:
                sample = samples.get(timeout=min(left_s, 1.0))
                status = codec.decode(ComponentStatus, sample.payload.to_bytes())
            except (queue.Empty, InvalidMessage):
                continue
            if status.component == component and status.state == _ACTIVE:
                return
    if not linked(connection):
        raise CairnError(f"{component} does not answer: the deployment has ended")
    raise CairnError(
        f"{component} has not answered for {PATIENCE_S:g} s, and the robot may drive on: press "
        "Ctrl-C twice where `cairn up` runs, which ends all at once (`cairn restart`, or Ctrl-C "
        "once, would wait for it)"
    )


def linked(connection: Connection) -> bool:
    """Whether the deployment is still there."""
    return not connection.session.is_closed() and is_connected(connection.session)


def _expected(statuses: Mapping[str, ComponentStatus]) -> set[str]:
    """Mobile supervisors that others tell of: the bus soon forgets one that hangs."""
    found = set()
    for name, status in statuses.items():
        robot = name.rpartition("/")[0]
        if _PLUGIN in status.children:
            found.add(f"{robot}/{_PLUGIN}")
        if status.plugin == _AUTOMOVE and status.parent:
            found.add(f"{robot}/{status.parent}")
    return found
