"""The root of a deployment in real processes: its zygote, its view, and what they log."""

from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from cairn import CairnError
from cairn.bus.control import ControlServer, answering
from cairn.bus.credentials import NO_CREDENTIALS
from cairn.bus.session import open_client
from cairn.processes import process_run
from cairn.processes.process_run import _Monitor
from cairn.testing.launching import Launching
from tests.cairn.bus.network import Network, eventually, fail_test
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


@pytest.mark.accuracy
def test_zygote_that_crashes_fails_the_deployment_with_the_cause_and_its_log_is_kept(
    launch: Launching, tmp_path: Path
) -> None:
    module = """
        from cairn import Component
        from cairn.processes.zygote import Zygote

        spawn = Zygote._spawn

        def fail(self, connection, request):
            if request.name == "idle":
                raise RuntimeError("broken on purpose")
            spawn(self, connection, request)

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


def test_root_does_not_import_the_components(launch: Launching, tmp_path: Path) -> None:
    module = """
        import os
        from pathlib import Path
        from cairn import Component

        with Path(__file__).with_suffix(".pids").open("a") as pids:
            pids.write(f"{os.getpid()}\\n")

        class Idle(Component):
            pass
        """
    (tmp_path / "notes_imports.py").write_text(dedent(module))
    run = launch(
        "components: {idle: {plugin: notes_imports:Idle}}",
        environment={"PYTHONPATH": str(tmp_path)},
    )
    run.await_line("child active: idle")

    importers = (tmp_path / "notes_imports.pids").read_text().split()

    assert len(importers) == 1  # the zygote
    assert importers != [str(run.process.pid)]


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


def test_robots_name_is_taken_by_an_answer_and_not_by_a_ghost_token(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network = Network()
    try:
        joining: Any = SimpleNamespace(
            robot=SimpleNamespace(name="robot"),
            domain=0,
            bus=SimpleNamespace(connect=(network.endpoint,), credentials=NO_CREDENTIALS),
        )
        bus = network.bus()
        ghost = bus.node("/robot/root", fail_test)
        assert eventually(lambda: bool(network.graph()))
        process_run._check_robot_name_is_free(joining)

        monkeypatch.setattr(process_run, "_ANSWER_LIMIT_S", LIMIT_S)
        server = ControlServer(bus.session, 0, "/robot/base", lambda call: call(), lambda *_: None)
        with open_client([network.endpoint]) as client:
            assert eventually(lambda: any(answering(client, 0, "robot", 1.0)))
        with pytest.raises(CairnError, match="robot robot runs already"):
            process_run._check_robot_name_is_free(joining)
        server.close()
        ghost.close()
    finally:
        network.close()
