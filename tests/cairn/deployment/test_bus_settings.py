"""Who may connect to a deployment: what is refused, and the access control that follows from it."""

from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from cairn.deployment.access_control import access_control
from cairn.deployment.bus_settings import BusSettings
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.deployment.problems import DeploymentError
from tests.wording import assert_words

USERS = {"anna": {"role": "operate", "password_file": "anna.password"}}
MUTUAL = {
    "certificate": "robot.pem",
    "key": "robot.key",
    "ca": "ca.pem",
    "client_certificates": True,
    "certificate_roles": {"tablet": "view"},
}
IDENTITY = {"identity": "base"}
LOCAL = ["tcp/127.0.0.1:7447"]
REMOTE = ["tls/0.0.0.0:7447"]


@pytest.mark.parametrize(
    ("bus", "reason"),
    [
        ({"listen": LOCAL}, "anyone who reaches tcp/127.0.0.1:7447 could drive the robot; add"),
        ({"listen": LOCAL, "users": {}}, "anyone who reaches tcp/127.0.0.1:7447"),
        ({"listen": LOCAL, "allow_remote": True}, "anyone who reaches tcp/127.0.0.1:7447"),
        ({"listen": ["tcp/0.0.0.0:7447"], "users": USERS}, "can be reached from other machines"),
        ({"listen": ["tcp/0.0.0.0:7447"], "allow_remote": True}, "anyone who reaches"),
        (
            {"listen": ["tcp/0.0.0.0:1"], "allow_remote": True, "allow_any_local_user": True},
            "is for loopback only",
        ),
        ({"listen": LOCAL, "allow_any_local_user": True, "users": USERS}, "asks for no password"),
        (
            {
                "listen": ["tls/127.0.0.1:1"],
                "allow_any_local_user": True,
                "tls": {"certificate": "c", "key": "k"},
            },
            "encryption protects nothing",
        ),
        (
            {"listen": REMOTE, "allow_remote": True, "users": USERS},
            "is encrypted and needs a certificate; add `tls: {identity: NAME}` \\(cairn security",
        ),
        (
            {"listen": REMOTE, "allow_remote": True, "tls": {"certificate": "c", "key": "k"}},
            "anyone who reaches tls/0.0.0.0:7447",
        ),
        ({"listen": LOCAL, "tls": MUTUAL}, "carries no certificates"),
        ({"listen": ["tls/127.0.0.1:1"], "tls": MUTUAL, "users": USERS}, "roles come either from"),
        ({"listen": LOCAL, "tls": IDENTITY}, "carries no certificates"),
        (
            {"listen": ["tls/127.0.0.1:1"], "tls": IDENTITY, "users": USERS},
            "or from `tls.identity`",
        ),
        ({"listen": ["tls/127.0.0.1:1"], "tls": MUTUAL | IDENTITY}, "remove `certificate`, `key`"),
        ({"tls": IDENTITY}, "opens the endpoints of `listen`, which is empty"),
        (
            {"listen": ["tls/127.0.0.1:1"], "tls": IDENTITY, "allow_any_local_user": True},
            "asks for no password or certificate",
        ),
        ({"listen": ["/run/cairn/a.sock"], "users": USERS}, "is a Unix socket; name it under"),
        ({"users": USERS}, "`users` connect to `listen`, which is empty"),
        ({"tls": {"certificate": "c"}}, "`certificate` and `key` belong together"),
        ({"tls": {"client_certificates": True}}, "needs `ca`"),
        ({"tls": {"certificate_roles": {"a": "view"}, "ca": "ca"}}, "needs `client_certificates"),
        ({"connect": LOCAL, "listen": LOCAL, "users": USERS}, "with `connect` no router is opened"),
        ({"connect": LOCAL, "group": "robot"}, "`group` has no effect"),
        ({"connect": LOCAL, "socket": "/run/a.sock"}, "`socket` has no effect"),
        ({"connect": LOCAL, "user": "anna"}, "`user` and `password_file` belong together"),
        ({"user": "anna", "password_file": "p"}, "add `connect`"),
        ({"connect": ["/run/a.sock"], "user": "anna", "password_file": "p"}, "accepts no password"),
        ({"connect": ["tls/a.example:7447"]}, "needs `tls: {ca: FILE}`"),
        ({"socket": "a.sock"}, "is not an endpoint"),
        ({"socket": "tcp/127.0.0.1:7447"}, "is not the absolute path of a socket"),
        ({"users": {"Anna": USERS["anna"]}, "listen": LOCAL}, "match pattern"),
        ({"users": {"anna": {"role": "drive", "password_file": "p"}}}, "'view', 'operate'"),
        ({"max_message_size": 0}, "greater than or equal to 65536"),
        ({"open": True}, "Extra inputs are not permitted"),
    ],
    ids=lambda value: str(value)[:60],
)
def test_what_would_let_anyone_in_or_has_no_effect_is_refused(
    bus: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValidationError, match=reason):
        BusSettings.model_validate(bus)


