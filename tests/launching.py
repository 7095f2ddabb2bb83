"""What the conformance kit has for users, for the project's own tests: deployments in processes."""

from cairn.testing.launching import (
    CAIRN,
    LIMIT_S,
    Launching,
    Run,
    await_any_end,
    free_port,
    launching,
)

__all__ = ["CAIRN", "LIMIT_S", "Launching", "Run", "await_any_end", "free_port", "launching"]
