"""The root of a deployment in real processes: its zygote, its view, and what they log."""

from pathlib import Path
from textwrap import dedent
from unittest.mock import Mock

import pytest

from cairn.placement.process_run import _Monitor
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


def test_view_that_fails_is_logged_once_and_does_not_stop_the_robot(
    caplog: pytest.LogCaptureFixture,
) -> None:
    view, zygote, loop = Mock(), Mock(stopped=False), Mock()
    zygote.process.poll.return_value = None
    view.refresh.side_effect = OSError("Input/output error")  # its terminal is gone
    monitor = _Monitor(view, zygote, loop)
    for _ in range(3):
        monitor.check()
    monitor.finish()

    assert view.refresh.call_count == 1
    assert not loop.stop.called
    assert caplog.text.count("view ended: OSError: Input/output error") == 1
