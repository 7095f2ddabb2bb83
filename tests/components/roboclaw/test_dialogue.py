"""Questions and orders over a line that spoils what comes."""

import numpy as np
import pytest

from cairn.components.roboclaw import commands
from cairn.components.roboclaw.emulated_controller import Firmware
from cairn.components.roboclaw.emulator import EmulatedRoboclaw
from cairn.components.roboclaw.kinematics import Geometry, Limits
from cairn.components.roboclaw.packets import ACKNOWLEDGED, reply_packet
from cairn.components.roboclaw.setting_up import set_up
from cairn.driver.emulator import FRAME_FAULTS, FrameFaults
from cairn.driver.errors import DeviceError
from tests.components.roboclaw.line import dialogue_with

GEOMETRY = Geometry(0.05, 1.0, 0.3, 2000.0, "m1", left_inverted=False, right_inverted=False)
LIMITS = Limits(0.6, 1.5, 0.8, 3.0)


def test_questions_are_answered() -> None:
    device = EmulatedRoboclaw(first_counts=(7, 2**32 - 1))
    dialogue, _, counts = dialogue_with(device)

    assert dialogue.version() == "USB Roboclaw 2x7a v4.2.8"
    assert dialogue.ask(commands.ENCODERS) == (7, 2**32 - 1)
    assert dialogue.ask(commands.MAIN_VOLTAGE) == (124,)
    assert counts.retries == 0


def test_among_a_thousand_faults_no_false_number_is_taken() -> None:
    device = EmulatedRoboclaw(first_counts=(123456, 2**31))
    faults = FrameFaults(dict.fromkeys(FRAME_FAULTS, 0.15), np.random.default_rng(5))
    dialogue, _, counts = dialogue_with(device, faults, tries=30)

    while sum(faults.counts.values()) < 1000:
        dialogue.order(commands.set_timeout(0.7))
        assert dialogue.ask(commands.ENCODERS) == (123456, 2**31)
        assert dialogue.ask(commands.TIMEOUT) == (7,)
        assert dialogue.version() == "USB Roboclaw 2x7a v4.2.8"
        assert dialogue.status().errors == ()
    assert counts.silent > 50
    assert counts.garbled > 50
    assert counts.retries == counts.silent + counts.garbled


def test_a_device_that_never_answers_is_told_of() -> None:
    device = EmulatedRoboclaw(address=0x85)
    dialogue, _, _ = dialogue_with(device)

    with pytest.raises(DeviceError, match="address 0x80 does not answer command 21"):
        dialogue.version()


def test_what_answers_something_else_is_told_of() -> None:
    device = EmulatedRoboclaw()
    faults = FrameFaults({"bad_sum": 1.0}, np.random.default_rng(5))
    dialogue, _, _ = dialogue_with(device, faults)

    with pytest.raises(DeviceError, match="answers command 78 with what is no reply"):
        dialogue.ask(commands.ENCODERS)


@pytest.mark.parametrize("firmware", ["old", "usual", "new"])
def test_the_status_is_understood_whatever_the_firmware(firmware: Firmware) -> None:
    device = EmulatedRoboclaw(firmware=firmware)
    dialogue, _, _ = dialogue_with(device)
    device.controller.emergency_stop = True
    device.controller.voltage = 5.0

    for _ in range(2):
        assert set(dialogue.status().errors) == {"emergency stop", "main battery voltage low"}


@pytest.mark.parametrize("firmware", ["usual", "new"])
def test_battery_limits_are_set_whatever_the_firmware(firmware: Firmware) -> None:
    device = EmulatedRoboclaw(firmware=firmware)
    device.controller.auto_offset = int(firmware == "new")
    dialogue, _, _ = dialogue_with(device)

    set_up(dialogue, GEOMETRY, LIMITS, 0.5, (10.5, 16.8))

    assert device.controller.main_limits == (10.5, 16.8)
    assert device.controller.auto_offset == (firmware == "new")


def test_a_reply_that_comes_late_does_not_take_the_place_of_the_next() -> None:
    device = EmulatedRoboclaw(first_counts=(5, 6))
    dialogue, line, counts = dialogue_with(device)
    line.late = [reply_packet(0x80, 90, bytes(4)), ACKNOWLEDGED]

    assert dialogue.ask(commands.ENCODERS) == (5, 6)
    assert counts.retries == 0
