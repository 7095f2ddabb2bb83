"""A component that writes a file when it is deactivated."""

from pathlib import Path

from cairn import Component, Config


class NotaryConfig(Config):
    """The file to write."""

    file: str = ""


class Notary(Component):
    """Writes its file when it is deactivated, as the report component does."""

    config: NotaryConfig

    def on_deactivate(self) -> None:
        """Write the file."""
        Path(self.config.file).write_text("done\n", encoding="utf-8")
