"""Drivers with wrong messages fail the tests for their fault, and no others.

They run in virtual time, so a busy computer has no effect; the contracts' own tests judge.
"""

from pathlib import Path

import pytest

from cairn import Component
from cairn.testing.base_contract import SafetyContract
from cairn.testing.camera_contract import PicturesContract
from cairn.testing.lockstep import ComponentHarness
from cairn.testing.scanner_contract import ScanContract
from tests.cairn.testing.broken import bases, cameras, scanners
from tests.cairn.testing.broken.sampling import arrivals, drive, failures_of, pictures

SECONDS = 0.8  # of scans and of pictures: sixteen

SCANNERS: dict[type[Component], dict[str, str]] = {
    scanners.CorrectScanner: {},
    scanners.Millimeters: {
        "test_ranges_are_within_limits": "are these millimeters?",
        "test_surroundings_are_measured_correctly": "a thousand times as far",
    },
    scanners.MillimeterLimits: {
        "test_limits_are_in_meters": "are these millimeters?",
        "test_surroundings_are_measured_correctly": "a thousand times as far",
    },
    scanners.Clockwise: {"test_surroundings_are_measured_correctly": "on the other side"},
    scanners.Degrees: {
        "test_angle_fields_agree_with_the_number_of_beams": "are these degrees?",
        "test_surroundings_are_measured_correctly": "m are measured",
    },
    scanners.TooFar: {"test_ranges_are_within_limits": "such as 65.533 m"},
    scanners.StampedWhenSent: {"test_stamp_is_of_the_first_beam": "of the measurement's beginning"},
    scanners.StampsJump: {"test_stamps_increase_regularly": "intervals between stamps differ"},
    scanners.StampsOfAnotherClock: {
        "test_stamps_are_current": "of another clock",
        "test_stamp_is_of_the_first_beam": "of another clock",
    },
    scanners.OtherFrame: {"test_frame_id_is_as_configured": "'/laser_link'"},
    scanners.EveryOther: {"test_rate_is_nominal": "10.0"},
}
CAMERAS: dict[type[Component], dict[str, str]] = {
    cameras.CorrectCamera: {},
    cameras.StampsDiffer: {"test_messages_of_a_pair_have_the_same_stamp": "have the same stamp"},
    cameras.SwappedSides: {"test_baseline_is_positive": "are the sides swapped?"},
    cameras.SwappedSizes: {
        "test_image_sizes_equal_those_of_the_calibration": "width and height are swapped"
    },
    cameras.Frozen: {"test_images_are_not_frozen": "identical"},
    cameras.WrongEncoding: {"test_images_are_complete": "'GREY'"},
    cameras.InfosLate: {"test_infos_precede_their_images": "before their camera info"},
}
BASES: dict[type[Component], dict[str, str]] = {
    bases.CorrectBase: {},
    bases.NeverStops: {"test_base_stops_when_commands_stop": "still moves"},
    bases.RightIsLeft: {"test_left_command_turns_left": "-0.5"},
    bases.TwistInDegrees: {
        "test_left_command_turns_left": "28.6",
        "test_twist_agrees_with_pose": "rad/s",
    },
    bases.TransformLags: {"test_tf_agrees_with_odometry": "off the position of odometry"},
}


class Scans(ScanContract):
    rate_hz = scanners.RATE_HZ
    surroundings = scanners.SURROUNDINGS


class Images(PicturesContract):
    rate_hz = cameras.RATE_HZ


class Drives(SafetyContract):
    rate_hz = bases.RATE_HZ


@pytest.mark.parametrize("driver", SCANNERS)
def test_broken_scanner_fails_the_tests_for_its_fault(
    driver: type[Component], tmp_path: Path
) -> None:
    device = tmp_path / "device"
    device.touch()
    harness = ComponentHarness(driver, {"device": str(device)})
    harness.run_for(SECONDS)

    check_failures(failures_of(Scans(), scans=arrivals(harness)["scan"]), SCANNERS[driver])


@pytest.mark.parametrize("driver", CAMERAS)
def test_broken_camera_fails_the_tests_for_its_fault(driver: type[Component]) -> None:
    seen = pictures(ComponentHarness(driver), SECONDS)

    check_failures(failures_of(Images(), pictures=seen), CAMERAS[driver])


@pytest.mark.parametrize("driver", BASES)
def test_broken_base_fails_the_tests_for_its_fault(driver: type[Component]) -> None:
    driven = drive(ComponentHarness(driver), Drives)

    check_failures(failures_of(Drives(), drive=driven), BASES[driver])


def check_failures(failures: dict[str, str], expected: dict[str, str]) -> None:
    assert failures.keys() == expected.keys(), failures
    for test, words in expected.items():
        assert words in failures[test], failures[test]
