"""Overlays and `--set` change a deployment; settings replace their references."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cairn.deployment.load import apply_overlay, apply_set, load_deployment, read_names
from cairn.deployment.problems import DeploymentError
from cairn.deployment.yaml_document import DocumentNode, read_document
from tests.wording import assert_words

Write = Callable[..., Path]

ROBOT = """
    cairn: 1
    settings:
      recording: {path: "${here}/recordings", rate: 10.0}
      particles: 500
      file: "${recording.path}/${particles}.mcap"
    components:
      boss:
        plugin: acme_supervisor
        children:
          sim: {plugin: acme_simulator}
          base: {plugin: acme_base}
          localizer:
            plugin: acme_localizer
            parameters: {particles: "${particles}", map_file: "${file}"}
    """


def test_settings_replace_references_and_keep_their_type(write: Write) -> None:
    file = write(ROBOT, "deploy/robot.yaml")

    deployment = load_deployment(file)

    parameters = deployment.member("localizer").spec.parameters
    assert parameters["particles"] == 500
    assert parameters["map_file"] == f"{Path.cwd()}/deploy/recordings/500.mcap"
    assert deployment.settings["file"] == parameters["map_file"]


def test_names_are_read_without_plugins_and_with_overlays_and_sets(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write("""
        cairn: 1
        robot: ${name}
        settings: {name: rover}
        components:
          boss: {plugin: "cairn:Supervisor", children: {base: {plugin: "cairn:Component"}}}
        """)
    overlay = write("domain: 7", "overlay.yaml")

    monkeypatch.setenv("ROS_DOMAIN_ID", "3")
    assert read_names(file) == ("rover", 3, ("boss", "base"))
    assert load_deployment(file, import_plugins=False).domain == 3
    assert read_names(file, [overlay], ["name=tower"]) == ("tower", 7, ("boss", "base"))
    with pytest.raises(DeploymentError, match="there is no setting nam"):
        read_names(file, sets=["nam=tower"])


def test_set_changes_a_setting_by_name(write: Write) -> None:
    file = write(ROBOT)

    deployment = load_deployment(file, sets=["recording.path=/data", "particles=800"])

    assert deployment.settings["recording"] == {"path": "/data", "rate": 10.0}
    assert deployment.member("localizer").spec.parameters == {
        "particles": 800,
        "map_file": "/data/800.mcap",
    }


def test_set_finds_a_component_at_any_depth_by_name(write: Write) -> None:
    file = write(ROBOT)

    deployment = load_deployment(
        file,
        sets=[
            "components.localizer.parameters.filter={sigma: 0.5}",
            "components.base.restart=transient",
            "components.boss.supervision.max_restarts=9",
            "clock=system",
        ],
    )

    assert deployment.member("localizer").spec.parameters["filter"] == {"sigma": 0.5}
    assert deployment.member("base").spec.restart == "transient"
    assert deployment.member("boss").spec.supervision.max_restarts == 9


@pytest.mark.parametrize(
    ("assignment", "problem"),
    [
        ("recording.pth=/d", "setting recording.pth; did you mean recording.path or "),
        (
            "zzz=1",
            "setting zzz; "
            "expected one of: recording, recording.path, recording.rate, particles, file",
        ),
        ("settings.zz.top=1", "setting zz.top; expected one of: recording, "),
        (
            "components.localizr.restart=transient",
            "components.localizr; component localizr; did you mean localizer?",
        ),
        ("particles", "'particles'; key.path=value"),
        ("=5", "'=5'; key.path=value; recording.rate=10"),
        ("particles=", "null"),
        ("particles=[1", "invalid YAML; ']'"),
        (
            "components.base.topics.command=null",
            "components.base.topics.command; null; remove the line",
        ),
        (
            "components.localizer.parameters.particles=5",
            "components.localizer.parameters.particles; 5; 10",
        ),
    ],
)
def test_invalid_set_is_reported_with_its_remedy(
    write: Write, assignment: str, problem: str
) -> None:
    with pytest.raises(DeploymentError) as caught:
        load_deployment(write(ROBOT), sets=[assignment])

    (line,) = map(str, caught.value.problems)
    assert line.startswith(f"--set {assignment}: ")
    for part in problem.split("; "):
        assert part in line.removeprefix(f"--set {assignment}")


def test_overlays_are_merged_in_order_and_null_removes_keys(write: Write) -> None:
    base = write(ROBOT, "deploy/robot.yaml")
    lab = write(
        """
        settings: {recording: {path: "${here}/here"}, particles: 50}
        components:
          boss:
            children:
              base: {restart: transient, topics: {command: go}}
              localizer: {parameters: {map_file: null}}
        """,
        "lab/lab.yaml",
    )
    night = write(
        "components: {boss: {children: {base: {topics: {command: null}}}}}\n"
        "settings: {particles: 60}\n",
        "night.yaml",
    )

    deployment = load_deployment(base, [lab, night])

    assert deployment.settings["recording"] == {"path": f"{Path.cwd()}/lab/here", "rate": 10.0}
    assert deployment.member("localizer").spec.parameters == {"particles": 60}
    assert deployment.member("base").spec.restart == "transient"
    assert deployment.member("base").spec.topics == {}


def test_null_is_a_value_among_the_settings(write: Write) -> None:
    base = write(ROBOT.replace("rate: 10.0", "rate: 10.0, start: {x: 1.0}"))
    nothing = write("settings: {recording: {start: null}}", "nothing.yaml")

    by_set = load_deployment(base, sets=["recording.start=null"])
    by_overlay = load_deployment(base, [nothing])
    given_again = load_deployment(base, [nothing], ["recording.start={x: 2.0}"])

    assert by_set.settings["recording"]["start"] is None
    assert by_overlay.settings == by_set.settings
    assert given_again.settings["recording"]["start"] == {"x": 2.0}


def test_problem_is_located_in_the_file_of_its_value(write: Write) -> None:
    base = write(ROBOT, "robot.yaml")
    lab = write(
        """
        settings:
          particles: 3
        components:
          boss:
            children:
              base:
                stop_timeout_s: soon
              camera: null
        """,
        "lab.yaml",
    )

    with pytest.raises(DeploymentError) as caught:
        load_deployment(base, [lab])

    assert [(str(problem.at), problem.path) for problem in caught.value.problems] == [
        ("lab.yaml:2", "components.localizer.parameters.particles"),
        ("lab.yaml:7", "components.base.stop_timeout_s"),
        ("lab.yaml:8", "components.camera"),
    ]


@pytest.mark.parametrize(
    ("settings_text", "problem"),
    [
        (
            "{a: '${b}', b: '${c}', c: '${a}'}",
            "settings.c: circular settings: a -> b -> c -> a; give one of them a value",
        ),
        (
            "{a: {b: 'x${a}'}}",
            "settings.a.b: circular settings: a -> a.b -> a; ",
        ),
        ("{a: 'x${a'}", "settings.a: `${` without `}`; close it, or write `$${` for `${`"),
        ("{a: '${b}/x'}", "settings.a: ; setting b"),
        (
            "{a: {b: 1}, c: 'x${a}'}",
            "settings.c: the setting a is not a text, number or boolean, so it has no text; "
            "refer to a text, number or boolean",
        ),
    ],
)
def test_reference_without_value_is_reported_once(
    write: Write, settings_text: str, problem: str
) -> None:
    file = write(
        f"""
        cairn: 1
        settings: {settings_text}
        components:
          base: {{plugin: acme_base}}
        """
    )

    with pytest.raises(DeploymentError) as caught:
        load_deployment(file)

    (line,) = map(str, caught.value.problems)
    assert line.startswith("robot.yaml:2: ")
    for part in problem.split("; "):
        assert part in line


def test_references_work_in_sections_lists_and_for_whole_mappings(write: Write) -> None:
    file = write(
        """
        cairn: 1
        settings: {pair: [1, "${two}"], two: 2, on: true, all: {x: "${two}"}, copy: "${all}"}
        components:
          sim: {plugin: acme_simulator}
          base: {plugin: acme_base}
          localizer:
            plugin: acme_localizer
            parameters: {gains: "${pair}", map_file: "$${two} ${on} ${pair.1}"}
        """
    )

    deployment = load_deployment(file)

    assert deployment.settings["copy"] == {"x": 2}
    assert deployment.member("localizer").spec.parameters == {
        "gains": [1, 2],
        "map_file": "${two} true 2",
    }


def test_words_that_yaml_1_1_reads_as_booleans_stay_text(write: Write) -> None:
    file = write(
        """
        cairn: 1
        settings: {a: [on, off, yes, no, y, 12:30, 1_000, 2024-01-01], b: [true, FALSE, null, ~],
                   c: [1e-3, 0x10, 0o17, 017, -.inf, +3, .5], on: 1}
        components:
          base: {plugin: acme_base}
        """
    )

    values = load_deployment(file).settings

    assert values["a"] == ["on", "off", "yes", "no", "y", "12:30", "1_000", "2024-01-01"]
    assert values["b"] == [True, False, None, None]
    assert values["c"] == [0.001, 16, 15, 17, float("-inf"), 3, 0.5]
    assert values["on"] == 1


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("cairn: 1\n  robot: x\n", "robot.yaml:2: invalid YAML: mapping values are not "),
        ("cairn: [1\n\n", "robot.yaml:3: invalid YAML: while parsing a flow sequence"),
        ("", "robot.yaml:1: the file is empty; expected a mapping of keys to values"),
        ("- 1\n", "robot.yaml:1: found a list; expected a mapping of keys to values"),
        ("cairn: 1\n---\ncairn: 1\n", "robot.yaml:2: invalid YAML: expected a single doc"),
        ("cairn: !!binary eA==\n", "robot.yaml:1: cairn: the tag tag:yaml.org,2002:binary is"),
        ("cairn: !!int x\n", "robot.yaml:1: cairn: 'x' is not a value of type int;"),
        ("cairn: &a [*a]\n", "robot.yaml:1: cairn.0: the alias contains itself; write the"),
        ("[a]: 1\n", "robot.yaml:1: a list or mapping used as a key; use text as the key"),
        pytest.param(
            "a: " + "[" * 5000,
            "robot.yaml:1: the file is nested deeper than 100 levels;",
            id="deep",
        ),
        ("a: \x01\n", "robot.yaml:1: invalid YAML: unacceptable character #x0001:"),
    ],
)
def test_file_without_a_yaml_mapping_is_reported_with_its_line(
    write: Write, text: str, problem: str
) -> None:
    with pytest.raises(DeploymentError) as caught:
        load_deployment(write(text))

    assert [one for one in map(str, caught.value.problems) if one.startswith(problem)]


def test_all_unreadable_files_are_reported_together(write: Write) -> None:
    base = write("cairn: 1\nrobot: [\n")
    Path("latin.yaml").write_bytes(b"robot: \xe4\n")

    with pytest.raises(DeploymentError) as caught:
        load_deployment(base, [Path("latin.yaml"), Path("absent.yaml")])

    base_problem, latin, absent = map(str, caught.value.problems)
    assert_words(base_problem, "robot.yaml:3", "invalid YAML")
    assert_words(latin, "latin.yaml:1", "cannot be read", "utf-8")
    assert_words(absent, "absent.yaml", "cannot be read", "No such file")


KEYS = st.sampled_from(["a", "b", "c", "on"])
SCALARS = st.one_of(st.integers(-5, 5), st.booleans(), st.sampled_from(["x", "no", "1"]))
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)
MAPPINGS = st.dictionaries(KEYS, VALUES, max_size=3)
QUICK = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def tree(values: dict[str, Any], folder: Path) -> DocumentNode:
    file = folder / "some.yaml"
    file.write_text(json.dumps(values), encoding="utf-8")
    node, problems = read_document(file)
    assert node is not None
    assert problems == []
    return node


def merge_patch(target: Any, patch: Any) -> Any:
    """The merge of RFC 7386, section 2, for patches without null."""
    if not isinstance(patch, dict):
        return patch
    target = dict(target) if isinstance(target, dict) else {}
    return target | {key: merge_patch(target.get(key), value) for key, value in patch.items()}


@QUICK
@given(base=MAPPINGS, over=MAPPINGS)
def test_overlay_is_an_idempotent_merge_patch(
    base: dict[str, Any], over: dict[str, Any], tmp_path: Path
) -> None:
    first, problems = apply_overlay(tree(base, tmp_path), tree(over, tmp_path))
    again, more = apply_overlay(first, tree(over, tmp_path))

    assert (problems, more) == ([], [])
    assert first.plain() == again.plain() == merge_patch(base, over)


@QUICK
@given(base=MAPPINGS, path=st.lists(KEYS, min_size=1, max_size=3), value=VALUES)
def test_set_equals_an_overlay_of_one_key(
    base: dict[str, Any], path: list[str], value: Any, tmp_path: Path
) -> None:
    root = tree({"section": base}, tmp_path)
    over = value
    for key in ["section", *path][::-1]:
        over = {key: over}
    text = yaml.safe_dump(value, default_flow_style=True).removesuffix("...\n")

    by_set, problems = apply_set(root, f"section.{'.'.join(path)}={text}", frozenset(["section"]))

    assert problems == []
    assert by_set.plain() == apply_overlay(root, tree(over, tmp_path))[0].plain()
