"""A user on the network tries what the roles `view` and `operate` do not allow."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import pytest
import zenoh

from cairn import RELIABLE, CairnError
from cairn.bus import control, keys
from cairn.bus.actions import CANCEL_GOAL, GET_RESULT, SEND_GOAL
from cairn.bus.control import NoReplyError
from cairn.bus.credentials import Credentials
from cairn.bus.discovery import QueryableWatcher
from cairn.bus.keys import EndpointEntity, NodeEntity
from cairn.bus.type_hash import type_hash
from cairn.deployment.plugins import load_plugin
from cairn.runtime.lifecycle import Transition
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.geometry_msgs import Point, Pose, PoseStamped
from cairn.schemas.message import Service, type_name
from cairn.schemas.nav2_msgs.action import NavigateThroughPoses
from tests.attack.conftest import Cases
from tests.attack.inputs import Topic, components, deployment, invalid, topics
from tests.attack.robot import AttackedRobot, attacked_robot
from tests.attack.test_requests import ACTION, ROOT, SUPERVISORS, navigation
from tests.cairn.bus.network import eventually
from tests.patience import LIMIT_S

ROLES: Final = ("view", "operate")
_MANAGING: Final = ("load", "unload", "restart", "hold")
_CHANGING_THE_WORLD: Final = ("move", "remove", "furniture", "object", "person", "kidnap")


def forbidden_requests() -> Iterator[tuple[str, str, str]]:
    """Yield role, component and verb of all requests that a role does not allow."""
    more = dict.fromkeys(SUPERVISORS, _MANAGING) | {"world": _CHANGING_THE_WORLD}
    roles: dict[str, Mapping[str, str]] = {
        member.name: load_plugin(member.spec.plugin).request_roles
        for member in deployment().members()
    }
    for role in ROLES:
        for component in (*components(), ROOT):
            verbs = ["set_parameters", *Transition, "unknown", *more.get(component, ())]
            allowed = ROLES[: ROLES.index(role) + 1]
            verbs += [verb for verb, of in roles.get(component, {}).items() if of not in allowed]
            yield from ((role, component, verb) for verb in verbs)


@pytest.fixture(scope="module")
def passwords(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The file with the password of each user; names are those of the roles."""
    folder = tmp_path_factory.mktemp("passwords")
    files = {name: folder / name for name in (*ROLES, "wrong")}
    for name, file in files.items():
        file.touch(mode=0o600)
        file.write_text(f"correct horse of {name}\n")
    return files


@pytest.fixture(scope="module")
def robot(
    tmp_path_factory: pytest.TempPathFactory, passwords: dict[str, Path]
) -> Iterator[AttackedRobot]:
    """A robot with a user for each role."""
    users = ", ".join(
        f"{role}: {{role: {role}, password_file: {passwords[role]}}}" for role in ROLES
    )
    with attacked_robot(tmp_path_factory.mktemp("robot"), f"bus.users={{{users}}}") as robot:
        yield robot


@pytest.fixture(scope="module")
def sessions(
    robot: AttackedRobot, passwords: dict[str, Path]
) -> Iterator[dict[str, zenoh.Session]]:
    """The session of the user with each role."""
    with ExitStack() as stack:
        yield {
            role: stack.enter_context(
                robot.attacker(Credentials(user=role, password_file=str(passwords[role])))
            )
            for role in ROLES
        }


@pytest.mark.parametrize(
    ("user", "password"),
    [("", ""), ("view", "wrong"), ("view", "operate"), ("operate", "view"), ("stranger", "view")],
)
def test_wrong_password_is_refused(
    robot: AttackedRobot, passwords: dict[str, Path], user: str, password: str
) -> None:
    given = Credentials()
    if user:
        given = Credentials(user=user, password_file=str(passwords[password]))

    with pytest.raises(CairnError, match="Does it accept your user name and password"):
        robot.attacker(given)


@pytest.mark.parametrize(("role", "component", "verb"), list(forbidden_requests()))
def test_request_that_the_role_does_not_allow_gets_no_reply(
    sessions: dict[str, zenoh.Session], role: str, component: str, verb: str
) -> None:
    with pytest.raises(NoReplyError, match="your role does not allow"):
        control.request(sessions[role], 0, f"/robot/{component}", verb, {}, timeout_s=LIMIT_S)


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("key", ["@cairn/**", "@cairn/0/component/robot/*/restart", "**"])
def test_request_to_all_components_gets_no_reply(
    sessions: dict[str, zenoh.Session], role: str, key: str
) -> None:
    replies = sessions[role].get(key, payload=b'{"arguments": {}}', timeout=LIMIT_S)

    assert [reply for reply in replies if reply.ok is not None] == []


