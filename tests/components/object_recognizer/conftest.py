"""Fixtures: a map with object models, a recognizer with cameras, cached features of images."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.components.object_recognizer import component, finder, recognize_cli
from cairn.components.object_recognizer.component import ObjectRecognizer
from cairn.schemas.cairn_msgs import RecognizedObjectArray
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.testing.lockstep import ComponentHarness
from cairn.vision import teaching
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import add_views
from cairn.visual_map.sqlite_file import create
from tests.cairn.vision.extracted import CachedExtract
from tests.components.object_recognizer.scenes import (
    SIZE,
    Thing,
    info,
    message,
    pair,
    picture_of,
)

BEGIN_S = 1000.0


class Robot:
    """A recognizer that receives an image every 0.2 s."""

    def __init__(self, recognizer: ComponentHarness[ObjectRecognizer]) -> None:
        self.recognizer = recognizer
        self._noise = 0

    @property
    def now_s(self) -> float:
        return self.recognizer.now

    def calibrate(self, left: CameraInfo | None = None, right: CameraInfo | None = None) -> Robot:
        """Send it the cameras' calibrations, by default those of `scenes`."""
        self.recognizer.publish("left_info", left or info())
        self.recognizer.publish("right_info", right or info(right=True))
        return self

    def show(
        self,
        left: NDArray[np.generic] | None,
        right: NDArray[np.generic] | None = None,
        encoding: str = "mono8",
    ) -> RecognizedObjectArray | None:
        """Send it a pair of images; return what it publishes, None if it publishes nothing."""
        self.recognizer.run_for(0.2)
        self.recognizer.take("objects")
        if left is not None:
            self.recognizer.publish("left_image", message(left, self.now_s, encoding))
        if right is not None:
            self.recognizer.publish("right_image", message(right, self.now_s, encoding))
        published = self.recognizer.take("objects")
        assert len(published) <= 1
        return published[0] if published else None

    def see(self, things: Sequence[Thing]) -> RecognizedObjectArray:
        """Send it images of these things from both cameras; return what it publishes."""
        self._noise += 1
        published = self.show(*pair(things, self._noise))
        assert published is not None
        return published


@pytest.fixture(scope="session")
def extracted() -> CachedExtract:
    return CachedExtract()


@pytest.fixture
def uncached() -> None:
    """Switch the cache off, for tests of repeatability."""


@pytest.fixture(autouse=True)
def extracted_once(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, extracted: CachedExtract
) -> None:
    """Extract the features of each image once: otherwise extraction would dominate the tests.

    Extraction itself, and its repeatability, is tested in tests/cairn/vision.
    """
    if "uncached" not in request.fixturenames:
        for user in (component, finder, recognize_cli, teaching):
            monkeypatch.setattr(user, "extract", extracted)


@pytest.fixture(scope="session")
def taught_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the map of `map_file`, to be copied only: teaching takes most of a second."""
    path = tmp_path_factory.mktemp("taught") / "a.cairn"
    create(path, "a test").close()
    for seed in (1, 2, 3):
        add_views(path, f"poster {seed}", [make_view(picture_of(seed))], SIZE if seed < 3 else None)
    return path


@pytest.fixture
def map_file(taught_map: Path, tmp_path: Path) -> Path:
    """Return a map with models of objects 1, 2 and 3, the last one without its size."""
    return Path(shutil.copy(taught_map, tmp_path))


@pytest.fixture
def robot(map_file: Path) -> Callable[..., Robot]:
    def start(**parameters: Any) -> Robot:
        parameters = {"map_file": str(map_file), **parameters}
        return Robot(ComponentHarness(ObjectRecognizer, parameters, start_s=BEGIN_S))

    return start


@pytest.fixture
def logged(caplog: pytest.LogCaptureFixture) -> Callable[[], str]:
    """Return all messages logged so far."""
    caplog.set_level(logging.INFO)
    return lambda: caplog.text


@pytest.fixture
def warnings(caplog: pytest.LogCaptureFixture) -> Callable[[], str]:
    """Return the warnings logged so far."""
    return lambda: "\n".join(
        record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING
    )
