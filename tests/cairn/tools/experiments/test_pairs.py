"""Pairs beside those that drive: the same data, and no say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.deployment.model import ChildSpec, Deployment
from cairn.deployment.plugins import load_plugin
from cairn.runtime.ports import ports_of
from cairn.tools.experiments.methods import ABLATION, NO_UPDATE, OURS, PAPER
from cairn.tools.experiments.pairs import Plan, changed_at, planned

DEPLOY = Path(__file__).parents[4] / "deploy"
PLAN = Plan(DEPLOY / "sim.yaml", (DEPLOY / "experiment.yaml",), (), OURS, ABLATION[1:])


def made(plan: Plan, folder: Path) -> Deployment:
    return planned(plan, folder, folder)


def topic(spec: ChildSpec, port: str) -> str:
    return spec.topics.get(port, port)


def test_all_pairs_read_the_same_sensors_and_write_topics_of_their_own(tmp_path: Path) -> None:
    deployment = made(PLAN, tmp_path)

    drives = deployment.member("localizer").spec
    written: list[str] = []
    for method in ABLATION[1:]:
        for kind in ("localizer", "map_builder"):
            spec = deployment.member(f"{method.name}_{kind}").spec
            ports = ports_of(load_plugin(spec.plugin))
            written += [topic(spec, p) for p, its in ports.items() if its.direction == "out"]
        localizer = deployment.member(f"{method.name}_localizer").spec
        for port in ("odom", "scan", "objects", "map", "map_updates"):
            assert topic(localizer, port) == topic(drives, port)
        assert topic(localizer, "visual_map") == f"{method.name}/visual_map"
        assert localizer.parameters["start"] == drives.parameters["start"]
        builder = deployment.member(f"{method.name}_map_builder").spec
        assert topic(builder, "object_evidence") == f"{method.name}/object_evidence"
    assert len(set(written)) == len(written)
    assert all("/" in one for one in written)


def test_pairs_differ_in_what_their_methods_say_and_in_their_files(tmp_path: Path) -> None:
    deployment = made(PLAN, tmp_path)

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
        if member.spec.plugin == "map_builder"
    ]
    assert len(set(copies)) == len(ABLATION)


def test_the_pair_that_drives_is_told_its_method_too(tmp_path: Path) -> None:
    deployment = made(replace(PLAN, driving=PAPER, shadows=()), tmp_path)

    assert deployment.member("localizer").spec.parameters["mode"] == "paper"


def test_without_a_method_the_robot_drives_by_scans_alone(tmp_path: Path) -> None:
    deployment = made(replace(PLAN, driving=None, shadows=(NO_UPDATE,)), tmp_path)

    sightings = topic(deployment.member("object_recognizer").spec, "objects")
    assert topic(deployment.member("localizer").spec, "objects") != sightings
    assert topic(deployment.member("no_update_localizer").spec, "objects") == sightings


def test_events_replace_those_of_the_world(tmp_path: Path) -> None:
    assert changed_at(PLAN) == 62.0
    move = {"at": 5.0, "move": "object_1", "to": {"x": 0.0, "y": 3.0}}
    plan = replace(PLAN, events=(move, {**move, "at": 3.0}))

    assert changed_at(plan) == 3.0
    assert len(made(plan, tmp_path).member("world").spec.parameters["events"]) == 2
    with pytest.raises(CairnError, match="nothing is changed in the world"):
        changed_at(replace(PLAN, events=()))


def test_a_deployment_without_a_map_builder_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "cairn: 1\ncomponents: {report: {plugin: report}}\nexternal_topics: [localization]\n"
    )

    with pytest.raises(CairnError, match="the deployment has no component localizer"):
        made(replace(PLAN, deployment=file, overlays=()), tmp_path)
