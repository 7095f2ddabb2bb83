"""The zygote of a deployment in real processes: its folder, and what it logs."""

from pathlib import Path
from textwrap import dedent

import pytest

from cairn.testing.launching import Launching

pytestmark = pytest.mark.processes


def test_zygote_that_crashes_fails_the_deployment_with_the_cause_and_its_log_is_kept(
    launch: Launching, tmp_path: Path
) -> None:
    module = """
        from cairn import Component
        from cairn.supervision.zygote import Zygote

        def fail(*_):
            raise RuntimeError("broken on purpose")

        Zygote._spawn = fail

        class Idle(Component):
            pass
        """
    (tmp_path / "breaks_zygote.py").write_text(dedent(module))
    run = launch(
        "components: {idle: {plugin: breaks_zygote:Idle}}",
        environment={"PYTHONPATH": str(tmp_path)},
    )

    assert run.await_end() == 1

    run.await_line(
        "failed: the zygote ended, and with it every component: exit code 1: RuntimeError: broken "
        rf"on purpose \(process \d+, log {run.logs}/zygote.log\)"
    )
    assert "Traceback" in run.log_of("zygote")
