"""A component whose run takes milliseconds: it writes a few random numbers, and has finished."""

import os
from pathlib import Path

from pydantic import Field

from cairn import Component, Config, ReadPath, every


class ClerkConfig(Config):
    """What the component reads and writes."""

    file: Path = Field(description="File that is written.")
    source: ReadPath | None = Field(None, description="File whose content is copied into it.")
    steps: int = Field(2, ge=1, description="Number of random numbers [1].")
    writes_process: bool = Field(
        False, description="Whether the number of the process is written: no two runs are equal."
    )


class Clerk(Component):
    """Writes random numbers, one each second, and ends the deployment."""

    config: ClerkConfig

    def on_activate(self) -> None:
        """Begin with the content of the source."""
        source = self.config.source
        self.lines = [] if source is None else source.read_text(encoding="utf-8").splitlines()

    @every(hz=1)
    def step(self) -> None:
        """Write a number; after the last one finish."""
        self.lines.append(str(self.random.random()))
        if len(self.lines) < self.config.steps:
            return
        if self.config.writes_process:
            self.lines.append(str(os.getpid()))
        self.log.info("wrote %s", self.config.file)
        self.config.file.write_text("\n".join(self.lines), encoding="utf-8")
        self.finish("all is written")
