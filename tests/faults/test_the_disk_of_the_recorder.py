"""A disk that fills while a robot records: the robot continues, and so does the recording."""

import json
import resource
from pathlib import Path

import pytest

from cairn.recording.reader import McapRecording
from cairn.testing.launching import Launching
from tests.commands import cairn
from tests.wording import assert_words

pytestmark = pytest.mark.processes

TALK = """
    components:
      listener: {plugin: test_listener}
      talker: {plugin: test_talker}
    """


def limit_files(pid: int, size: int) -> None:
    """Have a process not write beyond `size` [bytes] of any file, as on a full disk."""
    _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, most))


def words_in(recording: Path) -> list[int]:
    with McapRecording(recording) as opened:
        return [one.sequence for one in opened.messages() if one.channel.topic == "/robot/words"]


@pytest.mark.accuracy
def test_recording_continues_when_the_disk_has_space_again(launch: Launching) -> None:
    run = launch(TALK, "--record")
    recording = run.report / "recording.mcap"
    run.await_line("listener: received 20")

    full = recording.stat().st_size
    limit_files(run.pid_of("recorder"), full)
    interrupted = run.await_line(
        "ERROR .*recorder: recording interrupted: .*/recording.mcap: nothing can be written: "
        ".*File too large.* continues when that is solved"
    )
    before = words_in(recording)
    assert before == list(range(1, len(before) + 1))
    assert 0 < recording.stat().st_size <= full
    at_least = len(before) // 10 * 10 + 20
    run.await_line(f"listener: received {at_least}")  # the robot continues
    status = cairn("recorder", "status", "--json", connect=run.endpoint)
    assert_words(json.loads(status.out)["problem"], "recording.mcap", "nothing can be written")

    limit_files(run.pid_of("recorder"), resource.RLIM_INFINITY)
    run.await_line("recorder: recording continues", after=interrupted)
    run.await_line(f"listener: received {at_least + 20}")
    assert run.stop() == 0

    with McapRecording(recording) as opened:
        assert not opened.notes
        losses = opened.metadata.get("cairn_losses", {})
    assert not {name for name in losses if name.startswith("dropped")}
    words = words_in(recording)
    assert words == list(range(1, len(words) + 1))
    assert len(words) >= at_least + 20
    assert not [line for line in run.lines if "restarting child" in line or "child failed" in line]
