"""Each broken driver fails the tests for its fault, and passes others, in real processes.

For each driver, run the tests that must fail, and one that must pass.
"""

import sys
from pathlib import Path
from subprocess import run
from xml.etree import ElementTree

import pytest

pytestmark = pytest.mark.processes


CONTRACTS = Path(__file__).parent / "broken" / "life_contracts.py"
ROOT = Path(__file__).parents[3]

FAILED = {
    "NeverSilent": {"test_inactive_driver_publishes_nothing": "although it is inactive"},
    "KeepsItsPort": {"test_driver_publishes_after_every_cycle": "is locked by another driver"},
    "Leaks": {
        "test_cycles_leak_no_threads": "threads after",
        "test_cycles_leak_no_files": "files after",
        "test_cycles_leak_no_processes": "children after",
        "test_cycles_leak_no_memory": "memory after",
    },
    "Unbounded": {"test_each_parameter_is_described_and_bounded": "parameter power"},
    "HangsAtItsEnd": {"test_driver_stops_cleanly": "did not stop by itself"},
    "DiesUnplugged": {"test_driver_survives_unplugging_and_reports_it": "was restarted"},
    "SilentUnplugged": {"test_driver_survives_unplugging_and_reports_it": "does not report"},
    "RepeatsUnplugged": {"test_driver_survives_unplugging_and_reports_it": "without its device"},
    "NeverReturns": {
        "test_driver_publishes_after_the_device_returns": "expected 2 messages within"
    },
    "Unlimited": {"test_speed_is_limited": "its limit is 0.5 m/s"},
}
PASSED = {
    "NeverSilent": "test_driver_publishes_after_every_cycle",
    "KeepsItsPort": "test_each_parameter_is_described_and_bounded",
    "Leaks": "test_driver_publishes_after_every_cycle",
    "Unbounded": "test_inactive_driver_publishes_nothing",
    "HangsAtItsEnd": "test_each_parameter_is_described_and_bounded",
    "DiesUnplugged": "test_each_parameter_is_described_and_bounded",
    "SilentUnplugged": "test_driver_publishes_after_the_device_returns",
    "RepeatsUnplugged": "test_driver_stops_cleanly",
    "NeverReturns": "test_driver_survives_unplugging_and_reports_it",
    "Unlimited": "test_nan_commands_are_rejected",
}


@pytest.mark.accuracy
def test_each_broken_driver_fails_the_tests_for_its_fault(tmp_path: Path) -> None:
    failures = failures_of(
        [(driver, test) for driver in FAILED for test in (PASSED[driver], *FAILED[driver])],
        tmp_path / "results.xml",
    )

    for driver, expected in FAILED.items():
        assert failures[driver].keys() == expected.keys(), f"{driver}: {failures[driver]}"
        for test, words in expected.items():
            assert words in failures[driver][test], f"{driver}.{test}: {failures[driver][test]}"


def failures_of(chosen: list[tuple[str, str]], results: Path) -> dict[str, dict[str, str]]:
    """Run these tests as a user does; return messages of those that failed or were skipped."""
    tests = [f"{CONTRACTS}::Test{driver}::{test}" for driver, test in chosen]
    done = run(
        [
            *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"),
            f"--junitxml={results}",
            *tests,
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert results.exists(), done.stdout + done.stderr
    found: dict[str, dict[str, str]] = {}
    ran = set()
    for case in ElementTree.parse(results).iter("testcase"):
        driver, test = case.attrib["classname"].rpartition(".Test")[2], case.attrib["name"]
        ran.add((driver, test))
        failed = found.setdefault(driver, {})
        for kind in ("failure", "error", "skipped"):
            for problem in case.iter(kind):
                failed[test] = problem.attrib["message"] + (problem.text or "")
    assert ran == set(chosen), done.stdout + done.stderr
    return found
