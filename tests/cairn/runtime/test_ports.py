"""Ports are declared by annotation, collected from the class, and bound on the instance."""

from typing import Annotated, Any, ClassVar

import pytest

from cairn import LATCHED, RELIABLE, SENSOR, CairnError, In, Out
from cairn.runtime.ports import BoundIn, BoundOut, PortSpec, ports_of
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
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
    assert list(ports_of(Localizer).values()) == [
        PortSpec("scan", "out", LaserScan, SENSOR),
        PortSpec("odom", "in", Odometry, RELIABLE),
        PortSpec("command", "in", Twist, LATCHED, optional=True),
        PortSpec("pose", "out", Odometry, RELIABLE),
    ]


def test_subclass_can_override_the_default_of_a_port() -> None:
    assert ports_of(Tolerant)["odom"] == PortSpec("odom", "in", Odometry, RELIABLE, optional=True)


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


def test_bound_output_rejects_messages_of_another_type() -> None:
    sent: list[Time] = []
    spec = PortSpec("since", "out", Time, RELIABLE)
    out: Out[Time] = BoundOut("base", spec, "go", sent.append, lambda: True)
    message = Time(sec=1, nanosec=2)

    out.publish(message)

    assert out.topic == "go"
    assert sent == [message]
    with pytest.raises(
        CairnError, match="base: port since publishes builtin_interfaces/msg/Time, not rosg"
    ):
        out.publish(Clock(clock=message))  # type: ignore[arg-type]
    with pytest.raises(CairnError, match=r"not builtins\.str"):
        out.publish("stop")  # type: ignore[arg-type]
    assert sent == [message]


def test_bound_input_keeps_the_latest_message() -> None:
    bound = BoundIn[Time](PortSpec("since", "in", Time, RELIABLE), "go")
    message = Time(sec=1, nanosec=2)

    before = bound.latest
    bound.set_latest(message)

    assert before is None
    assert bound.topic == "go"
    assert bound.latest is message


def test_declaration_cannot_be_used_as_a_port() -> None:
    with pytest.raises(CairnError, match="this Out port is a declaration"):
        Timer.since.publish(Time(sec=1, nanosec=2))
    with pytest.raises(CairnError, match="this In port is a declaration"):
        _ = Localizer.command.latest
