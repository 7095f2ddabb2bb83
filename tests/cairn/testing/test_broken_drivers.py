"""Each broken driver is found by the tests that are meant for its mistake, and by no others."""

import sys
from collections.abc import Sequence
from pathlib import Path
from subprocess import run
from xml.etree import ElementTree

import pytest

pytestmark = pytest.mark.realtime

BROKEN = Path(__file__).parent / "broken"
ROOT = Path(__file__).parents[3]

SCANS = {
    "SoundScanner": {},
    "Millimetres": {
        "test_ranges_are_within_limits": "are these millimetres?",
        "test_surroundings_are_seen_where_they_are": "a thousand times as far",
    },
    "MillimetreLimits": {
        "test_limits_are_in_metres": "are these millimetres?",
        "test_surroundings_are_seen_where_they_are": "a thousand times as far",
    },
    "Clockwise": {"test_surroundings_are_seen_where_they_are": "on the other side"},
    "Degrees": {
        "test_angles_agree": "are these degrees?",
        "test_surroundings_are_seen_where_they_are": "m are measured",
    },
    "TooFar": {"test_ranges_are_within_limits": "such as 65.533 m"},
    "StampedWhenSent": {"test_stamp_is_of_the_first_beam": "of the measurement's beginning"},
    "StampsJump": {"test_stamps_increase_regularly": "spacings of stamps are off"},
    "StampsOfAnotherClock": {
        "test_stamps_are_of_the_present": "of another clock",
        "test_stamp_is_of_the_first_beam": "of another clock",
    },
    "OtherFrame": {"test_frame": "'/laser_link'"},
    "EveryOther": {"test_rate": "10.0"},
}
LIFE = {
    "SoundScanner": {},
    "NeverSilent": {"test_inactive_it_publishes_nothing": "although it is inactive"},
    "LeaksThreads": {"test_cycles_leak_no_threads": "threads after"},
    "LeaksFiles": {"test_cycles_leak_no_files": "files after"},
    "LeaksMemory": {"test_cycles_leak_no_memory": "memory after"},
    "Unbounded": {"test_each_parameter_is_described_and_bounded": "parameter power"},
    "HangsAtItsEnd": {"test_it_stops_in_good_order": "did not stop by itself"},
    "DiesUnplugged": {"test_unplugged_it_lives_and_says_so": "was started anew"},
    "SilentUnplugged": {"test_unplugged_it_lives_and_says_so": "says nothing"},
    "RepeatsUnplugged": {
        "test_unplugged_it_lives_and_says_so": "without its device",
        "test_plugged_in_again_it_works": "not silent",
    },
    "NeverReturns": {"test_plugged_in_again_it_works": "2 messages; 0 came"},
}
CAMERAS_AND_BASES = {
    "SoundCamera": {},
    "StampsDiffer": {"test_messages_of_a_pair_have_one_stamp": "have the same stamp"},
    "SwappedSides": {"test_right_is_right": "are the sides swapped?"},
    "SwappedSizes": {"test_sizes_are_those_of_the_calibration": "width and height are swapped"},
    "Frozen": {"test_images_are_not_frozen": "bit by bit"},
    "WrongEncoding": {"test_images_are_whole": "'GREY'"},
    "InfosLate": {"test_infos_come_before_their_images": "before their camera info"},
    "SoundBase": {},
    "NeverStops": {
        "test_it_stops_when_commands_cease": "it still moves",
    },
    "RightIsLeft": {"test_left_is_left": "-0.5"},
    "Unlimited": {"test_speed_is_limited": "its limit is 0.5 m/s"},
    "TwistInDegrees": {
        "test_left_is_left": "28.6",
        "test_twist_agrees_with_pose": "rad/s",
    },
    "TransformLags": {"test_tf_agrees_with_odometry": "off where odometry has it"},
}


@pytest.mark.timeout(300)  # of half a minute each, where the machine has nothing else to do
@pytest.mark.parametrize(
    ("contracts", "expected"),
    [
        ("scan_contracts.py", SCANS),
        ("life_contracts.py", LIFE),
        ("camera_and_base_contracts.py", CAMERAS_AND_BASES),
    ],
)
def test_each_is_found_by_the_tests_for_its_mistake(
    contracts: str, expected: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    failures = failures_of(contracts, tmp_path / "results.xml")
    # A busy machine may hold up a driver for longer than its made-up device waits: once more, then.
    others = [driver for driver in expected if set(failures[driver]) != set(expected[driver])]
    if others:
        failures |= failures_of(contracts, tmp_path / "again.xml", others)

    named = {driver: set(failed) for driver, failed in failures.items()}
    for driver, failed in expected.items():
        assert named[driver] == set(failed), f"{driver}: {failures[driver]}"
        for test, words in failed.items():
            assert words in failures[driver][test], f"{driver}.{test}: {failures[driver][test]}"
    assert named.keys() == expected.keys()


def failures_of(
    contracts: str, results: Path, drivers: Sequence[str] = ()
) -> dict[str, dict[str, str]]:
    """Run the tests of a file as a user does; messages of those that failed, by driver and test.

    Of these drivers alone, if any are named.
    """
    words = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    if drivers:
        words += ["-k", " or ".join(f"Test{driver}" for driver in drivers)]
    done = run(
        [sys.executable, "-m", "pytest", *words, f"--junitxml={results}", str(BROKEN / contracts)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=140,
    )
    assert results.exists(), done.stdout + done.stderr
    found: dict[str, dict[str, str]] = {}
    for case in ElementTree.parse(results).iter("testcase"):
        driver = case.attrib["classname"].rpartition(".Test")[2]
        failed = found.setdefault(driver, {})
        for kind in ("failure", "error"):
            for problem in case.iter(kind):
                failed[case.attrib["name"]] = problem.attrib["message"] + (problem.text or "")
    assert found, done.stdout + done.stderr
    return found
