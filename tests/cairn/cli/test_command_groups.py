"""Groups of commands: those of packages that may not be installed."""

import pytest
import typer

from cairn import CairnError
from cairn.cli.command_groups import lazy_group


def test_command_of_a_missing_package_names_the_package() -> None:
    group = lazy_group(entry_points="cairn.empty_group", packages={"campaign": "cairn-lab"})
    app = typer.Typer(cls=group)
    app.callback()(lambda: None)

    with pytest.raises(CairnError, match="cairn-lab has the command campaign; `pip install"):
        app(["campaign", "sim"], standalone_mode=False)
