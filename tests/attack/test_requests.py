"""A peer without rights sends malformed, huge and forbidden control requests."""

from __future__ import annotations

import json
import re
import secrets
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf, nan
from typing import Any, Final

import pytest
import zenoh

from cairn.bus import keys
from cairn.bus.actions import SEND_GOAL, ActionCaller, make_at_once
from cairn.bus.codec import Codec
from cairn.bus.services import ZenohClient
from cairn.bus.type_hash import type_hash
from cairn.deployment.plugins import load_plugin
from cairn.runtime.lifecycle import Transition
from cairn.runtime.parameters import describe_parameters
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.geometry_msgs import Point, Pose, PoseStamped
from cairn.schemas.message import Service, type_name
from cairn.schemas.nav2_msgs.action import NavigateThroughPoses
from cairn.schemas.std_msgs import Header
from tests.attack.inputs import components, deployment
from tests.attack.robot import MOST_MEMORY_MB, AttackedRobot
from tests.cairn.bus.network import eventually
from tests.patience import LIMIT_S
from tests.zone_features import place

LONGEST_ANSWER: Final = 4100
"""A refusal is for people: an attacker does not make it longer [characters]."""

ACTION: Final = "/robot/navigate_through_poses"
ROOT: Final = "root"
SUPERVISORS: Final = ("mobile_supervisor", "automove", "vision_supervisor", ROOT)

MALFORMED: Final = {
    "empty": b"",
    "no_json": b"{",
    "text": b'"deactivate"',
    "number": b"7",
    "null": b"null",
    "list": b"[]",
    "unknown_key": b'{"verb": "deactivate"}',
    "arguments_list": b'{"arguments": [1]}',
    "arguments_number": b'{"arguments": 1e999}',
    "trailing": b'{"arguments": {}} {}',
    "not_utf8": b'{"arguments": {"\xff\xfe": 1}}',
    "surrogate": b'{"arguments": {"a": "\\ud800"}}',
    "deep": b'{"arguments": {"a": ' + b"[" * 5000 + b"]" * 5000 + b"}}",
    "deep_objects": b'{"arguments": {"a": ' + b'{"a":' * 2000 + b"1" + b"}" * 2000 + b"}}",
}

VERBS: Final = ("unknown", "on_request", "configure_", "a" * 100)
NO_VERBS: Final = ("__class__", "Deactivate", "a" * 101, "load;reboot", "*", "..", "9")


@pytest.fixture(scope="module")
def peer(robot: AttackedRobot) -> Iterator[zenoh.Session]:
    """The session of the attacker."""
    with robot.attacker() as session:
        yield session


def refusal(peer: zenoh.Session, component: str, verb: str, payload: bytes) -> str:
    """Return the reason for which a component refuses a request; fail if it accepts it."""
    key = keys.control_key(0, f"/robot/{component}", verb)
    answers = [
        json.loads(reply.ok.payload.to_bytes())
        for reply in peer.get(key, payload=payload, timeout=LIMIT_S)
        if reply.ok is not None
    ]
    assert len(answers) == 1, f"{component} has not answered {verb}"
    assert answers[0]["error"] is not None, f"{component} has accepted {verb}: {answers}"
    assert len(answers[0]["error"]) <= LONGEST_ANSWER
    return str(answers[0]["error"])


def arguments(**given: Any) -> bytes:
    """Return the payload of a request; a text given as bytes is put in as it is."""
    raw = {name: value for name, value in given.items() if isinstance(value, bytes)}
    text = json.dumps({"arguments": {**given, **dict.fromkeys(raw, "<raw>")}}).encode()
    for value in raw.values():
        text = text.replace(b'"<raw>"', value, 1)
    return text


NUMBER = b"9" * 5000
MARK = 1234.5

GOAL: Final = (1.0, 1.0, 0.0)
GOALS: Final[dict[str, tuple[list[tuple[float, float, float]], str, str]]] = {
    "none": ([], "map", "0 poses"),
    "far": ([(1e300, 1, 0)], "map", "goal 1 .*finite"),
    "second": ([GOAL, (1, -2e5, 0)], "map", "goal 2 .*at most"),
    "thousand_and_one": ([GOAL] * 1001, "map", "1,001 goals"),
    "ten_thousand": ([GOAL] * 10_000, "map", "10,000 goals"),
    "frame": ([GOAL], "odom", "in frame odom"),
    "long_frame": ([GOAL], "n" * 100_000, "in frame n"),
}
"""Goals of `navigate_through_poses` that are aborted: x, y, z; frame; a part of the reason."""


