"""Lines are read as they were written, or not at all."""

import pytest

from lantern_driver.protocol import BEAMS, DamagedLine, Lines, Turn, read_turn, write_turn

TURN = Turn(65_535, tuple(range(1000, 1000 + BEAMS)))


def test_a_line_tells_the_turn_that_was_written() -> None:
    assert read_turn(write_turn(TURN)) == TURN


def test_no_damaged_byte_goes_unnoticed() -> None:
    line = write_turn(TURN)
    for place in range(len(line) - 1):
        damaged = bytearray(line)
        damaged[place] ^= 0x01
        with pytest.raises(DamagedLine):
            read_turn(bytes(damaged))


def test_lines_are_put_together_from_any_pieces() -> None:
    stream = write_turn(TURN) * 3
    lines = Lines()

    found = [line for byte in stream for line in lines.feed(bytes([byte]))]

    assert [read_turn(line) for line in found] == [TURN] * 3