@pytest.mark.parametrize(
    "bus",
    [
        {},
        {"listen": LOCAL, "allow_any_local_user": True},
        {"listen": LOCAL, "users": USERS},
        {"listen": ["tls/127.0.0.1:7447"], "tls": MUTUAL},
        {"listen": REMOTE, "allow_remote": True, "tls": IDENTITY},
        {"listen": REMOTE, "allow_remote": True, "users": USERS,
         "tls": {"certificate": "c", "key": "k"}},
        {"connect": ["tls/a.example:7447"], "tls": {"ca": "ca.pem"}, "user": "anna",
         "password_file": "p"},
    ],
)  # fmt: skip
def test_what_names_who_may_connect_is_accepted(bus: dict[str, Any]) -> None:
    BusSettings.model_validate(bus)


DEPLOYMENT = """
    cairn: 1
    robot: rover
    domain: 3
    bus: {{listen: ["tcp/127.0.0.1:7447"], users: {{{users}}}}}
    external_topics: [joy]
    components:
      mobile:
        plugin: mobile_supervisor
        children:
          localizer: {{plugin: localizer, topics: {{initialpose: /start}}}}
    """
USER = "{name}: {{role: {role}, password_file: none}}"


def deployment(**roles: str) -> Deployment:
    """Return a deployment with these users."""
    users = ", ".join(USER.format(name=name, role=role) for name, role in roles.items())
    text = dedent(DEPLOYMENT.format(users=users))
    return Deployment.model_validate(yaml.safe_load(text))


def allowed(deployment: Deployment, role: str, flow: str, message: str) -> set[str]:
    """Return the keys on which a role may exchange a message."""
    control = access_control(deployment)
    (policy,) = [one for one in control["policies"] if one["subjects"] == [role]]
    return {
        key
        for rule in control["rules"]
        if rule["id"] in policy["rules"] and flow in rule["flows"] and message in rule["messages"]
        for key in rule["key_exprs"]
    }


def test_access_control_denies_by_default_and_follows_from_the_deployment() -> None:
    one = deployment(anna="operate", vera="view", adam="administer", otto="operate")

    control = access_control(one)

    assert control["default_permission"] == "deny"
    assert control == access_control(
        deployment(otto="operate", adam="administer", vera="view", anna="operate")
    )
    assert control["subjects"] == [
        {"id": "the local router", "link_protocols": ["unixsock-stream"]},
        {"id": "view", "usernames": ["vera"]},
        {"id": "operate", "usernames": ["anna", "otto"]},
        {"id": "administer", "usernames": ["adam"]},
    ]
    denied = [rule for rule in control["rules"] if rule["permission"] == "deny"]
    assert [rule["key_exprs"] for rule in denied] == [["3/**/_service_event/*/*"]]


def test_role_without_members_is_no_subject() -> None:
    control = access_control(deployment(vera="view"))

    assert [subject["id"] for subject in control["subjects"]] == ["the local router", "view"]


def test_viewers_read_everything_in_their_domain_and_change_nothing() -> None:
    one = deployment(vera="view")

    assert allowed(one, "view", "ingress", "put") == set()
    assert allowed(one, "view", "ingress", "liveliness_token") == set()
    assert allowed(one, "view", "ingress", "declare_queryable") == set()
    assert allowed(one, "view", "ingress", "declare_subscriber") == {"3/**", "3/**/@adv/**"}
    reading = {
        f"3/rover/{node}/{service}/*/*"
        for node in ("root", "mobile", "localizer")
        for service in (
            "get_$*", "describe_parameters", "list_parameters", "_container/list_nodes",
        )
    }  # fmt: skip
    assert allowed(one, "view", "ingress", "query") == reading | {
        "3/**/@adv/**",
        "@cairn/3/component/rover/root/run",
        "@cairn/3/component/rover/mobile/parameters",
        "@cairn/3/component/rover/localizer/parameters",
    }


def test_operators_also_publish_goals_and_give_orders() -> None:
    one = deployment(anna="operate")

    published = {key for key in allowed(one, "operate", "ingress", "put") if "@adv" not in key}
    assert published == {
        "3/rover/goal_pose/geometry_msgs::msg::dds_::PoseStamped_/*",
        "3/start/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/*",
        "3/rover/joy/*/*",
    }
    requests = allowed(one, "operate", "ingress", "query") - allowed(
        deployment(vera="view"), "view", "ingress", "query"
    )
    actions = {
        f"3/rover/{action}/_action/{service}/*/*"
        for action in (
            "navigate_to_pose", "navigate_through_poses", "follow_waypoints", "spin", "back_up",
        )
        for service in ("send_goal", "cancel_goal", "get_result")
    }  # fmt: skip
    assert requests == actions
    assert allowed(one, "operate", "ingress", "declare_queryable") == {
        key for key in allowed(one, "operate", "ingress", "put") if "@adv" in key
    }


