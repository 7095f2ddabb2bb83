"""Scans are taken as they were sent, value by value, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.hokuyo.replies import Reply, ReplySplitter
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scan_data import NO_ECHO, ScanData, scan_data
from cairn.components.hokuyo.scip_text import ScipError, encode_number, with_sum

CAPTURED = Path(__file__).parents[2] / "data" / "hokuyo" / "scip20_GD_urg04lx-ug01_A.bin"
WHOLE = ScanRequest(44, 725)


def reply_of(text: bytes, time_ms: int = 1234, echo: bytes = b"MD0000000000000") -> Reply:
    """The reply of a sensor that sends this text of values."""
    lines = [text[at : at + 64] for at in range(0, len(text), 64)]
    body = b"\n".join([with_sum(encode_number(time_ms, 4)), *map(with_sum, lines)])
    (reply,) = ReplySplitter().feed(echo + b"\n99b\n" + body + b"\n\n")
    return reply


def test_a_captured_scan_of_a_real_sensor() -> None:
    (reply,) = ReplySplitter().feed(CAPTURED.read_bytes())
    data = scan_data(reply, WHOLE)
    distances = data.distances[:, 0]

    assert reply.code() == "00"
    assert data.time_ms == 11_149_560
    assert distances.size == 682
    assert distances[:5].tolist() == [6, 6, 6, 4190, 6]
    assert distances[28:32].tolist() == [1034, 1031, 1028, 1025]
    assert set(distances[distances < 20].tolist()) == {0, 6, 7}
    assert data.intensities is None


def test_any_byte_of_a_captured_scan_that_is_changed_is_noticed() -> None:
    good = CAPTURED.read_bytes()
    (reply,) = ReplySplitter().feed(good)
    right = scan_data(reply, WHOLE)
    begin = len(b"GD0044072501\n00P\n")
    for place in range(begin, len(good) - 2):
        for wrong in (good[place] ^ 1, good[place] ^ 0x40, 0x30, ord("\n"), ord("&")):
            if wrong == good[place]:
                continue
            for reply in ReplySplitter().feed(good[:place] + bytes([wrong]) + good[place + 1 :]):
                with pytest.raises(ScipError):
                    _same(right, scan_data(reply, WHOLE))


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_part_that_is_missing_or_was_added_is_noticed(data: st.DataObject) -> None:
    good = CAPTURED.read_bytes()
    begin = data.draw(st.integers(0, len(good) - 3))
    end = data.draw(st.integers(begin, len(good) - 3))
    added = data.draw(st.binary(max_size=200))
    damaged = good[:begin] + added + good[end:]
    (reply,) = ReplySplitter().feed(good)
    right = scan_data(reply, WHOLE)
    for reply in ReplySplitter().feed(damaged):
        try:
            found = scan_data(reply, WHOLE)
        except ScipError:
            continue
        _same(right, found)  # what was damaged is none of its values


def _same(right: ScanData, found: ScanData) -> None:
    assert np.array_equal(right.distances, found.distances)
    assert right.time_ms == found.time_ms


@pytest.mark.parametrize("values", [1, 21, 64, 128, 682, 1081])
def test_lines_may_be_full_or_not(values: int) -> None:
    wanted = np.arange(values) * 37 % 30_000
    text = b"".join(encode_number(int(value), 3) for value in wanted)

    data = scan_data(reply_of(text), ScanRequest(0, values - 1))

    assert data.distances[:, 0].tolist() == wanted.tolist()


def test_two_characters_and_intensities() -> None:
    short = scan_data(reply_of(b"CB" * 70), ScanRequest(0, 69, encoding=2))
    both = scan_data(
        reply_of((b"1Dh" + encode_number(99, 3)) * 70), ScanRequest(0, 69, intensity=True)
    )

    assert short.distances[:, 0].tolist() == [1234] * 70
    assert both.distances[:, 0].tolist() == [5432] * 70
    assert both.intensities is not None
    assert both.intensities[:, 0].tolist() == [99] * 70


ECHOES = st.lists(st.lists(st.integers(0, 262_143), min_size=1, max_size=3), min_size=1)


@given(ECHOES, st.booleans())
def test_several_echoes(echoes: list[list[int]], intensity: bool) -> None:
    def one(value: int) -> bytes:
        text = encode_number(value, 3)
        return text + encode_number(value // 2, 3) if intensity else text

    text = b"".join(b"&".join(map(one, step)) for step in echoes)
    request = ScanRequest(0, len(echoes) - 1, multi_echo=True, intensity=intensity)

    data = scan_data(reply_of(text), request)

    assert [[one for one in row if one != NO_ECHO] for row in data.distances.tolist()] == echoes
    if intensity:
        assert data.intensities is not None
        halves = [[one // 2 for one in step] for step in echoes]
        found = [[one for one in row if one != NO_ECHO] for row in data.intensities.tolist()]
        assert found == halves


@pytest.mark.parametrize(
    "text", [b"&000", b"00&0000", b"000&", b"000&&000000", b"000&000&000&000", b"000&00"]
)
def test_marks_of_echoes_that_cannot_be_are_refused(text: bytes) -> None:
    with pytest.raises(ScipError):
        scan_data(reply_of(text), ScanRequest(0, 0, multi_echo=True))


def test_more_or_fewer_values_than_asked_for_are_refused() -> None:
    with pytest.raises(ScipError, match="70 values came, but 71"):
        scan_data(reply_of(b"000" * 70), ScanRequest(0, 70))
