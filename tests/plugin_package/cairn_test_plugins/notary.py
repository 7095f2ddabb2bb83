"""A component that writes a file when its work is over."""

from pathlib import Path

from cairn import Component, Config


class NotaryConfig(Config):
    """Where the deed goes."""

    file: str = ""


class Notary(Component):
    """Writes its deed when it is deactivated, as a report is written."""

    config: NotaryConfig

    def on_deactivate(self) -> None:
        """Write it."""
        Path(self.config.file).write_text("done\n", encoding="utf-8")
