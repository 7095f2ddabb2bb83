"""How long tests wait for an event that has to happen."""

from collections.abc import Iterator

import pytest

LIMIT_S = 120.0
"""Far longer than anything takes, even on a busy machine; only a fault reaches it."""


@pytest.fixture(scope="session", autouse=True)
def patient_devices() -> Iterator[None]:
    """Give device threads and emulators that much time, too, where a conftest imports this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cairn.driver.device_thread._STOP_LIMIT_S", LIMIT_S)
        patch.setattr("cairn.driver.emulator._STOP_TIMEOUT_S", LIMIT_S)
        yield
