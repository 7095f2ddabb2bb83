"""Pictures of points for a terminal, drawn with Braille characters: 2 by 4 dots in each."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

ACROSS, DOWN = 2, 4
"""Dots in a character. A dot is as wide as high in most terminals: a cell is twice as high."""

# Bits of Unicode's Braille patterns, row by row.
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_EMPTY = 0x2800


class BrailleCanvas:
    """A picture in layers: each cell has the dots of all layers, in the style of the last one."""

    def __init__(self, columns: int, lines: int) -> None:
        self.columns, self.lines = columns, lines
        self._cells = np.zeros((lines, columns), int)
        self._styles = np.zeros((lines, columns), int)
        self._names = [""]
        self._letters: dict[tuple[int, int], str] = {}

    @property
    def dots(self) -> tuple[int, int]:
        """Dots across and down."""
        return self.columns * ACROSS, self.lines * DOWN

    def add(self, points: NDArray[np.float64], style: str = "") -> None:
        """Draw points (n, 2), in dots across and down from the upper left, rounded to dots.

        Those outside the picture, or not finite, are left out.
        """
        points = points[np.isfinite(points).all(axis=1)]
        dots = np.array(self.dots)
        points = points[((points > -1.0) & (points < dots)).all(axis=1)]  # fits an integer
        across, down = np.rint(points).astype(int).T
        inside = (across >= 0) & (across < dots[0]) & (down >= 0) & (down < dots[1])
        across, down = across[inside], down[inside]
        cells = (down // DOWN, across // ACROSS)
        np.bitwise_or.at(self._cells, cells, _BITS[down % DOWN, across % ACROSS])
        self._styles[cells] = self._style(style)

    def put(self, across: float, down: float, letter: str, style: str = "") -> None:
        """Put one character instead of the cell at a point in dots, if it is in the picture."""
        if not (0 <= across < self.dots[0] and 0 <= down < self.dots[1]):
            return
        cell = int(down) // DOWN, int(across) // ACROSS
        self._letters[cell] = letter
        self._styles[cell] = self._style(style)

    def runs(self) -> Iterator[list[tuple[str, str]]]:
        """Yield for each line its parts of one style each: text and style."""
        for line in range(self.lines):
            texts = [chr(_EMPTY + cell) for cell in self._cells[line].tolist()]
            for (of_line, column), letter in self._letters.items():
                if of_line == line:
                    texts[column] = letter
            parts: list[tuple[str, str]] = []
            begin = 0
            styles = self._styles[line].tolist()
            for column in range(1, self.columns + 1):
                if column == self.columns or styles[column] != styles[begin]:
                    parts.append(("".join(texts[begin:column]), self._names[styles[begin]]))
                    begin = column
            yield parts

    def text(self) -> str:
        """Return the picture without styles."""
        return "\n".join("".join(text for text, _ in parts) for parts in self.runs())

    def _style(self, name: str) -> int:
        if name not in self._names:
            self._names.append(name)
        return self._names.index(name)
