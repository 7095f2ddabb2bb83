"""SCIP: numbers, check sums, replies, fields and scans, on the specification and captured bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.hokuyo_scanner.protocol import (
    NO_ECHO,
    Reply,
    ReplySplitter,
    ScanData,
    ScanRequest,
    ScipError,
    check_sum,
    decode_number,
    decode_numbers,
    encode_number,
    encode_numbers,
    parse_fields,
    scan_data,
    sensor_spec,
    with_sum,
    without_sum,
)
from tests.wording import words_in_order

_REPLIES = [b"MD0044072501000\n99b\n007GN\nabc\n\n", b"QT\n00P\n\n", b"V\n0\nVEND:x\nPROD:y\n\n"]
CAPTURED_VV = Path(__file__).parents[2] / "data" / "hokuyo" / "scip20_VV_urg04lx-ug01.bin"
# Lines of a real URG-04LX, sums included.
PP = [
    b"DMIN:20;4",
    b"DMAX:5600;_",
    b"ARES:1024;\\",
    b"AMIN:44;7",
    b"AMAX:725;o",
    b"AFRT:384;6",
    b"SCAN:600;e",
]
CAPTURED_GD = Path(__file__).parents[2] / "data" / "hokuyo" / "scip20_GD_urg04lx-ug01_A.bin"
WHOLE = ScanRequest(44, 725)


@pytest.mark.parametrize(("value", "text"), [(1234, b"CB"), (5432, b"1Dh"), (16_000_000, b"m2@0")])
def test_numbers_are_encoded_as_in_the_specification(value: int, text: bytes) -> None:
    assert encode_number(value, len(text)) == text
    assert decode_number(text) == value


@pytest.mark.parametrize("line", [b"00P", b"99b", b"0Ee", b"98a", b"10Q"])
def test_check_sums_equal_those_of_real_sensors(line: bytes) -> None:
    assert check_sum(line[:-1]) == line[-1:]


@given(st.integers(2, 4), st.data())
def test_numbers_are_decoded_as_encoded(width: int, data: st.DataObject) -> None:
    values = np.array(data.draw(st.lists(st.integers(0, 64**width - 1), max_size=50)), np.int64)
    text = encode_numbers(values, width)

    assert text == b"".join(encode_number(int(value), width) for value in values)
    assert decode_numbers(np.frombuffer(text, np.uint8), width).tolist() == values.tolist()


@pytest.mark.parametrize("text", [b"0/0", b"0p0", b"0\n0", b"\xff00"])
def test_other_characters_are_rejected_as_numbers(text: bytes) -> None:
    with pytest.raises(ScipError, match="numbers"):
        decode_numbers(np.frombuffer(text, np.uint8), 3)
    with pytest.raises(ScipError, match="not a number"):
        decode_number(text)


def test_incomplete_number_is_rejected() -> None:
    with pytest.raises(ScipError, match="4 characters"):
        decode_numbers(np.frombuffer(b"0000", np.uint8), 3)


@given(st.binary(min_size=1, max_size=64), st.data())
def test_changed_character_breaks_the_check_sum(text: bytes, data: st.DataObject) -> None:
    text = bytes(0x30 + byte % 64 for byte in text)
    line = bytearray(with_sum(text))
    assert without_sum(bytes(line)) == text
    place = data.draw(st.integers(0, len(line) - 1))
    line[place] = data.draw(
        st.integers(0x30, 0x6F).filter(lambda character: character != line[place])
    )

    with pytest.raises(ScipError, match="check sum"):
        without_sum(bytes(line))


@given(st.lists(st.integers(1, 40), max_size=30))
def test_replies_do_not_depend_on_how_the_bytes_are_split(cuts: list[int]) -> None:
    stream = b"".join(_REPLIES) * 2
    splitter, found, at = ReplySplitter(), [], 0
    for cut in [*cuts, len(stream)]:
        if at < len(stream):
            found += splitter.feed(stream[at : at + cut])
            at += cut

    assert found == 2 * [
        Reply(b"MD0044072501000", b"99b", b"007GN\nabc"),
        Reply(b"QT", b"00P", b""),
        Reply(b"V", b"0", b"VEND:x\nPROD:y"),
    ]
    assert splitter.noise == 0


@given(st.binary(max_size=300))
def test_replies_are_found_again_after_noise(noise: bytes) -> None:
    splitter = ReplySplitter()

    found = splitter.feed(noise + b"\n\n" + _REPLIES[1] + _REPLIES[1])

    assert found[-1] == Reply(b"QT", b"00P", b"")
    assert found[-2] == Reply(b"QT", b"00P", b"")


def test_endless_noise_is_discarded() -> None:
    splitter = ReplySplitter()
    for _ in range(200):
        splitter.feed(b"x" * 1000)

    assert splitter.noise > 100_000
    assert splitter.feed(b"x\n\n" + _REPLIES[1])[-1].echo == b"QT"


def test_bytes_outside_of_replies_are_counted() -> None:
    splitter = ReplySplitter()

    assert splitter.feed(b"rubbish\n\n" + _REPLIES[1]) == [Reply(b"QT", b"00P", b"")]
    assert splitter.noise == len(b"rubbish")


def test_captured_version_is_parsed() -> None:
    (reply,) = ReplySplitter().feed(CAPTURED_VV.read_bytes())

    assert parse_fields(reply.lines) == {
        "VEND": "Hokuyo Automatic Co.,Ltd.",
        "PROD": "SOKUIKI Sensor URG-04LX-UG01(Simple-URG)",
        "FIRM": "3.4.03(17/Dec./2012)",
        "PROT": "SCIP 2.0",
        "SERI": "H1510998",
    }


def test_spec_of_a_real_sensor_is_parsed() -> None:
    found = sensor_spec(parse_fields(PP))

    assert (found.least_mm, found.most_mm, found.turn_steps) == (20, 5600, 1024)
    assert (found.first, found.front, found.last) == (44, 384, 725)
    assert found.turn_s == 0.1


def test_lines_with_unknown_keys_are_ignored() -> None:
    line = b"PROT:SCIP 2.2"
    assert sensor_spec(parse_fields([*PP, line + b";" + check_sum(line)])) == sensor_spec(
        parse_fields(PP)
    )


def test_sums_with_the_semicolon_and_up_to_an_arrow_are_accepted() -> None:
    with_it = b"STAT:Sensor works well.;"
    arrow = b"MESM:Measuring by Normal Mode"
    lines = [with_it + check_sum(with_it), arrow + b"<-Ignored;" + check_sum(arrow)]

    assert parse_fields(lines)["STAT"] == "Sensor works well."
    assert parse_fields(lines)["MESM"] == "Measuring by Normal Mode<-Ignored"


def test_wrong_sum_in_a_field_is_rejected() -> None:
    with pytest.raises(ScipError, match="DMIN:20;5"):
        parse_fields([b"DMIN:20;5"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"AMAX": None}, "has no AMAX"),
        ({"SCAN": "fast"}, "number"),
        ({"AMIN": "800"}, "impossible"),
        ({"ARES": "0"}, "impossible"),
        ({"SCAN": "0"}, "impossible"),
    ],
)
def test_impossible_specs_are_rejected(change: dict[str, str | None], message: str) -> None:
    values = {key: value for key, value in (parse_fields(PP) | change).items() if value is not None}

    with pytest.raises(ScipError, match=message):
        sensor_spec(values)


def reply_of(text: bytes, time_ms: int = 1234, echo: bytes = b"MD0000000000000") -> Reply:
    """The reply of a sensor that sends this text of values."""
    lines = [text[at : at + 64] for at in range(0, len(text), 64)]
    body = b"\n".join([with_sum(encode_number(time_ms, 4)), *map(with_sum, lines)])
    (reply,) = ReplySplitter().feed(echo + b"\n99b\n" + body + b"\n\n")
    return reply


def test_captured_scan_is_parsed() -> None:
    (reply,) = ReplySplitter().feed(CAPTURED_GD.read_bytes())
    data = scan_data(reply, WHOLE)
    distances = data.distances[:, 0]

    assert reply.code() == "00"
    assert data.time_ms == 11_149_560
    assert distances.size == 682
    assert distances[:5].tolist() == [6, 6, 6, 4190, 6]
    assert distances[28:32].tolist() == [1034, 1031, 1028, 1025]
    assert set(distances[distances < 20].tolist()) == {0, 6, 7}
    assert data.intensities is None


def test_any_changed_byte_of_a_captured_scan_is_detected() -> None:
    good = CAPTURED_GD.read_bytes()
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
def test_missing_or_added_part_is_detected(data: st.DataObject) -> None:
    good = CAPTURED_GD.read_bytes()
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
        _same(right, found)  # the damage is outside of its values


def _same(right: ScanData, found: ScanData) -> None:
    assert np.array_equal(right.distances, found.distances)
    assert right.time_ms == found.time_ms


@pytest.mark.parametrize("values", [1, 21, 64, 128, 682, 1081])
def test_full_and_shorter_lines_are_parsed(values: int) -> None:
    expected = np.arange(values) * 37 % 30_000
    text = b"".join(encode_number(int(value), 3) for value in expected)

    data = scan_data(reply_of(text), ScanRequest(0, values - 1))

    assert data.distances[:, 0].tolist() == expected.tolist()


def test_two_character_ranges_with_intensities_are_parsed() -> None:
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
def test_several_echoes_are_parsed(echoes: list[list[int]], intensity: bool) -> None:
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
def test_impossible_echo_marks_are_rejected(text: bytes) -> None:
    with pytest.raises(ScipError):
        scan_data(reply_of(text), ScanRequest(0, 0, multi_echo=True))


def test_more_or_fewer_values_than_requested_are_rejected() -> None:
    with pytest.raises(ScipError, match=words_in_order("70 values", "71")):
        scan_data(reply_of(b"000" * 70), ScanRequest(0, 70))
