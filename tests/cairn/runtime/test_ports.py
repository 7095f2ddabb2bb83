"""Ports are declared by annotation, collected from the class, and bound on the instance."""

from typing import Annotated, Any, ClassVar

import pytest

from cairn import LATCHED, RELIABLE, SECOND, SENSOR, CairnError, Component, In, Out, every
from cairn.runtime.ports import ports_of
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing.lockstep import ComponentHarness
from tests.wording import assert_words


class Driver:
    limit: ClassVar[int] = 3
    scan: Out[LaserScan] = Out(qos=SENSOR)


class Localizer(Driver):
    odom: In[Odometry]
    command: In[Twist] = In(qos=LATCHED, optional=True)
    pose: Annotated[Out[Odometry], "for the planner"]
    note: str = ""


class Timer:
    since: Out[Time] = Out()


class Tolerant(Localizer):
    odom = In(optional=True)


def test_ports_are_collected_from_class_and_bases_in_order() -> None:
    ports = ports_of(Localizer)

    assert [(name, type(one), one.interface, one.qos) for name, one in ports.items()] == [
        ("scan", Out, LaserScan, SENSOR),
        ("odom", In, Odometry, RELIABLE),
        ("command", In, Twist, LATCHED),
        ("pose", Out, Odometry, RELIABLE),
    ]
    assert [one.name for one in ports.values()] == list(ports)
    assert [name for name, one in ports.items() if isinstance(one, In) and one.optional] == [
        "command"
    ]


def test_subclass_can_override_the_default_of_a_port() -> None:
    odom = ports_of(Tolerant)["odom"]
    assert isinstance(odom, In)
    assert (odom.interface, odom.optional) == (Odometry, True)
    assert ports_of(Localizer)["odom"] is not odom


def test_class_without_ports_has_none() -> None:
    assert ports_of(type("Plain", (), {})) == {}


def declared(annotation: Any, **body: Any) -> type:
    return type("Odd", (), {"__annotations__": {"port": annotation}, **body})


@pytest.mark.parametrize(
    ("cls", "words"),
    [
        (declared(In), "Odd.port; message type; `port: In"),
        (declared(int, port=Out()), "Odd.port; message type; annotate"),
        (type("Odd", (), {"port": Out()}), "Odd.port; message type; annotate"),
        (declared("In[LaserScn]"), "annotations"),
        (declared(In[int]), "Odd.port; builtins.int; message; class"),
        (declared(In[Twist], port=Out()), "annotated In; Out; give In"),
        (declared(Out[Twist], port=5), "annotated Out; int; give Out"),
        (
            type("Odd", (declared(int, count=1),), {"__annotations__": {"count": In[Twist]}}),
            "Odd.count; count; another name",
        ),
    ],
)
def test_invalid_declaration_is_reported_by_name(cls: type, words: str) -> None:
    with pytest.raises(CairnError) as caught:
        ports_of(cls)

    assert_words(str(caught.value), *words.split("; "))


class Echo(Component):
    """Publishes what it reads."""

    since: In[Time]
    until: Out[Time]

    @every(hz=1)
    def publish(self) -> None:
        if self.since.latest is not None:
            self.until.publish(self.since.latest)


def test_bound_output_rejects_messages_of_another_type() -> None:
    harness = ComponentHarness(Echo, name="echo", topics={"until": "go"})
    out, message = harness.component.until, Time(sec=1, nanosec=2)

    out.publish(message)

    assert out.topic == "/robot/go"
    with pytest.raises(
        CairnError, match="echo: port until publishes builtin_interfaces/msg/Time, not rosg"
    ):
        out.publish(Clock(clock=message))  # type: ignore[arg-type]
    with pytest.raises(CairnError, match=r"not builtins\.str"):
        out.publish("stop")  # type: ignore[arg-type]
    harness.run_to(SECOND // 2)
    assert harness.take("until") == [message]


def test_bound_input_keeps_the_latest_message_of_its_own_component() -> None:
    first, second = ComponentHarness(Echo), ComponentHarness(Echo)
    assert first.component.since.latest is None

    first.publish("since", Time(sec=1, nanosec=2))
    first.run_to(SECOND // 2)

    assert first.component.since.topic == "/robot/since"
    assert first.component.since.latest == Time(sec=1, nanosec=2)
    assert second.component.since.latest is None


def test_declaration_cannot_be_used_as_a_port() -> None:
    with pytest.raises(CairnError, match="this Out port is a declaration"):
        Timer.since.publish(Time(sec=1, nanosec=2))
    with pytest.raises(CairnError, match="this In port is a declaration"):
        _ = Localizer.command.latest
    with pytest.raises(CairnError, match="this Out port is a declaration"):
        _ = Timer.since.has_subscribers
    with pytest.raises(CairnError, match="this In port is a declaration"):
        _ = ports_of(Localizer)["odom"].topic
