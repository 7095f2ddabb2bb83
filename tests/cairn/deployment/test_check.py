"""Every mistake in a deployment is found in one pass, on its line, with its remedy."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cairn.deployment.load import load_deployment
from cairn.deployment.problems import DeploymentError, Problem
from tests.cairn.deployment.mistakes import CASES, HEAD, PARTS

Write = Callable[..., Path]


def problems(file: Path) -> tuple[Problem, ...]:
    with pytest.raises(DeploymentError) as caught:
        load_deployment(file)
    return caught.value.problems


def only(file: Path) -> tuple[int, str, str]:
    (problem,) = problems(file)
    assert problem.at.origin == "robot.yaml"
    return problem.at.line, problem.path, f"{problem.found}; {problem.remedy}"


@pytest.mark.parametrize(("text", "expected"), CASES.values(), ids=CASES.keys())
def test_mistake_is_reported_once_with_line_path_and_remedy(
    write: Write, text: str, expected: tuple[int, str, str]
) -> None:
    line, path, words = expected

    found_line, found_path, found = only(write(text))

    assert (found_line, found_path) == (line, path)
    for part in words.split("; "):
        assert part in found


def test_failed_import_of_a_plugin_is_reported_with_file_and_line(
    write: Write,
) -> None:
    line, path, text = only(write(HEAD + PARTS + "  eye: {plugin: acme_camera}\n"))

    assert (line, path) == (5, "components.eye.plugin")
    assert "acme_robot.camera cannot be imported: ModuleNotFoundError" in text
    assert "camera.py:3" in text


def test_handler_of_a_missing_port_is_reported(write: Write) -> None:
    line, path, text = only(write(HEAD + "  ear: {plugin: 'acme_robot.parts:Listener'}\n"))

    assert (line, path) == (3, "components.ear.plugin")
    assert "odm" in text


def test_input_without_publisher_mentions_plugins_that_failed_to_load(write: Write) -> None:
    file = write(
        "cairn: 1\ncomponents:\n  a: {plugin: acme_simulator}\n  b: {plugin: acme_camera}\n"
        "  c: {plugin: acme_localizer}\n"
    )

    _, unwritten = problems(file)

    assert "no component publishes topic odom" in unwritten.found
    assert "(a plugin that could not be loaded may publish it)" in unwritten.found


@pytest.mark.parametrize("topic", ["odom", "/robot/odom"])
def test_external_topic_needs_no_publisher(write: Write, topic: str) -> None:
    text = HEAD + "  sim: {plugin: acme_simulator}\n  localizer: {plugin: acme_localizer}\n"

    deployment = load_deployment(write(f"{text}external_topics: [{topic}]\n"))

    assert deployment.external_topics == (topic,)


def test_topic_with_a_slash_is_outside_the_robots_namespace(write: Write) -> None:
    file = write(
        HEAD
        + "  sim: {plugin: acme_simulator}\n  base: {plugin: acme_base, topics: {odom: /odom}}\n"
        "  localizer:\n    plugin: acme_localizer\n"
    )

    line, path, text = only(file)
    assert (line, path) == (6, "components.localizer.topics.odom")
    assert text.startswith("no component publishes topic odom")


def test_simulated_clock_may_be_external_or_from_a_component(write: Write) -> None:
    load_deployment(
        write("cairn: 1\nclock: simulated\nexternal_topics: [clock]\ncomponents:\n" + PARTS)
    )
    load_deployment(
        write(
            "cairn: 1\nclock: simulated\ncomponents:\n"
            "  sim: {plugin: acme_simulator, topics: {time: clock}}\n"
        )
    )


def test_remote_listening_can_be_allowed(write: Write, tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.touch(mode=0o600)
    password.write_text("hunter2")
    bus = f"""
bus:
  listen: ['tcp/[::]:7447']
  allow_remote: true
  users: {{anna: {{role: view, password_file: {password}}}}}
