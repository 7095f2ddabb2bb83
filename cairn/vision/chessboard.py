"""Chessboards in images: their inner corners, to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

# Boards are found in images no larger than this [px], and measured in the whole image then; what
# takes long is done in smaller ones.
_SEARCHED, _SEARCHED_LONG = 1600, 900
# Half a window of refinement as a share of the distance between corners, and its limits [px] in
# an image of usual size: it must reach no second corner, and be no smaller than blur is wide.
_WINDOW, _SMALLEST, _LARGEST = 0.3, 2, 15
_ENOUGH = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


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
        """The corners (n, 3) [m] in the board's own frame, row by row."""
        down, across = np.mgrid[: self.rows, : self.columns]
        flat = np.column_stack((across.ravel(), down.ravel(), np.zeros(across.size)))
        return flat * self.square


def find_corners(gray: Gray, board: Board) -> Array | None:
    """The board's inner corners (n, 2) [px], row by row; None if the whole board is not seen."""
    size = (board.columns, board.rows)
    small, reduced = _reduced(gray, _SEARCHED)
    found, corners = cv2.findChessboardCorners(small, size)
    if not found:
        # Slower, but it finds boards that are blurred or badly lit.
        small, reduced = _reduced(gray, _SEARCHED_LONG)
        found, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_EXHAUSTIVE)
    if not found:
        return None
    # The middle of a pixel is at whole numbers in both images.
    start = (np.asarray(corners, np.float32).reshape(-1, 1, 2) + 0.5) * reduced - 0.5
    window = int(np.clip(_WINDOW * _spacing(start, board), _SMALLEST, _LARGEST * reduced).round())
    refined = cv2.cornerSubPix(gray, start.astype(np.float32), (window, window), (-1, -1), _ENOUGH)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def in_order_of(corners: Array, other: Array, board: Board) -> Array:
    """The same corners (n, 2), counted from the end from which a second camera's `other` are.

    Which end is first is not always to be seen of a board. Both cameras are about the same way up.
    """
    grid = corners.reshape(board.rows, board.columns, 2)
    turned = [grid, grid[::-1, ::-1]]
    if board.rows == board.columns:
        quarter = grid.transpose(1, 0, 2)[:, ::-1]
        turned += [quarter, quarter[::-1, ::-1]]
    wanted = other - other.mean(axis=0)
    orders = [np.ascontiguousarray(order).reshape(-1, 2) for order in turned]
    apart = [np.linalg.norm(order - order.mean(axis=0) - wanted) for order in orders]
    return orders[int(np.argmin(apart))]


def other_board(images: Sequence[Gray], board: Board, *, larger: bool = False) -> Board | None:
    """The largest board near `board` in size that is seen in one of the images; None if none is.

    If `larger`, only such boards are looked for that have `board` as a part.
    """
    boards = [
        other
        for other in _near(board)
        if not larger or (other.columns >= board.columns and other.rows >= board.rows)
    ]
    largest: Board | None = None
    for image in images:
        small, _ = _reduced(image, _SEARCHED_LONG)
        # To look for a board takes long: not for those that are no larger than what was found.
        for other in sorted(boards, key=_corners, reverse=True):
            if largest is not None and _corners(other) <= _corners(largest):
                break
            if cv2.findChessboardCorners(small, (other.columns, other.rows))[0]:
                largest = other
                break
    return largest


def _near(board: Board) -> Iterator[Board]:
    for columns in range(max(3, board.columns - 2), board.columns + 3):
        for rows in range(max(3, board.rows - 2), board.rows + 3):
            if (columns, rows) != (board.columns, board.rows):
                yield Board(columns, rows, board.square)


def _corners(board: Board) -> int:
    return board.columns * board.rows


def _reduced(gray: Gray, most: int) -> tuple[Gray, float]:
    """The image with no side longer than `most` [px], and how many times larger it was."""
    by = max(1.0, max(gray.shape) / most)
    if by == 1.0:
        return gray, by
    small = cv2.resize(gray, None, fx=1 / by, fy=1 / by, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), by


def _spacing(corners: NDArray[np.floating], board: Board) -> float:
    grid = corners.reshape(board.rows, board.columns, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    return float(min(across.min(), down.min()))
