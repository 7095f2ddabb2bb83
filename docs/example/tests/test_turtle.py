"""The whole deployment, in lockstep: the same components, one thread, virtual time."""

from pathlib import Path

import pytest
from cairn import SECOND
from cairn.deployment.load import load_deployment
from cairn.placement.lockstep_run import LockstepRun

TURTLE = Path(__file__).parents[1] / "deploy" / "turtle.yaml"


def test_the_turtle_wanders_its_way_and_the_deployment_ends() -> None:
    run = LockstepRun(load_deployment(TURTLE, sets=["distance=5"]), seed=1)

    end = run.run(lambda: None)

    assert end.normal
    assert "5.0 m traveled" in end.reason


def test_it_rests_when_its_battery_is_low(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="cairn")
    thirsty = ["components.base.parameters.used_per_m=0.6"]
    run = LockstepRun(load_deployment(TURTLE, sets=thirsty), seed=1)

    def stop_after_a_while() -> None:
        if run.executor.now() > 20 * SECOND:
            run.stop()

    run.run(stop_after_a_while)

    told = [record.getMessage() for record in caplog.records if "wanderer" in record.getMessage()]
    assert told[:3] == ["wanderer active", "wanderer stopped: shut down", "wanderer active"]