@pytest.mark.parametrize("role", ROLES)
def test_message_that_the_role_does_not_allow_does_not_arrive(
    robot: AttackedRobot, sessions: dict[str, zenoh.Session], role: str, cases: Cases
) -> None:
    forbidden = [one for one in topics().values() if role == "view" or not one.operated]
    cases(forbidden)
    robot.next_statuses()
    before = {topic: _rejected(robot, topic) for topic in forbidden}

    for topic in forbidden:  # whatever arrives is invalid, and would be counted
        sessions[role].put(topic.key, invalid(topic)["truncated"])
        sessions[role].put(f"{topic.key}/@adv/pub/x", b"\xff")
    _wait_for_all_sent(sessions[role])
    robot.next_statuses()

    assert {topic: _rejected(robot, topic) for topic in forbidden} == before


def test_message_that_the_role_allows_arrives(
    robot: AttackedRobot, sessions: dict[str, zenoh.Session]
) -> None:
    """Without this, the test above would pass if nothing ever arrived."""
    allowed = [topic for topic in topics().values() if topic.operated]
    assert len(allowed) >= 4

    for topic in allowed:
        sessions["operate"].put(topic.key, invalid(topic)["truncated"])

    robot.await_counts(allowed, lambda before, now: now.invalid > 0)


def _rejected(robot: AttackedRobot, topic: Topic) -> list[int]:
    return [port.invalid + port.refused for port in robot.ports(topic)]


def _wait_for_all_sent(session: zenoh.Session) -> None:
    """Wait for the reply to a query, which does not overtake what was sent before."""
    key = keys.control_key(0, "/robot/base", "parameters")
    replies = session.get(key, payload=b"{}", timeout=LIMIT_S)
    assert [reply for reply in replies if reply.ok is not None]


@pytest.mark.parametrize("role", ROLES)
def test_user_does_not_announce_publishers_of_components(
    robot: AttackedRobot, sessions: dict[str, zenoh.Session], role: str, cases: Cases
) -> None:
    forbidden = [one for one in topics().values() if role == "view" or not one.operated]
    cases(forbidden)
    ghosts = [
        keys.token_key(EndpointEntity(
            NodeEntity(0, "ab", 0, f"/robot/ghost_of_{role}"), number, "MP", topic.name,
            type_name(topic.message), type_hash(topic.message), RELIABLE,
        ))
        for number, topic in enumerate(forbidden)
    ]  # fmt: skip
    tokens: list[Any] = [sessions[role].liveliness().declare_token(ghost) for ghost in ghosts]
    _wait_for_all_sent(sessions[role])

    names = {end.node.name for end in robot.client.connection.endpoints()}
    assert f"/robot/ghost_of_{role}" not in names
    for token in tokens:
        token.undeclare()


@pytest.mark.parametrize("role", ROLES)
def test_user_does_not_answer_requests_for_components(
    robot: AttackedRobot, sessions: dict[str, zenoh.Session], role: str, cases: Cases
) -> None:
    cases(components())
    queryables: list[Any] = [
        sessions[role].declare_queryable(
            keys.control_key(0, f"/robot/{component}_of_{role}"), zenoh.handlers.RingChannel(1)
        )
        for component in components()
    ]
    _wait_for_all_sent(sessions[role])

    for component in components():
        key = keys.control_key(0, f"/robot/{component}_of_{role}")
        with QueryableWatcher(robot.client.connection.session, key) as watcher:
            assert not watcher.wait(0.0)
    for queryable in queryables:
        queryable.undeclare()


def test_operator_may_send_a_goal_which_is_checked(sessions: dict[str, zenoh.Session]) -> None:
    pose = PoseStamped(pose=Pose(position=Point(x=1e300)))
    with navigation(sessions["operate"]) as caller:
        sent = caller.send(secrets.token_bytes(16), NavigateThroughPoses.Goal(poses=(pose,)))
        assert eventually(lambda: sent.has_ended)
    assert sent.result is not None
    assert "finite" in sent.result.error_msg


@pytest.mark.parametrize(
    ("part", "service"),
    [
        (SEND_GOAL, NavigateThroughPoses.SendGoal),
        (CANCEL_GOAL, CancelGoal),
        (GET_RESULT, NavigateThroughPoses.GetResult),
    ],
)
def test_viewer_neither_sends_nor_cancels_a_goal(
    sessions: dict[str, zenoh.Session], part: str, service: type[Service[Any, Any]]
) -> None:
    key = keys.data_key(0, f"{ACTION}/{part}", type_name(service), type_hash(service))
    answers = [len(list(sessions[role].get(key, payload=b"", timeout=LIMIT_S))) for role in ROLES]
    assert answers == [0, 1]


def test_afterward_the_robot_is_unharmed(
    robot: AttackedRobot, unharmed: Callable[[AttackedRobot], None]
) -> None:
    unharmed(robot)
