"""Replies are found among the bytes of a line, however these are cut, and after any noise."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cairn.components.hokuyo.replies import Reply, ReplySplitter

_LINES = [b"MD0044072501000\n99b\n007GN\nabc\n\n", b"QT\n00P\n\n", b"V\n0\nVEND:x\nPROD:y\n\n"]


@given(st.lists(st.integers(1, 40), max_size=30))
def test_the_same_replies_come_however_the_bytes_are_cut(cuts: list[int]) -> None:
    stream = b"".join(_LINES) * 2
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
def test_after_noise_the_reply_after_the_next_is_there(noise: bytes) -> None:
    splitter = ReplySplitter()

    found = splitter.feed(noise + b"\n\n" + _LINES[1] + _LINES[1])

    assert found[-1] == Reply(b"QT", b"00P", b"")
    assert found[-2] == Reply(b"QT", b"00P", b"")


def test_noise_without_an_end_is_not_kept_for_ever() -> None:
    splitter = ReplySplitter()
    for _ in range(200):
        splitter.feed(b"x" * 1000)

    assert splitter.noise > 100_000
    assert splitter.feed(b"x\n\n" + _LINES[1])[-1].echo == b"QT"


def test_bytes_that_are_no_reply_are_counted() -> None:
    splitter = ReplySplitter()

    assert splitter.feed(b"rubbish\n\n" + _LINES[1]) == [Reply(b"QT", b"00P", b"")]
    assert splitter.noise == len(b"rubbish")
