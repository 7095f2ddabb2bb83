"""Commands show foreign nodes, such as those of ROS 2, what does not match, and equal names."""

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from cairn import RELIABLE, SENSOR
from cairn.bus.conflicts import qos_mismatch
from cairn.bus.keys import EndpointEntity, EndpointKind, NodeEntity, token_key
from cairn.bus.session import open_client
from cairn.bus.type_hash import type_hash
from cairn.client import connect
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.geometry_msgs import PoseStamped, Twist, Vector3
from cairn.schemas.message import type_name
from cairn.schemas.rcl_interfaces.srv import GetParameters
from cairn.testing.launching import Run
from tests.cairn.bus.network import eventually
from tests.commands import all_answered, await_answer

from .conftest import Command

pytestmark = pytest.mark.processes

NAME = "/ros/base"
MISMATCH = qos_mismatch("/rover/words", NAME, SENSOR, "/rover/listener", RELIABLE)


@pytest.fixture(scope="module", autouse=True)
def strangers(rover: Run) -> Iterator[None]:
    """Announce a node of ROS 2 with its endpoints, and one with the name of a component."""
    base, namesake = NodeEntity(0, "5e55", 0, NAME), NodeEntity(0, "5e55", 9, "/rover/talker")
    ends: list[tuple[EndpointKind, str, str, str]] = [
        ("MP", "/rover/words", type_name(Twist), type_hash(Twist)),
        ("MS", "/rover/velocity", type_name(Vector3), type_hash(Vector3)),
        ("MP", "/rosout", "rcl_interfaces/msg/Log", "RIHS01_ab"),
        ("MS", "/rover/beacon", type_name(Vector3), type_hash(Vector3)),
        ("SS", "/ros/add", type_name(AddTwoInts), type_hash(AddTwoInts)),
        ("SS", "/ros/base/get_parameters", type_name(GetParameters), type_hash(GetParameters)),
        ("SS", "/ros/count/_action/send_goal",
         f"{type_name(Fibonacci)}_SendGoal", "RIHS01_ab"),
    ]  # fmt: skip
    tokens: list[NodeEntity | EndpointEntity] = [base, namesake]
    for number, (kind, name, type_, hash_) in enumerate(ends, start=1):
        tokens.append(EndpointEntity(base, number, kind, name, type_, hash_, SENSOR))
    with open_client([rover.endpoint]) as session, ExitStack() as stack:
        for one in tokens:
            token = session.liveliness().declare_token(token_key(one))
            stack.callback(token.undeclare)
        with connect(rover.endpoint) as robot:
            assert eventually(lambda: len(_foreign(robot.connection.graph())) == len(tokens))
        yield


def _foreign(graph: list[NodeEntity | EndpointEntity]) -> list[NodeEntity]:
    nodes = (one if isinstance(one, NodeEntity) else one.node for one in graph)
    return [node for node in nodes if node.is_foreign]


def test_ps_lists_foreign_nodes_after_the_components(command: Command) -> None:
    shown = command("ps").out.splitlines()
    rows = [row for row in command("ps", "--json").json if row["state"] == "foreign"]

    assert shown[-2].split()[:2] == [NAME, "foreign"]
    assert shown[-2].endswith(
        "publishes /rover/words; subscribes /rover/beacon, /rover/velocity; "
        "serves /ros/add, /ros/count"
    )
    assert [row["component"] for row in rows] == [NAME, "/rover/talker"]
    assert rows[0]["publishes"] == ["/rover/words"]
    assert (rows[0]["pid"], rows[0]["unique"]) == (None, True)
    of_robot = command("ps", "--robot", "rover", "--json").json
    assert NAME not in {row["component"] for row in of_robot}


