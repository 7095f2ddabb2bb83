"""Damaged messages of every type of ROS 2: what decodes them rejects them or has valid ones."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest

from cairn.deployment.plugins import installed_plugins, load_plugin
from cairn.runtime.ports import actions_of, ports_of, services_of
from cairn.schemas.interfaces import interface
from cairn.schemas.message import type_name
from cairn.system.kernel_compilation import deferred_compilation
from tests.attack.conftest import Cases
from tests.attack.inputs import CODEC
from tests.schemas.damage import decode_damaged
from tests.schemas.random_messages import RandomMessages, message_names

OF_RECEIVED: Final = 10_000
"""Damaged messages of each type that components of Cairn receive."""

OF_OTHERS: Final = 500
_ORIGINALS: Final = 8


@pytest.fixture(scope="module")
def received_types() -> frozenset[str]:
    """Return the types that the components of Cairn receive."""
    with deferred_compilation():
        plugins = [one for one in installed_plugins() if one.target.startswith("cairn.")]
        return frozenset(
            type_name(message)
            for plugin in plugins
            for message in _received_by(load_plugin(plugin.name))
        )


def _received_by(component: type) -> Iterator[type[Any]]:
    services = list(services_of(component).values())
    ports = list(ports_of(component).values())
    for action in actions_of(component).values():
        services += action.services().values()
        ports += action.topics().values()
    yield from (port.interface for port in ports if port.direction == "in")
    for service in services:
        yield service.interface.Request if service.role == "server" else service.interface.Response


GROUPS: Final = [message_names()[first : first + 6] for first in range(0, len(message_names()), 6)]
"""Types that are attacked by one test: each of their messages is judged by itself."""


@pytest.mark.parametrize("names", GROUPS, ids=lambda names: names[0])
def test_damaged_messages_of_all_types(
    names: tuple[str, ...],
    received_types: frozenset[str],
    cases: Cases,
    record_property: Callable[[str, object], None],
) -> None:
    cases(names)
    slowest_s = 0.0
    for name in names:
        random = RandomMessages(zlib.crc32(name.encode()))
        originals = [CODEC.encode(random.make(interface(name))) for _ in range(_ORIGINALS)]
        count = OF_RECEIVED if name in received_types else OF_OTHERS
        slowest_s = max(
            slowest_s, decode_damaged(CODEC, interface(name), originals, count).slowest_s
        )
    record_property("seconds", slowest_s)


def test_components_receive_types_of_ros_2(received_types: frozenset[str]) -> None:
    assert {"geometry_msgs/msg/Twist", "sensor_msgs/msg/LaserScan"} <= received_types
