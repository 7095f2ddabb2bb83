"""Records a launch of the deployment, and finds what of a recording can be re-run."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path

from cairn.errors import CairnError
from cairn.recording.reader import McapRecording
from cairn.recording.recorder import McapRecorder, RecorderSettings
from cairn.recording.run_attachments import MessageClasses, run_attachments, started_parameters
from cairn.recording.tap import ZenohTap
from cairn.rerun.files import input_attachments
from cairn.rerun.run import starts_in
from cairn.rerun.streamed_messages import needed_messages
from cairn_lab.campaign.robot import CampaignRobot


class LaunchRecording:
    """Records one launch: all of it, or the last seconds before each trigger."""

    def __init__(
        self, robot: CampaignRobot, settings: RecorderSettings, path: Path,
        attachments: Mapping[str, bytes],
    ) -> None:  # fmt: skip
        """Start; the file is `path`, or a numbered name beside it. Raises `CairnError`."""
        deployment = robot.deployment
        find = MessageClasses(deployment).find
        self._recorder = McapRecorder(
            settings, path, attachments, find, robot=deployment.robot.name
        )
        connection = robot.client.connection
        self._tap = ZenohTap(
            connection.session, connection.domain, self._recorder.receive, self._recorder.topics
        )
        self._recorder.start(self._tap)

    def keep(self, reason: str) -> str:
        """Write what was recorded; return the name of the file, "" if the disk does not take it."""
        if not self._recorder.continuous:
            self._recorder.trigger(reason)
        files = self._recorder.status().files
        return files[-1].name if files else ""

    def close(self) -> None:
        """End the recording and close its file."""
        self._tap.close()
        self._recorder.close()


def attachments_of(robot: CampaignRobot) -> dict[str, bytes]:
    """Return what is attached to the recordings of a deployment; this imports its plugins."""
    deployment = robot.deployment
    return {
        **run_attachments(deployment, started_parameters(deployment), seed=0, lockstep=False),
        **input_attachments(deployment),
    }


def rerun_command(path: Path) -> str:
    """Return the command that re-runs what a recording holds completely; "" if there is nothing.

    A component whose start it does not hold, because it holds only the last seconds, is left out.
    """
    try:
        with McapRecording(path) as recording:
            found = {
                start.component: None
                for start in starts_in(recording)
                if start.started_ns >= recording.start_ns
                and not start.missing
                and needed_messages(start).publishes
            }
    except CairnError:  # cut off before its first message
        return ""
    names = [word for name in found for word in ("--component", name)]
    return shlex.join(["cairn", "rerun", str(path), *names]) if names else ""
