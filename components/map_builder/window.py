"""A part of a grid map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Window:
    """A part of a map: from row, column on; `values` (rows, columns)."""

    row: int
    column: int
    values: NDArray[np.int8]

    @property
    def rows(self) -> slice:
        """The rows of the map that it covers."""
        return slice(self.row, self.row + self.values.shape[0])

    @property
    def columns(self) -> slice:
        """The columns of the map that it covers."""
        return slice(self.column, self.column + self.values.shape[1])

    @property
    def box(self) -> tuple[int, int, int, int]:
        """First row and column, and those after the last."""
        return self.rows.start, self.columns.start, self.rows.stop, self.columns.stop