PLACE: Final = place("a", 1, 1)

REQUESTS: Final[list[tuple[str, str, dict[str, Any], str]]] = [
    *(
        request
        for one in SUPERVISORS
        for request in (
            (one, "load", {}, "unknown request load"),
            (one, "load", {"name": "nothing"}, "no child is named nothing"),
            (one, "load", {"name": 7}, "no child is named 7"),
            (one, "unload", {"name": "../base"}, "no child is named"),
            (one, "restart", {"name": ["base"]}, "no child is named"),
            (one, "restart", {"name": "n" * 10_000}, "no child is named"),
            (one, "hold", {"name": "nothing", "state": "inactive"}, "no child is named"),
            (one, "hold", {"name": "base"}, "unknown request hold"),
        )
    ),
    ("mobile_supervisor", "hold", {"name": "base", "state": "finalized"}, "cannot be held"),
    ("velocity_gate", "stop", {"why": "x"}, "unknown request stop"),
    ("velocity_gate", "release_stop", {"force": True}, "unknown request release_stop"),
    ("velocity_gate", "status", {"of": "base"}, "unknown request status"),
    ("velocity_gate", "acquire_lease", {}, "unknown request acquire_lease"),
    ("velocity_gate", "acquire_lease", {"operator": "", "seconds": 1}, "printable"),
    ("velocity_gate", "acquire_lease", {"operator": "a" * 65, "seconds": 1}, "printable"),
    ("velocity_gate", "acquire_lease", {"operator": "a\x1b[2J", "seconds": 1}, "printable"),
    ("velocity_gate", "acquire_lease", {"operator": 7, "seconds": 1}, "not a text"),
    ("velocity_gate", "acquire_lease", {"operator": "a", "seconds": 0}, "duration"),
    ("velocity_gate", "acquire_lease", {"operator": "a", "seconds": -1}, "duration"),
    ("velocity_gate", "acquire_lease", {"operator": "a", "seconds": 1e300}, "duration"),
    ("velocity_gate", "acquire_lease", {"operator": "a", "seconds": b"NaN"}, "duration|invalid"),
    ("velocity_gate", "acquire_lease", {"operator": "a", "seconds": NUMBER}, "invalid"),
    ("velocity_gate", "acquire_lease", {"operator": "a", "seconds": True}, "not a number"),
    ("velocity_gate", "take_over_lease", {"operator": "a", "seconds": 61}, "duration"),
    ("velocity_gate", "renew_lease", {"lease": 1, "seconds": 5}, "not valid"),
    ("velocity_gate", "renew_lease", {"lease": "1", "seconds": 5}, "not the id"),
    ("velocity_gate", "release_lease", {"lease": 1}, "not valid"),
    ("velocity_gate", "release_lease", {"lease": 2**63}, "not valid"),
    ("velocity_gate", "release_lease", {"lease": True}, "not the id"),
    ("map_builder", "zones", {"of": "map"}, "unknown request zones"),
    ("map_builder", "add_zone", {}, "unknown request add_zone"),
    ("map_builder", "add_zone", {"feature": None}, "must be an object"),
    ("map_builder", "add_zone", {"feature": {"type": "Feature"}}, "properties"),
    ("map_builder", "add_zone", {"feature": PLACE | {"x": 1}}, "x"),
    ("map_builder", "add_zone", {"feature": PLACE, "replace": 7}, "no such zone"),
    ("map_builder", "add_zone", {"feature": place("a", 0, 1e300)}, "at most 100000"),
    ("map_builder", "add_zone", {"feature": place("a", 0, True)}, "valid number"),
    ("map_builder", "remove_zone", {"name": "n" * 10_000}, "no such zone"),
    ("map_builder", "remove_zone", {"name": {"a": 1}}, "no such zone"),
    ("map_builder", "set_zones", {"features": {}}, "give a list"),
    ("map_builder", "set_zones", {"features": [PLACE, PLACE]}, "names must differ"),
    ("world", "move", {}, "must be given"),
    ("world", "move", {"name": "table", "x": 1e300, "y": 0}, "less than or equal"),
    ("world", "move", {"name": "table", "x": b"NaN", "y": 0}, "finite|invalid"),
    ("world", "move", {"name": "nothing", "x": 1, "y": 1}, "does not exist"),
    ("world", "move", {"name": "n" * 10_000, "x": 1, "y": 1}, "60 characters"),
    ("world", "remove", {"name": "nothing"}, "does not exist"),
    ("world", "remove", {"name": 7}, "must be a string"),
    ("world", "kidnap", {"x": -5, "y": -5, "theta": 0}, "outside the walls"),
    ("world", "person", {"name": "p", "speed": 1e300, "waypoints": [[1, 1]]}, "speed"),
    ("world", "person", {"name": "p", "speed": 1, "waypoints": []}, "waypoints"),
    ("world", "furniture", {"name": "f"}, "must be given"),
    ("world", "object", {"id": -1, "x": 1, "y": 1}, "greater than or equal"),
    *(
        ("world", "object", {"id": 99, "x": 2.0, "y": 6.9, "texture": texture}, reason)
        for texture, reason in (
            ("/dev/zero", "device"),
            ("/dev/null", "device"),
            ("/nothing.png", "no such|cannot be read|does not exist|No such"),
            ("/", "folder|directory"),
        )
    ),
    ("base", "set_parameters", {"nothing": 1}, "no parameter nothing"),
    ("base", "set_parameters", {"n" * 10_000: 1}, "no parameter n"),
    ("velocity_gate", "set_parameters", {"mount": {"x": 0}}, "group of parameters"),
    ("velocity_gate", "set_parameters", {"scanner": False}, "cannot change while it runs"),
    ("velocity_gate", "set_parameters", {"external.enabled": True}, "cannot change while it runs"),
    ("world", "set_parameters", {"radius": 0.23}, "cannot change while it runs"),
    ("localizer", "set_parameters", {"particles": 300}, "particles cannot change while it runs"),
]
"""Requests that are refused: component, verb, arguments, and a part of the reason."""


