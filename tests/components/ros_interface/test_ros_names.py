"""With `ros_names`, topics, services and actions of a robot also have names without the robot's."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from cairn import SECOND
from cairn.bus.bus import ServiceError
from cairn.bus.keys import message_key
from cairn.components.ros_interface.ros_names import RosNames
from cairn.deployment.access_control import access_control
from cairn.deployment.model import Deployment
from cairn.deployment.ros_name_mapping import ros_services, ros_topics
from cairn.processes.lockstep import LockstepRun
from cairn.processes.run_plan import plan_run, with_recorder
from cairn.runtime.robot import Robot
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.std_msgs import String
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing.lockstep import DeploymentHarness
from tests.cairn.bus.network import Network, eventually
from tests.cairn.runtime.threaded import ThreadedComponent

PARTS = "tests.components.ros_interface.parts"
DEPLOYMENT = Deployment.model_validate(
    {
        "cairn": 1,
        "robot": "rover",
        "ros_names": True,
        "frames": {"camera": {"x": 0.1}},
        "external_topics": ["clock"],
        "components": {
            "talker": {"plugin": f"{PARTS}:Talker", "topics": {"own": "/heard_elsewhere"}},
            "reader": {"plugin": f"{PARTS}:Reader"},
            "worker": {"plugin": f"{PARTS}:Worker"},
        },
    }
)


@pytest.fixture
def rover() -> Iterator[DeploymentHarness]:
    with DeploymentHarness(DEPLOYMENT) as rover:
        rover.run_for(1.0)
        yield rover


def test_messages_have_both_names_in_the_direction_of_their_topic(
    rover: DeploymentHarness,
) -> None:
    heard = rover.read("/heard", String)
    rover.run_for(0.5)

    rover.publish("/word", String(data="go"))
    rover.run_for(0.1)

    assert [one.data for one in heard.messages] == ["go"]


def test_messages_that_another_component_forges_are_not_passed_on(
    rover: DeploymentHarness,
) -> None:
    heard = rover.read("/heard", String)
    rover.run_for(0.5)

    rover.publish("heard", String(data="forged"))
    rover.run_for(0.1)

    assert heard.messages == []


def test_static_transforms_of_all_components_are_one_latched_message(
    rover: DeploymentHarness,
) -> None:
    late = rover.read("/tf_static", TFMessage)
    described = rover.read("/robot_description", String)
    rover.run_for(0.1)

    newest = late.messages[-1]
    assert {one.child_frame_id for one in newest.transforms} == {"camera", "optical"}
    assert '<link name="camera"' in described.messages[-1].data


def test_state_of_components_is_on_diagnostics(rover: DeploymentHarness) -> None:
    found = rover.read("/diagnostics", DiagnosticArray)
    rover.run_for(2.0)

    states = {one.name: (one.level, one.message) for one in found.messages[-1].status}
    assert states["rover: talker"] == (0, "active")


def test_services_and_actions_answer_under_both_names(rover: DeploymentHarness) -> None:
    assert rover.call("/add", AddTwoInts, AddTwoInts.Request(a=1, b=2)).sum == 3
    with pytest.raises(ServiceError, match="a is negative"):
        rover.call("/add", AddTwoInts, AddTwoInts.Request(a=-1, b=2))

    sent = rover.send_goal("/fibonacci", Fibonacci, Fibonacci.Goal(order=2))
    rover.run_for(1.0)
    assert sent.result is not None
    assert list(sent.result.sequence) == [0, 1]


@pytest.mark.processes
def test_other_robot_with_ros_names_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    network, started = Network(), []
    try:
        for robot in ("rover", "tower"):
            of_robot = DEPLOYMENT.model_copy(update={"robot": Robot(name=robot)})
            started.append(
                ThreadedComponent(RosNames, network.bus(), name="ros_names", deployment=of_robot)
            )
            started[-1].activate()

        def reported(robot: str) -> bool:
            return f"robot {robot} has ROS names in this domain, too" in caplog.text

        assert eventually(lambda: reported("tower") and reported("rover"))
    finally:
        for one in started:
            one.close()
        network.close()


def test_confidential_topics_and_complete_names_have_one_name() -> None:
    names = {(one.source, one.target) for one in ros_topics(DEPLOYMENT)}

    assert names == {
        ("/rover/tf_static", "/tf_static"),
        ("/rover/robot_description", "/robot_description"),
        ("/rover/heard", "/heard"),
        ("/word", "/rover/word"),
        ("/rover/fibonacci/_action/feedback", "/fibonacci/_action/feedback"),
        ("/rover/fibonacci/_action/status", "/fibonacci/_action/status"),
        ("/rover/diagnostics", "/diagnostics"),
    }
    external = DEPLOYMENT.model_copy(update={"external_topics": ("stop",)})
    (stop,) = (one for one in ros_topics(external) if one.source == "/stop")
    assert stop.target == "/rover/stop"  # a node of ROS may write to it then
    simulated = DEPLOYMENT.model_copy(update={"clock": "simulated"})
    (clock,) = (one for one in ros_topics(simulated) if one.message is Clock)
    assert (clock.source, clock.target) == ("/clock", "/rover/clock")
    assert {one.server for one in ros_services(DEPLOYMENT)} == {
        "/rover/add",
        *(
            f"/rover/fibonacci/_action/{name}"
            for name in ("send_goal", "cancel_goal", "get_result")
        ),
    }


def test_recording_of_all_topics_has_each_message_once(tmp_path: Path) -> None:
    run = LockstepRun(with_recorder(DEPLOYMENT, tmp_path / "run.mcap"), seed=1)
    run.start()
    run.executor.run_to(3 * SECOND)
    run.shutdown()

    with (tmp_path / "run.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {one.topic for one in summary.channels.values()}
    assert {"/rover/tf_static", "/rover/diagnostics"} <= topics
    assert topics.isdisjoint({"/tf_static", "/diagnostics"})


def test_users_on_the_network_may_do_the_same_under_both_names() -> None:
    rules = {one["id"]: one["key_exprs"] for one in access_control(DEPLOYMENT)["rules"]}
    word = message_key(DEPLOYMENT.domain, "/word", String)

    assert word in rules["operate: publish (ingress)"]
    domain = DEPLOYMENT.domain
    assert f"{domain}/fibonacci/_action/send_goal/*/*" in rules["operate: request (ingress)"]
    assert f"{domain}/add/*/*" in rules["view: request (ingress)"]
    assert not any(f"{domain}/secret" in key for found in rules.values() for key in found)


def test_exclusive_topics_are_read_by_the_component_that_passes_them_on() -> None:
    (heard, _) = plan_run(DEPLOYMENT).exclusive_topics

    assert (heard.topic, heard.readers) == ("/rover/heard", ("reader", "ros_names"))
