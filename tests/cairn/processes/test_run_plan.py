"""The plan of a run passes from the process that makes it to the root without a change."""

import json
from pathlib import Path

from cairn.deployment.load import read_sources
from cairn.deployment.shipped import deployment_file
from cairn.processes.run_plan import (
    PLAN,
    REQUEST,
    PlanRequest,
    check_and_plan,
    check_for_root,
)


def test_plan_is_the_same_after_its_way_as_json(tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.touch(mode=0o600)
    password.write_text("correct horse\n")
    file = deployment_file("sim")
    sets = [
        "bus.listen=[tcp/127.0.0.1:7447]",
        f"bus.users={{anna: {{role: view, password_file: {password}}}}}",
    ]
    request = PlanRequest(file, read_sources(file), sets)
    argument = REQUEST.dump_python(request, mode="json")

    result = check_for_root(json.loads(json.dumps(argument)))
    plan = PLAN.validate_python(json.loads(json.dumps(result)))

    assert plan == check_and_plan(request)
    assert plan.gateway is not None
