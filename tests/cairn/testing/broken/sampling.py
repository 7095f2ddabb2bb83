"""Runs a driver in virtual time, and applies a contract's tests to its messages."""

import inspect
from collections.abc import Mapping
from typing import Any

import pytest

from cairn import to_ns
from cairn.testing.base_contract import DriveContract
from cairn.testing.camera_contract import Pictures, outline
from cairn.testing.driver_contract import Contract
from cairn.testing.lockstep import ComponentHarness
from cairn.testing.odometry_contract import Drive
from cairn.testing.robot import Arrival

SIDES = ("left", "right")

Arrivals = Mapping[str, list[Arrival[Any]]]


def failures_of(contract: Contract, **given: object) -> dict[str, str]:
    """Return the failures of the tests of the contract that need exactly these fixtures.

    It includes skipped tests, because they would find no fault.
    """
    failures = {}
    for name, test in inspect.getmembers(contract, inspect.ismethod):
        if name.startswith("test_") and inspect.signature(test).parameters.keys() == given.keys():
            try:
                test(**given)
            except (AssertionError, pytest.skip.Exception) as problem:
                failures[name] = str(problem)
    return failures


def arrivals(driver: ComponentHarness[Any]) -> Arrivals:
    """Return what was published since the last call, by port; it arrives when it is published."""
    times: dict[str, list[int]] = {}
    for port, at_ns in driver.published:
        times.setdefault(port, []).append(at_ns)
    driver.published.clear()
    return {
        port: [
            Arrival(message, at, at) for message, at in zip(driver.take(port), when, strict=True)
        ]
        for port, when in times.items()
    }


def pictures(driver: ComponentHarness[Any], seconds: float) -> Pictures:
    """Return what a stereo camera publishes in this time [s]."""
    driver.run_for(seconds)
    order = [port for port, _ in driver.published]
    came = arrivals(driver)
    rest = {port: iter(some) for port, some in came.items()}
    stamped = [(port, to_ns(next(rest[port]).message.header.stamp)) for port in order]
    return Pictures(
        outlines={
            side: [
                Arrival(outline(one.message), one.at_ns, one.clock_ns)
                for one in came[f"{side}_image"]
            ]
            for side in SIDES
        },
        whole={side: came[f"{side}_image"][0].message for side in SIDES},
        infos={side: came[f"{side}_info"] for side in SIDES},
        order=stamped,
    )


def drive(driver: ComponentHarness[Any], contract: type[DriveContract]) -> Drive:
    """Return a drive of the contract: standing, ahead, to the left, and standing."""
    parts: list[Arrivals] = []
    for command, seconds in (
        (None, 1.0),
        (contract.ahead(), contract.drive_s),
        (contract.leftwards(), contract.drive_s),
        (None, contract.stop_limit_s + 0.5),
    ):
        for _ in range(round(20 * seconds)):
            if command is not None:
                driver.publish("cmd_vel", command)
            driver.run_for(0.05)
        parts.append(arrivals(driver))
    before, ahead, left, after = (part["odom"] for part in parts)
    transforms = [one.message for part in parts for one in part["tf"]]
    return Drive(before, ahead, left, after, transforms)
