"""What all tests may use: the project's own conformance kit, as users have it."""

import os

pytest_plugins = ["cairn.testing.plugin"]


def pytest_configure() -> None:
    """Have the programs that tests start keep what they compile of Cairn, as they do by default.

    Where Python is told not to, each of hundreds of processes would compile all modules anew.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
