"""Which seeds a command is to run: A..B."""

from __future__ import annotations

from cairn.errors import CairnError


def seeds_of(text: str) -> range:
    """The seeds that `--seeds A..B`, or one number, names; `CairnError` if it names none."""
    first, dots, last = text.partition("..")
    try:
        begin = int(first)
        end = int(last) if dots else begin
    except ValueError:
        raise CairnError(f"--seeds {text}: write it as A..B, such as 0..19") from None
    if not 0 <= begin <= end:
        raise CairnError(f"--seeds {text}: A must not be negative nor larger than B")
    return range(begin, end + 1)
