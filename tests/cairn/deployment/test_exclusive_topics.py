"""Who may publish on an exclusive topic follows from the deployment, and so do the keys."""

import logging
from collections.abc import Mapping
from typing import Any

import pytest

from cairn import CairnError, Component, In, Out, on
from cairn.bus.exclusive import ExclusiveTopic
from cairn.deployment.exclusive_topics import exclusive_topics
from cairn.deployment.model import Deployment
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.schemas.geometry_msgs import Vector3
from cairn.testing.lockstep import DeploymentHarness


class Gate(Component):
    command: In[Vector3] = In(optional=True)
    cmd_vel: Out[Vector3]

    @on("command")
    def forward(self, command: Vector3) -> None:
        self.cmd_vel.publish(command)


class Base(Component):
    cmd_vel: In[Vector3] = In(exclusive=True, optional=True)

    def on_configure(self) -> None:
        self.received: list[float] = []

    @on("cmd_vel")
    def drive(self, command: Vector3) -> None:
        self.received.append(command.x)


class View(Component):
    cmd_vel: In[Vector3] = In(optional=True)


def component(cls: type[Component], **more: Any) -> dict[str, Any]:
    return {"plugin": f"{__name__}:{cls.__name__}", **more}


def deployment(components: Mapping[str, Any], external: tuple[str, ...] = ()) -> Deployment:
    page = {"cairn": 1, "robot": "rover", "external_topics": external, "components": components}
    return Deployment.model_validate(page)


SUPERVISOR = "cairn.processes.supervisor:Supervisor"
TREE = {
    "mobile": {
        "plugin": SUPERVISOR,
        "children": {"base": component(Base), "view": component(View)},
    },
    "safety": {"plugin": SUPERVISOR, "children": {"gate": component(Gate)}},
    "other": {"plugin": SUPERVISOR, "children": {"view_2": component(View)}},
}


def test_the_one_component_with_that_output_is_entitled() -> None:
    assert exclusive_topics(deployment(TREE)) == (
        ExclusiveTopic(topic="/rover/cmd_vel", writer="gate", readers=("base",)),
    )


def test_nobody_is_entitled_without_a_writer_unless_the_topic_is_external() -> None:
    base = {"base": component(Base)}
    (closed,) = exclusive_topics(deployment(base))
    (external,) = exclusive_topics(deployment(base, ("cmd_vel",)))
    (both,) = exclusive_topics(deployment({**base, "gate": component(Gate)}, ("cmd_vel",)))

    assert (closed.writer, closed.external) == ("", False)
    assert (external.writer, external.external) == ("", True)
    assert (both.writer, both.external) == ("gate", False)


def test_two_writers_are_an_error_that_names_them() -> None:
    two = {"base": component(Base), "gate": component(Gate), "gate_2": component(Gate)}

    with pytest.raises(CairnError, match="cmd_vel has several writers, gate and gate_2, but base"):
        exclusive_topics(deployment(two))


def test_each_component_gets_only_the_keys_of_its_own_exclusive_ports() -> None:
    robot = deployment(TREE)
    context = RunContext(robot="rover", exclusive_topics=exclusive_topics(robot))
    keys = {"/rover/cmd_vel": "5ec7e7"}
    root = LaunchRequest(name="root", spec=robot.root(), context=context, topic_keys=keys)

    assert {name: root.keys_for(name) for name in TREE} == {
        "mobile": keys, "safety": keys, "other": {},
    }  # fmt: skip
    mobile = LaunchRequest(
        name="mobile", spec=robot.components["mobile"], context=context, topic_keys=keys
    )
    assert mobile.keys_for("base") == keys
    assert mobile.keys_for("view") == {}
    assert "5ec7e7" not in f"{root} {root!r}"


def test_lockstep_accepts_the_entitled_writer_only_and_counts_the_others(
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = deployment({"gate": component(Gate), "base": component(Base)}, ("command",))
    with DeploymentHarness(robot) as harness:
        harness.publish("cmd_vel", Vector3(x=9.0), Vector3(x=9.0))
        harness.publish("command", Vector3(x=1.0))

        base = harness.run.runtime("base")
        (port,) = base.status().ports
        assert base.component.received == [1.0]  # type: ignore[attr-defined]
        assert (port.messages, port.refused, port.invalid, port.dropped) == (1, 2, 0, 0)
    assert "refused message on /rover/cmd_vel from /rover/test" in caplog.text
    assert "/rover/gate" in caplog.text


def test_external_writer_is_accepted_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with (
        caplog.at_level(logging.WARNING),
        DeploymentHarness(deployment({"base": component(Base)}, ("cmd_vel",))) as harness,
    ):
        harness.publish("cmd_vel", Vector3(x=2.0))

        base = harness.run.runtime("base").component
        assert base.received == [2.0]  # type: ignore[attr-defined]
    assert "port cmd_vel: accepts every publisher on /rover/cmd_vel" in caplog.text
