"""The emulated RoboClaw applies the rules of the real one to its driver."""

import pytest

from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.emulator import EmulatedRoboclaw
from cairn.components.roboclaw_base.protocol import (
    ACKNOWLEDGED,
    read_packet,
    reply_data,
    write_packet,
)


def packet(command: protocol.WriteCommand) -> bytes:
    return write_packet(0x80, command.command, command.data)


@pytest.fixture
def device() -> EmulatedRoboclaw:
    device = EmulatedRoboclaw()
    device.powered_on(0.0)
    return device


RUN = packet(protocol.drive_speed(20_000, 4000, -4000))


def test_write_command_is_acknowledged_and_executed(device: EmulatedRoboclaw) -> None:
    assert device.receive(RUN, 0.0) == [ACKNOWLEDGED]
    device.advance(1.0)

    first, second = device.controller.motors
    assert first.speed == pytest.approx(4000, rel=0.05)
    assert second.speed == pytest.approx(-4000, rel=0.05)
    assert first.count > 2000
    assert second.count > 2**32 - 5000  # it counts backwards from 0


def test_packet_with_a_wrong_crc_is_not_executed(device: EmulatedRoboclaw) -> None:
    assert device.receive(RUN[:-1] + bytes([RUN[-1] ^ 1]), 0.0) == []
    device.advance(1.0)

    assert device.controller.at_rest
    assert device.rejected == 1


def test_packet_that_pauses_for_more_than_10_ms_is_discarded(device: EmulatedRoboclaw) -> None:
    device.receive(RUN[:5], 0.0)
    assert device.receive(RUN[5:], 0.009) == [ACKNOWLEDGED]
    device.receive(RUN[:5], 1.0)

    assert device.receive(RUN[5:], 1.011) == []
    assert device.receive(RUN, 1.1) == [ACKNOWLEDGED]


def test_noise_before_a_packet_is_skipped(device: EmulatedRoboclaw) -> None:
    assert device.receive(b"\x00\x41\xff" + RUN, 0.0) == [ACKNOWLEDGED]


def test_serial_timeout_stops_the_motors(device: EmulatedRoboclaw) -> None:
    device.receive(packet(protocol.set_timeout(0.5)), 0.0)
    device.receive(RUN, 0.1)
    device.advance(0.59)
    assert device.controller.motors[0].speed > 3000

    device.advance(1.2)
    assert device.controller.at_rest
    assert device.timeouts == 1

    device.receive(read_packet(0x80, 78), 1.3)  # a new command does not restart the motors
    device.advance(2.0)
    assert device.controller.at_rest


def test_without_serial_timeout_the_motors_run_on(device: EmulatedRoboclaw) -> None:
    device.receive(RUN, 0.0)
    device.advance(60.0)

    assert device.controller.motors[0].speed == pytest.approx(4000, rel=0.01)


def test_unplugged_controller_keeps_running_on_its_battery(device: EmulatedRoboclaw) -> None:
    device.receive(packet(protocol.set_timeout(0.5)), 0.0)
    device.receive(RUN, 0.1)
    device.powered_on(0.3)  # the line is back

    assert device.controller.motors[0].speed > 0
    assert device.controller.timeout_s == 0.5


def test_reversed_encoder_makes_the_wheel_run_away(
    device: EmulatedRoboclaw,
) -> None:
    device.controller.set_fault(1, "encoder_reversed")
    device.receive(packet(protocol.drive_speed(20_000, 1000, 1000)), 0.0)
    device.advance(5.0)

    assert device.controller.motors[0].speed > 3000
    assert device.controller.motors[1].speed == pytest.approx(1000, rel=0.05)


def test_reply_has_the_data_of_its_command(device: EmulatedRoboclaw) -> None:
    def read(command: int) -> bytes:
        (reply,) = device.receive(read_packet(0x82, command), 0.0)
        data = reply_data(0x82, command, reply)
        assert data is not None
        return data

    assert read(21) == b"USB Roboclaw 2x7a v4.2.8\n\0"
    assert read(24) == (124).to_bytes(2, "big")
    assert read(82) == (315).to_bytes(2, "big")
    assert read(99) == b"\x00\x03"


@pytest.mark.parametrize("command", [16, 17, 18, 19])
def test_counters_and_speeds_have_a_status_byte(device: EmulatedRoboclaw, command: int) -> None:
    (reply,) = device.receive(read_packet(0x80, command), 0.0)

    assert reply_data(0x80, command, reply) == bytes(5)
