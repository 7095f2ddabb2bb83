"""The component Recorder: records its deployment, from the first message to the last."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import Field

from cairn import CairnError, Component, every
from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.model import Deployment
from cairn.recording.recorder import McapRecorder, RecorderSettings
from cairn.recording.run_attachments import MessageClasses, run_attachments, started_parameters
from cairn.recording.tap import LockstepTap, Tap, ZenohTap
from cairn.rerun.files import input_attachments

_LONGEST_REASON = 200  # characters


class RecorderConfig(RecorderSettings):
    """Parameters of the recorder."""

    file: Path = Field(
        description="The first file, in a folder that exists; further ones are NAME_2.mcap, "
        "NAME_3.mcap ... An existing file is never replaced."
    )


class Recorder(Component):
    """Records the topics of the bus to MCAP files. As first component it misses nothing.

    Requests: `trigger` (with `reason`, if it keeps only the last seconds), `split`, `pause`,
    `resume`, `status`. Whatever happens to its disk, it fails no other component.

    The file has a channel for each topic and publisher, with the metadata `node`, `gid`,
    `type_hash`, `offered_qos_profiles` and `latched`. A message's `sequence` counts the publisher's
    messages from 1; `publish_time` is when it was sent, `log_time` when it arrived, at most 20 ms
    late. Schemas are `ros2msg`, empty for a type that Cairn does not know. Attachments:
    `deployment.json`, `parameters.json`, `run.json` (seed, robot, domain), `versions.json`.
    Metadata: `cairn` (version of this format; trigger), `cairn_losses`.
    """

    live_parameters = frozenset()
    config: RecorderConfig
    clock_source = "system"
    request_roles = MappingProxyType(
        {
            "trigger": "operate",
            "split": "operate",
            "pause": "operate",
            "resume": "operate",
            "status": "view",
        }
    )

    _recorder: McapRecorder | None = None
    _tap: Tap | None = None

    def on_configure(self) -> None:
        """Create the file and open the tap, before other components start."""
        launch = self._context.launch
        run, bus = launch.context, self._context.bus
        deployment = Deployment.model_validate_json(run.deployment) if run.deployment else None
        attachments = (
            {}
            if deployment is None
            else {
                **run_attachments(
                    deployment,
                    started_parameters(deployment),
                    seed=run.seed,
                    lockstep=run.lockstep,
                ),
                **input_attachments(deployment),
            }
        )
        recorder = McapRecorder(
            self.config,
            self.config.file,
            attachments,
            MessageClasses(deployment).find,
            robot=run.robot,
            now=self.clock.now,
            threaded=not run.lockstep,
            adopt_files=True,
            log=self.log,
        )
        if isinstance(bus, ZenohBus):
            tap: Tap = ZenohTap(
                bus.session, bus.domain, recorder.receive, recorder.topics, is_client=False
            )
        else:
            assert isinstance(bus, LockstepBus)
            tap = LockstepTap(bus, self.clock.now, recorder.receive, recorder.topics)
        self._tap, self._recorder = tap, recorder
        recorder.start(tap)

    def on_cleanup(self) -> None:
        """Write what waits, and close the file."""
        self._close()

    def on_shutdown(self) -> None:
        """Close the file if it could not be configured completely."""
        self._close()

    def on_error(self, _: Exception) -> bool:
        """Close the file; a restart continues in another one."""
        self._close()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Trigger, split, pause, resume, or return the status."""
        recorder = self._recorder
        allowed = {"reason"} if verb == "trigger" else set()
        if recorder is None or not set(arguments) <= allowed:
            return super().on_request(verb, arguments)
        if verb == "trigger":
            reason = str(arguments.get("reason", "by request"))
            recorder.trigger(reason[:_LONGEST_REASON])
        elif verb == "split":
            recorder.split()
        elif verb == "pause":
            recorder.pause()
        elif verb == "resume":
            recorder.resume()
        elif verb != "status":
            return super().on_request(verb, arguments)
        return recorder.status().as_plain()

    @every(hz=1)
    def report(self) -> None:
        """Show in the status what is recorded and what is missing."""
        recorder = self._recorder
        if recorder is None:
            return
        if recorder.failure is not None:
            raise CairnError(f"recording failed: {recorder.failure}") from recorder.failure
        self.report_state(recorder.status().text())

    def _close(self) -> None:
        recorder, tap = self._recorder, self._tap
        self._recorder = self._tap = None
        if tap is not None:
            tap.close()
        if recorder is not None:
            status = recorder.close()
            self.log.info("recording closed: %s", status.text())
