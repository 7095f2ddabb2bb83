"""What a console may do whose user on the network has a role."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import pytest

from cairn.client import ControlError, NoReplyError, Robot
from cairn.console.operations import may_operate
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.std_msgs import Header

GATE = ComponentStatus(header=Header(), component="velocity_gate", plugin="velocity_gate")


@pytest.mark.parametrize(
    ("answered", "allowed"),
    [({"status", "renew_lease"}, True), ({"status"}, False), (set[str](), True)],
)
def test_console_steers_unless_requests_that_steer_alone_are_not_answered(
    answered: set[str], allowed: bool
) -> None:
    def request(name: str, verb: str, _: Mapping[str, Any] = {}, *, timeout_s: float) -> Any:
        if verb not in answered:
            raise NoReplyError(f"{name}: no reply to {verb}")
        if verb == "renew_lease":
            raise ControlError("this operator's lease is not valid")

    statuses = {"/robot/velocity_gate": GATE, "/other/velocity_gate": GATE}
    connection = SimpleNamespace(statuses=lambda: statuses, request=request)
    client = cast("Robot", SimpleNamespace(connection=connection))

    assert may_operate(client, "robot") is allowed
