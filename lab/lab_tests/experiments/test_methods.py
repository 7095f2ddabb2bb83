"""Shadows get the same data as the driving method, and cannot influence the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import load_plugin
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.ports import ports_of
from cairn_lab.experiments.methods import (
    ABLATION,
    NO_UPDATE,
    OURS,
    PAPER,
    ExperimentSetup,
    experiment_deployment,
    first_event_s,
)
from tests.wording import words_in_order

DEPLOY = Path(__file__).parents[3] / "deploy"
SETUP = ExperimentSetup(DEPLOY / "sim.yaml", (DEPLOY / "experiment.yaml",), (), OURS, ABLATION[1:])


def deployment_of(setup: ExperimentSetup, folder: Path) -> Deployment:
    return experiment_deployment(setup, folder, folder)


def topic(spec: ChildSpec, port: str) -> str:
    return spec.topics.get(port, port)


def test_all_methods_read_the_same_sensors_and_publish_on_their_own_topics(tmp_path: Path) -> None:
    deployment = deployment_of(SETUP, tmp_path)

    driving = deployment.member("localizer").spec
    published: list[str] = []
    for method in ABLATION[1:]:
        for kind in ("localizer", "map_builder"):
            spec = deployment.member(f"{method.name}_{kind}").spec
            ports = ports_of(load_plugin(spec.plugin))
            published += [topic(spec, p) for p, port in ports.items() if port.direction == "out"]
        localizer = deployment.member(f"{method.name}_localizer").spec
        for port in ("odom", "scan", "objects", "map", "map_updates"):
            assert topic(localizer, port) == topic(driving, port)
        assert topic(localizer, "visual_map") == f"{method.name}/visual_map"
        assert localizer.parameters["start"] == driving.parameters["start"]
        builder = deployment.member(f"{method.name}_map_builder").spec
        assert topic(builder, "object_evidence") == f"{method.name}/object_evidence"
    assert len(set(published)) == len(published)
    assert all("/" in one for one in published)


def test_shadows_differ_in_parameters_and_files(tmp_path: Path) -> None:
    deployment = deployment_of(SETUP, tmp_path)

    for method in ABLATION[1:]:
        localizer = deployment.member(f"{method.name}_localizer").spec.parameters
        builder = deployment.member(f"{method.name}_map_builder").spec.parameters
        assert method.localizer.items() <= localizer.items()
        assert method.map_builder.items() <= builder.items()
        assert "resume_file" not in localizer
        assert "grid_file" not in builder
    copies = [
        member.spec.parameters["working_copy"]
        for member in deployment.members()
        if member.name.endswith("map_builder")
    ]
    assert len(set(copies)) == len(ABLATION)


def test_driving_method_sets_parameters_of_the_driving_components(tmp_path: Path) -> None:
    deployment = deployment_of(replace(SETUP, driving=PAPER, shadows=()), tmp_path)

    assert deployment.member("localizer").spec.parameters["mode"] == "paper"


def test_without_a_driving_method_scans_alone_drive_the_robot(tmp_path: Path) -> None:
    deployment = deployment_of(replace(SETUP, driving=None, shadows=(NO_UPDATE,)), tmp_path)

    objects = topic(deployment.member("object_recognizer").spec, "objects")
    assert topic(deployment.member("localizer").spec, "objects") != objects
    assert topic(deployment.member("no_update_localizer").spec, "objects") == objects


def test_events_of_the_setup_replace_those_of_the_world(tmp_path: Path) -> None:
    assert first_event_s(SETUP) == 62.0
    move = {"at": 5.0, "move": "object_1", "to": {"x": 0.0, "y": 3.0}}
    setup = replace(SETUP, events=(move, {**move, "at": 3.0}))

    assert first_event_s(setup) == 3.0
    assert len(deployment_of(setup, tmp_path).member("world").spec.parameters["events"]) == 2
    with pytest.raises(CairnError, match="nothing changes in the world"):
        first_event_s(replace(SETUP, events=()))


def test_deployment_without_a_localizer_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "cairn: 1\ncomponents: {report: {plugin: report}}\nexternal_topics: [localization]\n"
    )

    with pytest.raises(CairnError, match=words_in_order("no component localizer")):
        deployment_of(replace(SETUP, deployment=file, overlays=()), tmp_path)
