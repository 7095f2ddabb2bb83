"""SCIP's numbers and check sums are those of the specification."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.hokuyo.scip_text import (
    ScipError,
    check_sum,
    checked,
    decode_number,
    decode_numbers,
    encode_number,
    encode_numbers,
    with_sum,
)


@pytest.mark.parametrize(("value", "text"), [(1234, b"CB"), (5432, b"1Dh"), (16_000_000, b"m2@0")])
def test_the_numbers_of_the_specification(value: int, text: bytes) -> None:
    assert encode_number(value, len(text)) == text
    assert decode_number(text) == value


@pytest.mark.parametrize("line", [b"00P", b"99b", b"0Ee", b"98a", b"10Q"])
def test_statuses_have_the_sums_that_sensors_send(line: bytes) -> None:
    assert check_sum(line[:-1]) == line[-1:]


@given(st.integers(2, 4), st.data())
def test_numbers_come_back(width: int, data: st.DataObject) -> None:
    values = np.array(data.draw(st.lists(st.integers(0, 64**width - 1), max_size=50)), np.int64)
    text = encode_numbers(values, width)

    assert text == b"".join(encode_number(int(value), width) for value in values)
    assert decode_numbers(np.frombuffer(text, np.uint8), width).tolist() == values.tolist()


@pytest.mark.parametrize("text", [b"0/0", b"0p0", b"0\n0", b"\xff00"])
def test_other_characters_are_no_numbers(text: bytes) -> None:
    with pytest.raises(ScipError, match="numbers"):
        decode_numbers(np.frombuffer(text, np.uint8), 3)
    with pytest.raises(ScipError, match="not a number"):
        decode_number(text)


def test_a_number_that_is_not_whole_is_refused() -> None:
    with pytest.raises(ScipError, match="4 characters"):
        decode_numbers(np.frombuffer(b"0000", np.uint8), 3)


@given(st.binary(min_size=1, max_size=64), st.data())
def test_a_wrong_character_within_what_is_allowed_breaks_the_sum(
    text: bytes, data: st.DataObject
) -> None:
    text = bytes(0x30 + byte % 64 for byte in text)
    line = bytearray(with_sum(text))
    assert checked(bytes(line)) == text
    place = data.draw(st.integers(0, len(line) - 1))
    line[place] = data.draw(
        st.integers(0x30, 0x6F).filter(lambda character: character != line[place])
    )

    with pytest.raises(ScipError, match="check sum"):
        checked(bytes(line))
