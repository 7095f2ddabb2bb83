"""A full disk or a read-only folder is reported, and does not end the components."""

import resource
from pathlib import Path

import pytest

from cairn.testing.launching import Launching

pytestmark = pytest.mark.processes


TALK = """
    components:
      listener: {plugin: test_listener}
      talker: {plugin: test_talker}
    """


def no_room() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))  # bytes for each file


@pytest.mark.accuracy
def test_full_disk_for_logs_is_reported_once_and_the_robot_keeps_running(launch: Launching) -> None:
    # Python 3.11 would keep the part of a compiled module that fits, and fail to import it later.
    run = launch(TALK, preexec_fn=no_room, environment={"PYTHONDONTWRITEBYTECODE": "1"})

    run.await_line("listener: received 50")
    assert run.stop() == 0

    run.await_line("^ended.*: shut down")
    warnings = [line for line in run.lines if "root.log cannot be written: File too large" in line]
    assert len(warnings) == 1
    # On a busy computer a process may not be discovered in time, which is a warning.
    others = [line for line in run.lines if "without having discovered" not in line]
    assert not any("Traceback" in line or "WARNING" in line for line in others), run


@pytest.mark.accuracy
def test_report_folder_that_cannot_be_created_is_reported(
    launch: Launching, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    run = launch(TALK, report=tmp_path / "file" / "report")

    assert run.await_end() == 1

    run.await_line(
        "cairn: the report's folder .*/file/report cannot be written: .*Not a directory; "
    )
    assert not any("active" in line for line in run.lines)


@pytest.mark.accuracy
def test_report_that_cannot_be_written_makes_the_run_fail(launch: Launching) -> None:
    run = launch(
        """
    components:
      beacon: {plugin: test_beacon}
      notary: {plugin: test_notary, parameters: {file: "${here}/no/such/folder/deed"}}
      talker: {plugin: test_talker, parameters: {words: 3}, restart: transient, significant: true}
    """
    )

    assert run.await_end() == 1

    run.await_line("child stopped: beacon: shut down")
    run.await_line(
        "cairn: deployment0.yaml failed: .*: notary: deactivate failed: FileNotFoundError: .*/deed"
    )
