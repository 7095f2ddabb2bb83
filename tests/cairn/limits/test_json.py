"""JSON of other processes is read with limits; all else is one kind of error."""

import pytest

from cairn.limits.json import parse_json


def test_values_within_the_limits_are_read() -> None:
    text = b'{"a": [1, -2.5, null, true, "w\xc3\xb6rd"], "b": {"c": 18446744073709551615}}'

    assert parse_json(text, 100) == {"a": [1, -2.5, None, True, "wörd"], "b": {"c": 2**64 - 1}}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"", "EOF"),
        (b"\xff", "expected value"),
        (b"NaN", "expected value"),
        (b"-Infinity", "number"),
        (b"1e400", "too large"),
        (b"-1e400", "too large"),
        (b"18446744073709551616", "64 bits"),
        (b"9" * 5_000, "number out of range"),
        (b"[" * 101 + b"]" * 101, "nested deeper than 100"),
        (b"[" * 9_000, "recursion limit"),
        (b'"' + b"x" * 10_000 + b'"', "10,002 bytes, more than the 10,000"),
    ],
    ids=lambda value: repr(value)[:20],
)
def test_other_texts_are_refused(text: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_json(text, 10_000)
