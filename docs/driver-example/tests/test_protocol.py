"""Lines of the protocol: written, read, damaged, split."""

import pytest

from lantern_driver.protocol import BEAMS, DamagedLine, Lines, Turn, read_turn, write_turn

TURN = Turn(65_535, tuple(range(1000, 1000 + BEAMS)))


def test_a_written_line_is_read_as_the_same_turn() -> None:
    assert read_turn(write_turn(TURN)) == TURN


def test_every_damaged_byte_is_detected() -> None:
    line = write_turn(TURN)
    for index in range(len(line) - 1):
        damaged = bytearray(line)
        damaged[index] ^= 0x01
        with pytest.raises(DamagedLine):
            read_turn(bytes(damaged))


def test_lines_are_assembled_from_single_bytes() -> None:
    stream = write_turn(TURN) * 3
    lines = Lines()

    found = [line for byte in stream for line in lines.feed(bytes([byte]))]

    assert [read_turn(line) for line in found] == [TURN] * 3
