"""Cameras in software for the driver's tests."""

import pytest

from tests.components.v4l2_camera.fakes import FakeCameras


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> FakeCameras:
    return FakeCameras(monkeypatch)
