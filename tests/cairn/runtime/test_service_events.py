"""Introspection of services: what a component publishes of its calls, as ROS 2 has it."""

from collections.abc import Iterator

import pytest

from cairn import RELIABLE, Component, ParameterRejected
from cairn.bus.keys import EndpointEntity
from cairn.bus.type_hash import type_hash
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.service_msgs.msg import ServiceEventInfo
from cairn.schemas.std_msgs import String
from cairn.testing.lockstep import ComponentHarness
from tests.cairn.bus.network import Network, Reader, eventually, node
from tests.cairn.runtime.test_services_and_actions import Adder, Asker, Counter, Starter
from tests.cairn.runtime.threaded import ThreadedComponent

SENT, RECEIVED = ServiceEventInfo.REQUEST_SENT, ServiceEventInfo.REQUEST_RECEIVED
ANSWERED, GOT = ServiceEventInfo.RESPONSE_SENT, ServiceEventInfo.RESPONSE_RECEIVED
EVENTS = "add/_service_event"


def test_server_and_client_publish_the_four_events_of_a_call() -> None:
    adder = ComponentHarness(Adder, name="adder")
    asker = ComponentHarness(Asker, name="asker", beside=adder)
    events = adder.read(EVENTS, AddTwoInts.Event)

    def ask(a: int) -> list[AddTwoInts.Event]:
        before = len(events.messages)
        asker.publish("word", String(data=f"{a} 2"))
        adder.run_for(0.1)
        return sorted(events.messages[before:], key=lambda event: event.info.event_type)

    assert ask(1) == []
    for harness in (adder, asker):
        harness.request("set_parameters", service_introspection="contents")
    found = ask(1)
    assert [event.info.event_type for event in found] == [SENT, RECEIVED, ANSWERED, GOT]
    request, response = AddTwoInts.Request(a=1, b=2), AddTwoInts.Response(sum=3)
    assert [(event.request, event.response) for event in found] == [
        ((request,), ()), ((request,), ()), ((), (response,)), ((), (response,)),
    ]  # fmt: skip
    assert {(event.info.client_gid.tobytes(), event.info.sequence_number) for event in found} == {
        (found[0].info.client_gid.tobytes(), 2)
    }

    asker.request("set_parameters", service_introspection="off")
    adder.request("set_parameters", service_introspection="metadata")
    found = ask(1)
    assert [event.info.event_type for event in found] == [RECEIVED, ANSWERED]
    assert {len(event.request) + len(event.response) for event in found} == {0}
    assert [event.info.event_type for event in ask(-1)] == [RECEIVED], "ROS 2 has no error replies"

    with pytest.raises(ParameterRejected, match="should be one of off, metadata, contents"):
        adder.request("set_parameters", service_introspection="all")


def test_services_of_an_action_have_events() -> None:
    counter = ComponentHarness(Counter, name="counter")
    starter = ComponentHarness(Starter, name="starter", beside=counter)
    action = "fibonacci/_action"
    goals = counter.read(f"{action}/send_goal/_service_event", Fibonacci.SendGoal.Event)
    results = counter.read(f"{action}/get_result/_service_event", Fibonacci.GetResult.Event)
    counter.request("set_parameters", service_introspection="contents")

    starter.publish("word", String(data="2"))
    counter.run_for(1.0)

    assert [event.info.event_type for event in goals.messages] == [RECEIVED, ANSWERED]
    assert results.messages[1].response[0].result.sequence.tolist() == [0, 1, 1]


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    try:
        yield network
    finally:
        network.close()


@pytest.mark.processes
def test_events_on_the_wire_are_those_that_ros2_service_echo_subscribes_to(
    network: Network,
) -> None:
    components: list[ThreadedComponent] = []

    def started(component: type[Component], name: str) -> ThreadedComponent:
        components.append(ThreadedComponent(component, network.bus(), name=name))
        components[-1].activate()
        components[-1].set_parameters({"service_introspection": "contents"})
        return components[-1]

    try:
        adder = started(Adder, "adder")
        asker = started(Asker, "asker")
        tool = node(network.bus(), "/tool")
        events = Reader(tool, f"/robot/{EVENTS}", AddTwoInts.Event, RELIABLE)
        word = tool.advertise("/robot/word", String, RELIABLE)
        add = asker.runtime.component.add  # type: ignore[attr-defined]
        ends = (asker.runtime._ports._clients[0].events, adder.runtime._ports._servers[0].events)
        assert eventually(
            lambda: (
                word.has_subscribers and add.is_available and all(one.are_received for one in ends)
            )
        )
        word.publish(String(data="1 2"))

        found = sorted(events.next_of(4), key=lambda event: event.info.event_type)
        assert [event.info.event_type for event in found] == [SENT, RECEIVED, ANSWERED, GOT]
        assert len({event.info.client_gid.tobytes() for event in found}) == 1
        published = {
            (one.type_name, one.type_hash)
            for one in network.graph()
            if isinstance(one, EndpointEntity)
            and one.kind == "MP"
            and one.topic == f"/robot/{EVENTS}"
        }
        # The hash by the official generator: tests/data/ros2/type_hashes.json.
        assert published == {
            (
                "example_interfaces/srv/AddTwoInts_Event",
                "RIHS01_32c1d140259c71e5c355115942bcb31df98b4330e4d906b1b75ccb1c9b3ce6c8",
            )
        }
        assert type_hash(AddTwoInts.Event) == published.pop()[1]
    finally:
        for component in components:
            component.close()
