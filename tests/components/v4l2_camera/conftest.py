"""Cameras in software for the driver's tests."""

import pytest

from tests.components.v4l2_camera.fakes import LEFT, RIGHT, FakeCamera, FakeCameras


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> FakeCameras:
    return FakeCameras(monkeypatch)


@pytest.fixture
def left(cameras: FakeCameras) -> FakeCamera:
    return cameras.add(LEFT)


@pytest.fixture
def right(cameras: FakeCameras) -> FakeCamera:
    return cameras.add(RIGHT)