"""

    assert load_deployment(write(f"cairn: 1{bus}components:\n" + PARTS)).bus.listen == (
        "tcp/[::]:7447",
    )


def test_twelve_mistakes_are_reported_in_one_pass(write: Write) -> None:
    file = write("""
        cairn: 1
        robot: Robbie
        clock: simulated
        speed: 3
        bus: {listen: ['tcp/192.168.1.5:7447']}
        components:
          boss:
            plugin: acme_supervisor
            children:
              scanner:
                plugin: acme_scanner
                parameters: {rate: 50}
              scaner:
                plugin: acme_scaner
              base:
                plugin: acme_base
                topics: {odometry: o}
                significant: yes
          localizer:
            plugin: acme_localizer
            parameters:
              particles: 5
              filters: {}
            topics: {scan: scans}
            hang_timeout_s: -1
        """)

    found = problems(file)

    assert [(problem.at.line, problem.path) for problem in found] == [
        (2, "robot.name"),
        (3, "clock"),
        (4, "speed"),
        (5, "bus.listen"),
        (12, "components.scanner.parameters.device"),
        (12, "components.scanner.parameters.rate"),
        (14, "components.scaner.plugin"),
        (17, "components.base.topics.odometry"),
        (18, "components.base.significant"),
        (22, "components.localizer.parameters.particles"),
        (23, "components.localizer.parameters.filters"),
        (24, "components.localizer.topics.scan"),
        (25, "components.localizer.hang_timeout_s"),
    ]


def test_error_text_lists_and_counts_the_problems(write: Write) -> None:
    file = write(HEAD + "  a: {plugin: acme_base, restart: no}\n  b: {plugin: nothing_like_it}\n")

    with pytest.raises(DeploymentError) as caught:
        load_deployment(file)

    first, second, third = str(caught.value).splitlines()
    assert first == "the deployment has 2 problems:"
    assert second.startswith("  robot.yaml:3: components.a.restart: 'no' should be 'permanent',")
    assert third.startswith("  robot.yaml:4: components.b.plugin: ")
    assert "nothing_like_it" in third


GOOD = {
    "cairn": 1,
    "settings": {"a": {"b": 1}, "c": "${a.b}"},
    "bus": {"connect": ["tcp/127.0.0.1:7500"]},
    "external_topics": ["odom"],
    "components": {
        "boss": {
            "plugin": "acme_supervisor",
            "children": {
                "sim": {"plugin": "acme_simulator", "topics": {"time": "clock"}},
                "localizer": {"plugin": "acme_localizer", "parameters": {"gains": [1, 2]}},
            },
        }
    },
}
ODD = st.sampled_from(
    [None, True, 0, -1.5, "", "x", "${", "${a}", "${c}", "a.b", [], [None], [[1]], {}, {"x": None}]
)


def replaced(value: Any, choice: st.DataObject) -> Any:
    """Return the value with one part, at any depth, replaced by an arbitrary value."""
    if isinstance(value, dict) and value and choice.draw(st.integers(0, 5)):
        key = choice.draw(st.sampled_from(sorted(value)))
        return value | {key: replaced(value[key], choice)}
    if isinstance(value, list) and value and choice.draw(st.booleans()):
        return [replaced(value[0], choice), *value[1:]]
    return choice.draw(ODD)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(choice=st.data())
def test_any_document_gives_a_deployment_or_a_list_of_problems(
    write: Write, choice: st.DataObject
) -> None:
    file = write(json.dumps(replaced(GOOD, choice)))

    members = 0
    found: tuple[Problem, ...] = ()
    try:
        members = len(list(load_deployment(file).members()))
    except DeploymentError as error:
        found = error.problems

    assert bool(members) != bool(found)
    assert all(problem.found and problem.remedy for problem in found)


def _grown(first: str, join: Callable[[int], str]) -> str:
    """Return settings of which each contains the one before nine times."""
    lines = [f"  a{number}: {join(number)}" for number in range(1, 11)]
    return "\n".join(["settings:", f"  a0: {first}", *lines]) + "\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            _grown("&a0 [x]", lambda n: f"&a{n} [{', '.join([f'*a{n - 1}'] * 9)}]"),
            "the file holds more than 50,000 values, with its aliases expanded",
        ),
        (
            _grown("[x]", lambda n: f"[{', '.join([repr(f'${{a{n - 1}}}')] * 9)}]"),
            "with its settings the deployment holds more than 50,000 values",
        ),
        (
            _grown("text", lambda n: repr(f"${{a{n - 1}}}" * 9)),
            "settings.a5: with its settings the text is longer than 100,000 characters",
        ),
        (
            "settings: " + "{a: " * 400 + "1" + "}" * 400,
            "is nested deeper than 100 levels",
        ),
    ],
    ids=["aliases", "lists", "texts", "levels"],
)
def test_document_that_grows_without_bound_is_rejected_at_once(
    write: Write, text: str, problem: str
) -> None:
    with pytest.raises(DeploymentError) as refusal:
        load_deployment(write(text + "\n" + HEAD + PARTS))

    assert problem in str(refusal.value)


def test_unknown_key_is_reported_even_if_another_problem_has_the_same_path(
    write: Write,
) -> None:
    found = problems(write(HEAD + PARTS + "[a, b]: 1\n'': 2\n"))

    assert [problem.at.line for problem in found] == [5, 6]
