"""Nodes that do not fit together are reported: QoS by the rules of ROS 2, and equal names."""

import itertools
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from cairn import LATCHED, RELIABLE, SENSOR, Qos
from cairn.bus.conflicts import qos_mismatch
from cairn.bus.keys import EndpointEntity, EndpointKind, NodeEntity, token_key
from cairn.bus.session import open_client, open_peer
from cairn.bus.type_hash import type_hash
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.message import type_name
from tests.cairn.bus.network import Network, Reader, eventually, fail_test
from tests.patience import LIMIT_S

TOPIC = "/robot/cmd_vel"
LATCHED_SENSOR = Qos("best_effort", "transient_local", 5)
PROFILES = (RELIABLE, SENSOR, LATCHED, LATCHED_SENSOR)


@pytest.mark.parametrize(("offered", "requested"), list(itertools.product(PROFILES, PROFILES)))
def test_publisher_has_to_offer_what_a_subscriber_requests(offered: Qos, requested: Qos) -> None:
    """As in the table "QoS compatibilities" of ROS 2's documentation."""
    asked_too_much = {
        "reliability": (offered.reliability, requested.reliability) == ("best_effort", "reliable"),
        "durability": (offered.durability, requested.durability) == ("volatile", "transient_local"),
    }
    policies = " and ".join(policy for policy, too_much in asked_too_much.items() if too_much)

    message = qos_mismatch("/scan", "/ros/laser", offered, "/robot/localizer", requested)

    assert message.endswith(f"; give both the same {policies}") if policies else message == ""
    if policies:
        assert f"/ros/laser offers {offered}, /robot/localizer requests {requested}" in message


class Strangers:
    """Declares the tokens of nodes that are not of Cairn."""

    def __init__(self, network: Network) -> None:
        self._stack = ExitStack()
        self._session = self._stack.enter_context(open_client([network.endpoint]))

    def announce(self, entity: NodeEntity | EndpointEntity) -> None:
        """Declare a token."""
        token = self._session.liveliness().declare_token(token_key(entity))
        self._stack.callback(token.undeclare)

    def close(self) -> None:
        """Withdraw all."""
        self._stack.close()


@pytest.fixture
def strangers(network: Network) -> Iterator[Strangers]:
    strangers = Strangers(network)
    yield strangers
    strangers.close()


def endpoint(number: int, kind: EndpointKind, qos: Qos) -> EndpointEntity:
    node = NodeEntity(0, "5e55", 0, "/ros/node")
    return EndpointEntity(node, number, kind, TOPIC, type_name(Twist), type_hash(Twist), qos)


@pytest.mark.processes
def test_mismatch_with_a_foreign_node_is_a_warning_of_the_component(
    network: Network, strangers: Strangers
) -> None:
    warned: dict[str, list[str]] = {"base": [], "driver": []}
    nodes = {
        name: network.bus().node(f"/robot/{name}", fail_test, found.append)
        for name, found in warned.items()
    }
    reader = Reader(nodes["base"], TOPIC, Twist, RELIABLE)
    nodes["driver"].advertise(TOPIC, Twist, RELIABLE)
    theirs: list[tuple[EndpointKind, Qos]] = [
        ("MP", LATCHED), ("MS", SENSOR), ("MP", SENSOR), ("MS", LATCHED),
    ]  # fmt: skip
    for number, (kind, qos) in enumerate(theirs, start=1):
        strangers.announce(endpoint(number, kind, qos))

    offered = qos_mismatch(TOPIC, "/ros/node", SENSOR, "/robot/base", RELIABLE)
    requested = qos_mismatch(TOPIC, "/robot/driver", RELIABLE, "/ros/node", LATCHED)
    assert eventually(lambda: all(warned.values()))
    assert warned == {"base": [offered], "driver": [requested]}
    assert reader.pending() == []


@pytest.mark.processes
def test_mismatch_of_two_components_is_reported_once_and_messages_arrive(network: Network) -> None:
    talking, listening = network.bus(), network.bus()
    warned: list[str] = []
    writer = talking.node("/robot/driver", fail_test).advertise(TOPIC, Twist, SENSOR)
    reader = Reader(listening.node("/robot/base", fail_test, warned.append), TOPIC, Twist, RELIABLE)

    talking.wait_for_peers(LIMIT_S)
    writer.publish(Twist())

    assert reader.next() == Twist()
    expected = [qos_mismatch(TOPIC, "/robot/driver", SENSOR, "/robot/base", RELIABLE)]
    assert eventually(lambda: warned == expected)


@pytest.mark.processes
def test_nodes_of_one_name_are_reported_and_receive_their_messages(
    network: Network, strangers: Strangers
) -> None:
    warned: list[str] = []
    own = network.bus()
    base = own.node("/robot/base", fail_test, warned.append)
    reader = Reader(base, TOPIC, Twist, RELIABLE)
    # Of this run: its process before a restart.
    network.bus().node("/robot/base", fail_test, lambda _: None)
    other_run = ZenohBus(open_peer([network.endpoint], secret="other"), secret="other")
    try:
        namesake = other_run.node("/robot/base", fail_test, lambda _: None)
        writer = namesake.advertise(TOPIC, Twist, RELIABLE)
        strangers.announce(NodeEntity(0, "5e55", 0, "/robot/base"))
        strangers.announce(NodeEntity(0, "5e55", 1, "/ros/base"))
        # Of another run: `wait_for_peers` waits only shortly for it.
        assert eventually(lambda: writer.has_subscribers)
        writer.publish(Twist())

        assert reader.next() == Twist()
        assert eventually(lambda: len(warned) == 2)
        other, foreign = sorted(warned, key=lambda one: "foreign" in one)
        assert "another node has the name /robot/base, in process" in other
        assert "is of another deployment" in other
        assert "in the foreign session 5e55, which is not of Cairn" in foreign
    finally:
        other_run.close()
