"""The folders of a user for settings, states and what can be computed again.

They are those of the XDG Base Directory Specification.
"""

import os
from pathlib import Path


def config_folder(name: str) -> Path:
    """Return a program's folder for settings."""
    return _folder("XDG_CONFIG_HOME", ".config") / name


def state_folder(name: str) -> Path:
    """Return a program's folder for what it keeps from one run to the next."""
    return _folder("XDG_STATE_HOME", ".local/state") / name


def cache_folder(name: str) -> Path:
    """Return a program's folder for what can be computed again."""
    return _folder("XDG_CACHE_HOME", ".cache") / name


def _folder(variable: str, default: str) -> Path:
    given = Path(os.environ.get(variable, ""))
    return given if given.is_absolute() else Path.home() / default