def test_component_whose_name_another_node_has_is_marked_and_still_reached(
    command: Command,
) -> None:
    shown = await_answer(lambda: command("ps"), all_answered)
    row = next(line for line in shown.out.splitlines() if "  talker " in line)
    answer = command("param", "list", "talker", "--json")
    alike = command("node", "info", "talker").out

    assert " active " in row
    assert row.endswith("another node has this name")
    assert answer.code == 0
    assert alike.count("/rover/talker; another node has this name\n") == 1
    assert alike.count("/rover/talker (foreign); another node has this name\n") == 1


def test_node_list_and_info_have_what_a_node_uses(command: Command) -> None:
    rows = {row["node"]: row for row in command("node", "list", "--json").json}
    table = [" ".join(line.split()) for line in command("node", "info", NAME).out.splitlines()]
    [with_all] = command("node", "info", NAME, "--all", "--json").json

    assert (rows[NAME]["kind"], rows["/rover/listener"]["kind"]) == ("foreign", "component")
    assert rows["/rover/listener"]["subscribes"] == ["/rover/words"]
    assert f"{NAME} foreign 1 2 2 0" in " ".join(command("node", "list").out.split())
    assert table == [
        f"{NAME} (foreign)",
        "role name type qos",
        "publisher /rover/words geometry_msgs/msg/Twist best_effort, volatile, depth 5",
        "subscriber /rover/beacon geometry_msgs/msg/Vector3 best_effort, volatile, depth 5",
        "subscriber /rover/velocity geometry_msgs/msg/Vector3 best_effort, volatile, depth 5",
        "service server /ros/add example_interfaces/srv/AddTwoInts",
        "action server /ros/count example_interfaces/action/Fibonacci",
    ]
    assert (with_all["namespace"], with_all["foreign"]) == ("/ros", True)
    names = {end["name"] for end in with_all["endpoints"]}
    assert {"/rosout", "/ros/base/get_parameters"} <= names
    assert "did you mean" in command("node", "info", "/ros/bse").err


def test_lists_mark_foreign_nodes_and_warn_of_mismatches(command: Command) -> None:
    graph = command("graph")
    listed = command("topic", "list")
    info = command("topic", "info", "words")
    as_json = command("topic", "info", "words", "--json").json

    lines = [" ".join(row.split()) for row in graph.out.splitlines()]
    assert f"/rover/words geometry_msgs/msg/Twist {NAME} (foreign), talker listener" in lines
    lines = [" ".join(row.split()) for row in listed.out.splitlines()]
    assert f"/rover/words geometry_msgs/msg/Twist 2 1 {NAME}" in lines
    assert f"publisher {NAME} (foreign) geometry_msgs/msg/Twist" in " ".join(info.out.split())
    for answer in (graph, listed, info):
        assert answer.err.count(f"warning: {MISMATCH}\n") == 1
    assert as_json["problems"] == [MISMATCH]
    assert [end["foreign"] for end in as_json["endpoints"]] == [True, False, False]
    assert f"{NAME} (foreign)" in command("service", "list").out
    assert f"/ros/count example_interfaces/action/Fibonacci {NAME} (foreign)" in " ".join(
        command("action", "list").out.split()
    )


def test_foreign_type_on_a_topic_does_not_keep_it_from_its_users(
    command: Command, rover: Run
) -> None:
    latched = command("topic", "echo", "beacon", "--count", "1", "--json")
    with connect(rover.endpoint) as robot:
        message = robot.latest("beacon", PoseStamped)

    assert latched.json["pose"]["position"]["x"] == message.pose.position.x == 4.0
    conflict = command("topic", "info", "beacon").err
    assert f"topic /rover/beacon: {NAME} uses it with type geometry_msgs/msg/Vector3" in conflict
    assert "/rover/beacon with geometry_msgs/msg/PoseStamped" in conflict


def test_component_logs_the_mismatch_as_a_warning(rover: Run) -> None:
    rover.await_line(f"WARNING rover.listener: {MISMATCH}")
    rover.await_line(
        "WARNING rover.talker: another node has the name /rover/talker, in the foreign"
    )