def test_administrators_may_do_everything() -> None:
    one = deployment(adam="administer")

    for flow in ("ingress", "egress"):
        for message in ("put", "query", "declare_queryable", "liveliness_token"):
            keys = {"**", "**/@adv/**", "@ros2_lv/**", "@cairn/**", "@/*/router/**"}
            assert allowed(one, "administer", flow, message) == keys


def test_socket_that_others_could_replace_and_unknown_group_are_problems_of_the_deployment(
    tmp_path: Path,
) -> None:
    tmp_path.chmod(0o755)
    file = tmp_path / "robot.yaml"
    file.write_text(
        dedent(f"""
        cairn: 1
        bus: {{socket: {tmp_path}/a.sock, group: no_such_group}}
        components: {{talker: {{plugin: test_talker}}}}
        """)
    )

    with pytest.raises(DeploymentError) as caught:
        load_deployment(file)

    assert [(one.path, one.at.line) for one in caught.value.problems] == [
        ("bus.socket", 3),
        ("bus.group", 3),
    ]
    assert "its mode 0755 lets other users in" in caught.value.problems[0].found
    assert "groupadd no_such_group" in caught.value.problems[1].remedy


def test_each_secret_or_certificate_that_cannot_be_used_is_a_problem_of_the_deployment(
    tmp_path: Path,
) -> None:
    open_to_all = tmp_path / "open.password"
    open_to_all.write_text("hunter2")
    open_to_all.chmod(0o644)
    empty = tmp_path / "empty.password"
    empty.touch(mode=0o600)
    file = tmp_path / "robot.yaml"
    file.write_text(
        dedent(f"""
        cairn: 1
        bus:
          listen: ["tls/127.0.0.1:7447"]
          users:
            anna: {{role: view, password_file: {open_to_all}}}
            bert: {{role: view, password_file: {empty}}}
            carl: {{role: view, password_file: {tmp_path}/missing}}
          tls:
            certificate: {tmp_path}/robot.pem
            key: {empty}
        components: {{talker: {{plugin: test_talker}}}}
        """)
    )

    with pytest.raises(DeploymentError) as caught:
        load_deployment(file)

    found = {problem.path: (problem.found, problem.remedy) for problem in caught.value.problems}
    assert list(found) == [
        "bus.users.anna.password_file",
        "bus.users.bert.password_file",
        "bus.users.carl.password_file",
        "bus.tls.certificate",
        "bus.tls.key",
    ]
    assert "(mode 0644)" in found["bus.users.anna.password_file"][0]
    assert found["bus.users.anna.password_file"][1] == f"run: chmod 600 {open_to_all}"
    assert "one line with a password" in found["bus.users.bert.password_file"][0]
    assert "No such file" in found["bus.users.carl.password_file"][0]
    assert "No such file" in found["bus.tls.certificate"][0]
    assert "hunter2" not in str(caught.value)


def test_all_problems_of_the_bus_are_reported_at_once(tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(
        dedent(
            f"""
            cairn: 1
            bus:
              listen: [tcp/127.0.0.1:7447, tls/0.0.0.0:7448]
              allow_remote: sometimes
              socket: relative.sock
              group: no_such_group
              users: {{anna: {{role: view, password_file: {tmp_path}/missing}}}}
            components: {{talker: {{plugin: test_talker}}}}
            """
        )
    )

    with pytest.raises(DeploymentError) as rejected:
        load_deployment(file)

    paths = [problem.path for problem in rejected.value.problems]
    for path in ("allow_remote", "socket", "group", "users.anna.password_file"):
        assert f"bus.{path}" in paths


def test_all_conflicts_within_the_bus_are_reported_at_once() -> None:
    bus = {
        "user": "anna",
        "listen": ["tcp/0.0.0.0:7447", "tls/127.0.0.1:7448"],
        "users": {},
    }
    with pytest.raises(ValidationError) as rejected:
        BusSettings.model_validate(bus)
    text = str(rejected.value)
    assert rejected.value.error_count() == 3
    assert_words(text, "0.0.0.0:7447", "allow_remote", "tls/127.0.0.1:7448", "certificate")

    with pytest.raises(ValidationError) as rejected:
        BusSettings.model_validate({"user": "anna", "users": USERS})
    assert rejected.value.error_count() == 3
