"""Controls set while the driver runs: on both cameras or none, and not while automatic."""

from __future__ import annotations

import pytest

from cairn import ParameterRejected
from tests.components.v4l2_camera.driver import Driver
from tests.components.v4l2_camera.fake_cameras import ONE, TWO, FakeCamera
from tests.wording import assert_words, words_in_order


@pytest.mark.parametrize("given", [{"gain": 10}, {}])
def test_controls_are_set_on_both_cameras_or_on_none(
    left: FakeCamera, right: FakeCamera, given: dict[str, int]
) -> None:
    right.rejected_values.add(66)
    with Driver(**TWO, controls=given) as driver:
        with pytest.raises(ParameterRejected, match="/dev/right: setting gain = 66"):
            driver.set(controls__gain=66)

        assert (left.values["gain"], right.values["gain"]) == (10, 10)
        driver.set(controls__gain=55)
        assert (left.values["gain"], right.values["gain"]) == (55, 55)
        with pytest.raises(ParameterRejected, match=words_in_order("gain = 256", "0 to 255")):
            driver.set(controls__gain=256)


def test_automatic_control_is_set_once_it_is_manual(
    left: FakeCamera, caplog: pytest.LogCaptureFixture
) -> None:
    left.inactive.add("exposure_time_absolute")
    with Driver(**ONE, controls={"exposure_time_absolute": 7}) as driver:
        assert left.values["exposure_time_absolute"] == 100
        assert_words(caplog.text, "exposure_time_absolute", "automatically", "7")

        left.inactive.clear()
        driver.set(controls__gain=9)

        assert left.values == {"gain": 9, "exposure_time_absolute": 7}


def test_controls_changed_by_another_program_are_restored(left: FakeCamera) -> None:
    with Driver(**ONE, controls={"gain": 9}) as driver:
        driver.request("deactivate")
        left.values["gain"] = 200
        driver.request("activate")
        left.send(1)
        driver.await_one("left_image")

    assert left.values["gain"] == 9