def _wrong_values() -> Iterator[tuple[str, str, Any]]:
    """Yield component, parameter and a value that it must not take, for every parameter."""
    for member in deployment().members():
        config = load_plugin(member.spec.plugin).config_class()
        for parameter in describe_parameters(config.model_validate(dict(member.spec.parameters))):
            yield member.name, parameter.name, {"not": "of this type"}
            if "float" in parameter.type or "int" in parameter.type:
                yield member.name, parameter.name, 1e300
                yield member.name, parameter.name, True


@pytest.mark.parametrize("name", MALFORMED)
@pytest.mark.parametrize("component", [*components(), ROOT])
def test_malformed_request_is_refused(peer: zenoh.Session, component: str, name: str) -> None:
    assert "invalid control request" in refusal(peer, component, "parameters", MALFORMED[name])


@pytest.mark.parametrize("verb", list(Transition))
@pytest.mark.parametrize("component", [*components(), ROOT])
def test_transition_from_the_bus_is_refused(peer: zenoh.Session, component: str, verb: str) -> None:
    assert "only its supervisor" in refusal(peer, component, verb, b"{}")


@pytest.mark.parametrize("verb", [*VERBS, *NO_VERBS])
@pytest.mark.parametrize("component", ["base", "mobile_supervisor", ROOT])
def test_unknown_verb_is_refused(peer: zenoh.Session, component: str, verb: str) -> None:
    reason = "unknown request" if verb in VERBS else "not the name of a request"

    assert reason in refusal(peer, component, verb, b"{}")


def client(peer: zenoh.Session, name: str, service: type[Service[Any, Any]]) -> ZenohClient:
    """Return a client of a service of the robot."""
    key = keys.data_key(0, name, type_name(service), type_hash(service))
    return ZenohClient(peer, Codec(), name, key, bytes(16), service, make_at_once, make_at_once)


@contextmanager
def navigation(peer: zenoh.Session) -> Iterator[ActionCaller[Any, Any, Any]]:
    """Yield a client of the action `navigate_through_poses`."""
    caller: ActionCaller[Any, Any, Any] = ActionCaller(
        ACTION, NavigateThroughPoses, lambda name, service: client(peer, name, service)
    )
    assert eventually(lambda: caller.is_available)
    yield caller
    caller.close()


