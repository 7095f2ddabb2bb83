"""What the extras of the package install, and what is missing without them."""

import sys

import pytest

from cairn.system.extras import extras, missing_libraries, missing_library, robot_extras


def test_robot_has_the_libraries_of_planning_vision_pictures_and_certificates() -> None:
    assert set(robot_extras()) == {"navigation", "plots", "security"}
    assert {"cv2", "numba", "PIL"} <= set(extras()["navigation"])


def test_library_that_is_missing_is_of_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    error = ModuleNotFoundError("No module named 'scipy.spatial'", name="scipy.spatial")

    assert missing_library(error) == ("scipy", "pip install 'cairn-robotics[navigation]'")
    assert missing_library(ModuleNotFoundError("other", name="other")) is None
    assert missing_library(ValueError("scipy")) is None

    monkeypatch.setattr(sys, "path", [])
    monkeypatch.delitem(sys.modules, "gtsam", raising=False)  # another test has imported it
    assert "gtsam" in missing_libraries("navigation")
