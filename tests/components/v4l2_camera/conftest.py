"""Fixtures: fake cameras for tests of the driver."""

import pytest

from tests.components.v4l2_camera.fake_cameras import LEFT, RIGHT, FakeCamera, FakeCameras


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> FakeCameras:
    return FakeCameras(monkeypatch)


@pytest.fixture
def left(cameras: FakeCameras) -> FakeCamera:
    return cameras.add(LEFT)


@pytest.fixture
def right(cameras: FakeCameras) -> FakeCamera:
    return cameras.add(RIGHT)
