"""What the drivers of a recording share: records from a file, published as time passes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pydantic import Field

from cairn.component.component import Component
from cairn.component.parameters import Config, ParameterRefused
from components.mrclam.replay import Records


class RecordingConfig(Config):
    """Which recording."""

    dataset: Path = Field(description="Folder of one MRCLAM data set.")
    robot: int = Field(ge=1, le=5, description="Robot of the data set, 1 to 5 [1].")


class RecordingDriver(Component):
    """What the drivers share: records taken from a file, published as time passes."""

    config: RecordingConfig
    records: Records

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A recording cannot be exchanged under a replay."""
        raise ParameterRefused("a driver takes its recording when it is configured")

    def publish_due(self, publish: Callable[[int], None]) -> None:
        """Have `publish` called with the index of each record whose time has come."""
        due, skipped = self.records.due(self.clock.now())
        if skipped:
            self.log.warning("%d records had passed when this driver began: skipped", skipped)
        for index in due:
            publish(index)
