"""A deployment of several machines: which part runs where, what crosses, and what is rejected."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cairn import CairnError
from cairn.deployment.load import load_deployment
from cairn.deployment.machines import (
    check_machine,
    components_by_machine,
    parents_elsewhere,
    remote_inputs,
)
from cairn.deployment.model import Deployment
from cairn.deployment.shipped import FOLDER
from cairn.runtime.child_spec import ChildSpec

SIM = FOLDER / "sim.yaml"
MACHINES = "machines: {base: {address: 10.9.0.1}, brain: {address: brain.local, port: 7500}}\n"
REMOTE = """components:
  mobile_supervisor: {children: {automove: {children: {localizer: {machine: brain}}}}}
  vision_supervisor: {machine: brain}
"""


@pytest.fixture
def overlay(tmp_path: Path) -> Path:
    return tmp_path / "machines.yaml"


@pytest.fixture
def deployment(overlay: Path) -> Deployment:
    overlay.write_text(MACHINES + REMOTE)
    return load_deployment(SIM, [overlay])


def tree(spec: ChildSpec) -> Iterator[tuple[str, ChildSpec]]:
    for name, child in spec.children.items():
        yield name, child
        yield from tree(child)


def test_components_without_a_machine_run_on_the_first_one(deployment: Deployment) -> None:
    placed = components_by_machine(deployment)
    assert placed["brain"] == ("localizer", "vision_supervisor", "object_recognizer")
    assert {"mobile_supervisor", "automove", "path_planner", "world"} <= {*placed["base"]}
    assert sum(map(len, placed.values())) == len(list(deployment.members()))


def test_root_of_another_machine_waits_for_requests(deployment: Deployment) -> None:
    root = deployment.root("brain")
    assert [(name, one.load) for name, one in root.children.items()] == [
        ("localizer", "on_request"),
        ("vision_supervisor", "on_request"),
    ]
    assert list(root.children["vision_supervisor"].children) == ["object_recognizer"]
    assert parents_elsewhere(deployment, "brain") == {
        "localizer": "automove",
        "vision_supervisor": "root",
    }
    assert parents_elsewhere(deployment, "base") == {}


def test_root_of_the_first_machine_has_all_with_their_machines(deployment: Deployment) -> None:
    machines = {name: child.machine for name, child in tree(deployment.root("base"))}
    assert machines["localizer"] == machines["object_recognizer"] == "brain"
    assert machines["automove"] == machines["robot_frames"] == "base"


def test_component_whose_parent_is_elsewhere_is_started_by_its_own_root(overlay: Path) -> None:
    overlay.write_text(
        f"{MACHINES}components: {{mobile_supervisor: {{children: {{automove: {{machine: brain, "
        "children: {motion_control: {machine: base}}}}}}\n"
    )
    deployment = load_deployment(SIM, [overlay])
    root = deployment.root("base")
    assert root.children["motion_control"].load == "on_request"
    assert parents_elsewhere(deployment, "base") == {"motion_control": "automove"}
    assert list(deployment.root("brain").children) == ["automove"]


def test_fallback_is_a_sibling_on_the_machine_of_the_parent(overlay: Path) -> None:
    fallback = "fallback: {parameters: {particles: 300}}"
    localizer = f"{{machine: brain, {fallback}}}"
    overlay.write_text(
        f"{MACHINES}components: {{mobile_supervisor: {{children: {{automove: {{children: "
        f"{{localizer: {localizer}}}}}}}}}}}\n"
    )
    deployment = load_deployment(SIM, [overlay])
    spec = deployment.member("localizer_fallback").spec
    own = deployment.member("localizer").spec
    assert (spec.plugin, spec.topics, spec.load) == (own.plugin, own.topics, "on_request")
    assert spec.parameters == {**own.parameters, "particles": 300}
    assert deployment.machine_of("localizer_fallback") == "base"
    overlay.write_text(
        f"{MACHINES}components: {{mobile_supervisor: {{children: {{automove: {{children: "
        "{localizer: {machine: brain, fallback: {parameters: {particels: 300}}}}}}}}\n"
    )
    with pytest.raises(CairnError, match="did you mean particles"):
        load_deployment(SIM, [overlay])


def test_what_crosses_names_topic_writer_and_readers(deployment: Deployment) -> None:
    inputs = {str(one): one.reader_machine for one in remote_inputs(deployment)}
    assert inputs["/robot/scan (range_scanner) for localizer"] == "brain"
    missing = (
        "/robot/localization (localizer) for mobile_supervisor, automove, map_builder, "
        "path_planner, motion_control"
    )
    assert inputs[missing] == "base"
    assert not any("/robot/cmd_vel" in one for one in inputs)


def test_machine_must_be_named_when_there_are_several(deployment: Deployment) -> None:
    check_machine(deployment, "brain", "sim.yaml")
    with pytest.raises(CairnError, match="name this one with --machine, one of: base, brain"):
        check_machine(deployment, "", "sim.yaml")
    with pytest.raises(CairnError, match="no machine arm; choose one of: base, brain"):
        check_machine(deployment, "arm", "sim.yaml")
    with pytest.raises(CairnError, match="it has no `machines`; leave it out"):
        check_machine(load_deployment(SIM), "base", "sim.yaml")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("components: {world: {machine: brain}}", "there is no machine brain; add it"),
        (MACHINES + "components: {world: {machine: brian}}", "did you mean brain"),
        (
            MACHINES + "components: {world: {machine: brain, placement: in_process}}",
            "a component in its parent's process runs on its parent's machine",
        ),
        (MACHINES + "components: {world: {on_loss: stop}}", "which cannot be lost"),
        (MACHINES + "components: {world: {fallback: {}}}", "to which there is no link"),
        (
            MACHINES + "components: {mobile_supervisor: {machine: brain}}",
            "only a component of the first machine can end the deployment",
        ),
        (
            MACHINES + "components: {root_brain: {plugin: simulated_world}}",
            "root_brain is a name that a robot of several machines has already",
        ),
        (
            MACHINES + "components: {diary: {plugin: recorder, machine: brain, "
            "parameters: {file: /tmp/a.mcap}}}",
            "machine brain may not read the topics of the others; add `role: view` to machines",
        ),
        (MACHINES + "bus: {connect: [tcp/10.0.0.1:7447]}", "joins no other one"),
        (
            "machines: {a: {address: 10.0.0.1}, b: {address: 10.0.0.1}}",
            "it has the address and port of machine a",
        ),
        ("machines: {a: {address: 'tcp/10.0.0.1'}}", "Host name or IP address"),
        ("machines: {a: {address: 10.0.0.1, port: 70000}}", "Port for the links"),
    ],
)
def test_what_does_not_fit_together_is_rejected(overlay: Path, text: str, problem: str) -> None:
    overlay.write_text(text)
    with pytest.raises(CairnError) as error:
        load_deployment(SIM, [overlay])
    assert problem in str(error.value)


@pytest.mark.parametrize(
    ("machine", "endpoint"),
    [
        ({"address": "10.9.0.1"}, "tls/10.9.0.1:7448"),
        ({"address": "brain.local", "port": 1}, "tls/brain.local:1"),
        ({"address": "fd00::1"}, "tls/[fd00::1]:7448"),
    ],
)
def test_endpoint_of_a_machine(machine: dict[str, Any], endpoint: str) -> None:
    values = {"cairn": 1, "machines": {"a": machine}, "components": {"x": {"plugin": "y"}}}
    assert Deployment.model_validate(values).machines["a"].endpoint == endpoint
