"""The client: retries on a faulty line, replies of all firmware generations, the handshake."""

import numpy as np
import pytest

from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.client import handshake
from cairn.components.roboclaw_base.emulator import EmulatedRoboclaw
from cairn.components.roboclaw_base.emulator_controller import Firmware
from cairn.components.roboclaw_base.kinematics import BaseLimits, WheelGeometry
from cairn.components.roboclaw_base.protocol import ACKNOWLEDGED, reply_packet
from cairn.driver.emulator import FRAME_FAULTS, FrameFaults
from cairn.driver.errors import DeviceError
from tests.components.roboclaw_base.line import client_on
from tests.wording import words_in_order

GEOMETRY = WheelGeometry(0.05, 1.0, 0.3, 2000.0, "m1", left_inverted=False, right_inverted=False)
LIMITS = BaseLimits(0.6, 1.5, 0.8, 3.0)


def test_read_commands_return_the_numbers() -> None:
    device = EmulatedRoboclaw(first_counts=(7, 2**32 - 1))
    client, _, counts = client_on(device)

    assert client.version() == "USB Roboclaw 2x7a v4.2.8"
    assert client.read(protocol.ENCODERS) == (7, 2**32 - 1)
    assert client.read(protocol.MAIN_VOLTAGE) == (124,)
    assert counts.retries == 0


def test_no_wrong_number_is_returned_among_a_thousand_faults() -> None:
    device = EmulatedRoboclaw(first_counts=(123456, 2**31))
    faults = FrameFaults(dict.fromkeys(FRAME_FAULTS, 0.15), np.random.default_rng(5))
    client, _, counts = client_on(device, faults, tries=30)

    while sum(faults.counts.values()) < 1000:
        client.write(protocol.set_timeout(0.7))
        assert client.read(protocol.ENCODERS) == (123456, 2**31)
        assert client.read(protocol.TIMEOUT) == (7,)
        assert client.version() == "USB Roboclaw 2x7a v4.2.8"
        assert client.status().errors == ()
    assert counts.missing > 50
    assert counts.damaged > 50
    assert counts.retries == counts.missing + counts.damaged


def test_error_names_the_command_that_is_not_answered() -> None:
    device = EmulatedRoboclaw(address=0x85)
    client, _, _ = client_on(device)

    with pytest.raises(DeviceError, match=words_in_order("0x80", "command 21")):
        client.version()


def test_error_names_the_command_whose_replies_are_invalid() -> None:
    device = EmulatedRoboclaw()
    faults = FrameFaults({"bad_sum": 1.0}, np.random.default_rng(5))
    client, _, _ = client_on(device, faults)

    with pytest.raises(DeviceError, match=words_in_order("command 78", "invalid")):
        client.read(protocol.ENCODERS)


@pytest.mark.parametrize("firmware", ["old", "usual", "new"])
def test_status_is_decoded_for_every_firmware(firmware: Firmware) -> None:
    device = EmulatedRoboclaw(firmware=firmware)
    client, _, _ = client_on(device)
    device.controller.emergency_stop = True
    device.controller.voltage = 5.0

    for _ in range(2):
        assert set(client.status().errors) == {"emergency stop", "main battery voltage low"}


@pytest.mark.parametrize("firmware", ["usual", "new"])
def test_battery_limits_are_set_for_every_firmware(firmware: Firmware) -> None:
    device = EmulatedRoboclaw(firmware=firmware)
    device.controller.auto_offset = int(firmware == "new")
    client, _, _ = client_on(device)

    handshake(client, GEOMETRY, LIMITS, 0.5, (10.5, 16.8))

    assert device.controller.main_limits == (10.5, 16.8)
    assert device.controller.auto_offset == (firmware == "new")


def test_late_reply_is_not_accepted_as_the_next_one() -> None:
    device = EmulatedRoboclaw(first_counts=(5, 6))
    client, line, counts = client_on(device)
    line.late = [reply_packet(0x80, 90, bytes(4)), ACKNOWLEDGED]

    assert client.read(protocol.ENCODERS) == (5, 6)
    assert counts.retries == 0
