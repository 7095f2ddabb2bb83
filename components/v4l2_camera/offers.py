"""What a camera offers: pixel formats, sizes and rates, and which format suits best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

# Rates are told as fractions of small numbers: 30 pictures a second may be 29.97 of them.
_SAME_RATE = 0.99


@dataclass(frozen=True)
class PictureSize:
    """A size of pictures that a format has [px], and how many a second the camera offers of it.

    Of a range (`is_range`) it is the largest size; rates are those of that.
    """

    width: int
    height: int
    rates: tuple[float, ...]
    is_range: bool = False

    def suits(self, width: int, height: int, rate: float) -> bool:
        """Whether it is that size, at least at that rate, as far as the camera tells."""
        if self.is_range:
            return width <= self.width and height <= self.height
        fast = not self.rates or max(self.rates) >= _SAME_RATE * rate
        return (self.width, self.height) == (width, height) and fast

    def __str__(self) -> str:
        size = f"{'up to ' if self.is_range else ''}{self.width} x {self.height}"
        rates = ", ".join(f"{rate:.4g}" for rate in sorted(self.rates, reverse=True))
        return f"{size} at {rates}/s" if rates else size


def best_format(
    offers: Mapping[str, Sequence[PictureSize]], wanted: Sequence[str], size: tuple[int, int],
    rate: float,
) -> str | None:  # fmt: skip
    """The first of the `wanted` pixel formats that is offered of this size at this rate.

    `offers` are all sizes by format, none where the camera does not tell them. If no format suits,
    the first that is offered at all: the camera then gives what comes nearest. None if it has none
    of them.
    """
    offered = [name for name in wanted if name in offers]
    suiting = [
        name
        for name in offered
        if not offers[name] or any(one.suits(*size, rate) for one in offers[name])
    ]
    return next(iter(suiting + offered), None)


def is_same_rate(given: float, asked: float) -> bool:
    """Whether a rate is as good as the one that was asked for; 0 is one that is not told."""
    return given == 0.0 or _SAME_RATE <= given / asked <= 1.0 / _SAME_RATE