@pytest.mark.parametrize("name", GOALS)
def test_goal_is_aborted_with_the_reason(peer: zenoh.Session, name: str) -> None:
    positions, frame, reason = GOALS[name]
    header = Header(frame_id=frame)
    poses = tuple(
        PoseStamped(header=header, pose=Pose(position=Point(x=x, y=y, z=z)))
        for x, y, z in positions
    )
    with navigation(peer) as caller:
        sent = caller.send(secrets.token_bytes(16), NavigateThroughPoses.Goal(poses=poses))
        assert eventually(lambda: sent.has_ended)

    assert sent.status == GoalStatus.STATUS_ABORTED
    assert sent.result is not None
    assert re.search(reason, sent.result.error_msg)
    assert len(sent.result.error_msg) <= LONGEST_ANSWER


@pytest.mark.parametrize("damage", [0, 4, 20, 21, 47, nan, inf, -inf])
def test_damaged_goal_is_rejected(peer: zenoh.Session, damage: float) -> None:
    service = NavigateThroughPoses.SendGoal
    pose = PoseStamped(pose=Pose(position=Point(x=MARK)))
    request = service.Request(goal=NavigateThroughPoses.Goal(poses=(pose,)))
    whole = Codec().encode(request)
    if isinstance(damage, int):
        payload = whole[:damage]
    else:
        payload = whole.replace(struct.pack("<d", MARK), struct.pack("<d", damage))
    key = keys.data_key(0, f"{ACTION}/{SEND_GOAL}", type_name(service), type_hash(service))

    (reply,) = peer.get(key, payload=payload, timeout=LIMIT_S)

    assert reply.ok is not None
    assert not Codec().decode(service.Response, reply.ok.payload.to_bytes()).accepted


def test_goal_of_another_definition_reaches_no_server(peer: zenoh.Session) -> None:
    service = NavigateThroughPoses.SendGoal
    key = keys.data_key(0, f"{ACTION}/{SEND_GOAL}", type_name(service), "RIHS01_" + 64 * "0")
    assert list(peer.get(key, payload=b"", timeout=LIMIT_S)) == []


@pytest.mark.parametrize(("component", "verb", "given", "reason"), REQUESTS)
def test_request_is_refused(
    peer: zenoh.Session, component: str, verb: str, given: dict[str, Any], reason: str
) -> None:
    assert re.search(reason, refusal(peer, component, verb, arguments(**given)))


@pytest.mark.parametrize(("component", "parameter", "value"), list(_wrong_values()))
def test_parameter_does_not_take_a_wrong_value(
    peer: zenoh.Session, component: str, parameter: str, value: Any
) -> None:
    found = refusal(peer, component, "set_parameters", arguments(**{parameter: value}))

    assert re.search(rf"(parameter )?{parameter.partition('.')[0]}.* rejected", found)


@pytest.mark.parametrize("kilobytes", [70, 200])
@pytest.mark.parametrize("component", [*components(), ROOT])
def test_long_request_is_refused_unread(
    peer: zenoh.Session, component: str, kilobytes: int
) -> None:
    payload = arguments(name="n" * (kilobytes << 10))

    assert "bytes, more than the" in refusal(peer, component, "load", payload)


@pytest.mark.parametrize("megabytes", [2, 20])
@pytest.mark.parametrize("component", ["base", "mobile_supervisor", ROOT])
def test_huge_request_is_discarded_on_the_way(
    robot: AttackedRobot, peer: zenoh.Session, component: str, megabytes: int
) -> None:
    payload = arguments(name="n" * (megabytes << 20))
    key = keys.control_key(0, f"/robot/{component}", "load")

    answers = list(peer.get(key, payload=payload, timeout=1.0))

    assert [answer for answer in answers if answer.ok is not None] == []
    assert "invalid control request" in refusal(peer, component, "parameters", b"[]")
    assert robot.harm().peak_mb < MOST_MEMORY_MB


@pytest.mark.parametrize("component", ["velocity_gate", "mobile_supervisor", "motion_control"])
def test_flood_of_requests_does_not_keep_a_component_from_its_work(
    robot: AttackedRobot, peer: zenoh.Session, component: str
) -> None:
    key = keys.control_key(0, f"/robot/{component}", "parameters")
    flood = [peer.get(key, payload=b"{}", timeout=4.0) for _ in range(2000)]

    robot.next_statuses()
    assert robot.harm().replaced == []
    for answers in flood:  # all are answered, or their time is up
        list(answers)
    assert "unknown request" in refusal(peer, component, "unknown", b"{}")


def test_afterward_the_robot_is_unharmed(
    robot: AttackedRobot, unharmed: Callable[[AttackedRobot], None]
) -> None:
    unharmed(robot)
