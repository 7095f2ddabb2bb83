"""Finds the inner corners of a chessboard in an image, to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

# A board is searched in an image of at most this size [px] and then refined at full size; the
# slow, exhaustive search uses a smaller image.
_SEARCH_SIZE, _EXHAUSTIVE_SIZE = 1600, 900
# Half the refinement window as a share of the distance between corners, and its limits [px] at
# normal image size: it must not reach a second corner, and must be wider than blur.
_WINDOW, _SMALLEST, _LARGEST = 0.3, 2, 15
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


@dataclass(frozen=True)
class Board:
    """A chessboard with `columns` x `rows` inner corners, `square` [m] apart."""

    columns: int
    rows: int
    square: float

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}"

    @property
    def points(self) -> Array:
        """Return the corners (n, 3) [m] in the board's own frame, row by row."""
        down, across = np.mgrid[: self.rows, : self.columns]
        flat = np.column_stack((across.ravel(), down.ravel(), np.zeros(across.size)))
        return flat * self.square


def find_corners(gray: Gray, board: Board) -> Array | None:
    """Return the inner corners (n, 2) [px], row by row; None if the whole board is not visible."""
    size = (board.columns, board.rows)
    small, reduced = _scale_down(gray, _SEARCH_SIZE)
    found, corners = cv2.findChessboardCorners(small, size)
    if not found:
        # Slower, but it also finds boards that are blurred or badly lit.
        small, reduced = _scale_down(gray, _EXHAUSTIVE_SIZE)
        found, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_EXHAUSTIVE)
    if not found:
        return None
    # Pixel centers have whole coordinates in both images.
    start = (np.asarray(corners, np.float32).reshape(-1, 1, 2) + 0.5) * reduced - 0.5
    window = int(np.clip(_WINDOW * _spacing(start, board), _SMALLEST, _LARGEST * reduced).round())
    refined = cv2.cornerSubPix(
        gray, start.astype(np.float32), (window, window), (-1, -1), _CRITERIA
    )
    return np.asarray(refined, np.float64).reshape(-1, 2)


def reorder_like(corners: Array, other: Array, board: Board) -> Array:
    """Reorder corners (n, 2) to begin at the same end as those of a second camera, `other`.

    A symmetric board does not reveal its first corner. Both cameras must be about equally upright.
    """
    grid = corners.reshape(board.rows, board.columns, 2)
    turned = [grid, grid[::-1, ::-1]]
    if board.rows == board.columns:
        quarter = grid.transpose(1, 0, 2)[:, ::-1]
        turned += [quarter, quarter[::-1, ::-1]]
    reference = other - other.mean(axis=0)
    orders = [np.ascontiguousarray(order).reshape(-1, 2) for order in turned]
    apart = [np.linalg.norm(order - order.mean(axis=0) - reference) for order in orders]
    return orders[int(np.argmin(apart))]


def find_other_board(images: Sequence[Gray], board: Board, *, larger: bool = False) -> Board | None:
    """Return the largest board of about `board`'s size in one of the images, None without one.

    If `larger`, only boards that contain `board` are searched.
    """
    boards = [
        other
        for other in _similar_boards(board)
        if not larger or (other.columns >= board.columns and other.rows >= board.rows)
    ]
    largest: Board | None = None
    for image in images:
        small, _ = _scale_down(image, _EXHAUSTIVE_SIZE)
        # A search is slow: skip boards that are not larger than what was found.
        for other in sorted(boards, key=_corner_count, reverse=True):
            if largest is not None and _corner_count(other) <= _corner_count(largest):
                break
            if cv2.findChessboardCorners(small, (other.columns, other.rows))[0]:
                largest = other
                break
    return largest


def _similar_boards(board: Board) -> Iterator[Board]:
    for columns in range(max(3, board.columns - 2), board.columns + 3):
        for rows in range(max(3, board.rows - 2), board.rows + 3):
            if (columns, rows) != (board.columns, board.rows):
                yield Board(columns, rows, board.square)


def _corner_count(board: Board) -> int:
    return board.columns * board.rows


def _scale_down(gray: Gray, most: int) -> tuple[Gray, float]:
    """Scale an image down to sides of at most `most` [px]; return it and the scale factor."""
    factor = max(1.0, max(gray.shape) / most)
    if factor == 1.0:
        return gray, factor
    small = cv2.resize(gray, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), factor


def _spacing(corners: NDArray[np.floating], board: Board) -> float:
    grid = corners.reshape(board.rows, board.columns, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    return float(min(across.min(), down.min()))
