"""Numeric sequences of messages: read-only numpy arrays, made without loss from what is given."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Check = Callable[[npt.NDArray[Any]], None]


def array_validator(
    dtype: np.dtype[Any], length: int | None, check: Check | None
) -> Callable[[object], npt.NDArray[Any]]:
    """A function that makes a one-dimensional read-only array of `dtype` of any sequence.

    It raises `ValueError` if that loses something, if there are not `length` elements, or if
    `check` does. A read-only array of the right type is taken as it is, without a copy.
    """

    def validate(value: object) -> npt.NDArray[Any]:
        if type(value) is np.ndarray and value.dtype is dtype:
            flags = value.flags
            taken = not flags.writeable and flags.c_contiguous and value.ndim == 1
            array = value if taken else _converted(value, dtype)
        else:
            array = _converted(value, dtype)
        if length is not None and array.size != length:
            raise ValueError(f"must have {length} elements, not {array.size}")
        if check is not None:
            check(array)
        return array

    return validate


def _converted(value: object, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    if isinstance(value, np.ndarray):
        source = value
    elif isinstance(value, bytes | bytearray | memoryview):
        source = np.frombuffer(value, np.uint8)
        if isinstance(value, bytes) and dtype == np.uint8:
            return source
    elif isinstance(value, list | tuple | range):
        source = _of_sequence(value, dtype)
    else:
        raise ValueError(f"must be a sequence of {dtype} numbers")
    if source.ndim != 1:
        raise ValueError(f"must be one-dimensional (.ravel() it), not of shape {source.shape}")
    array = np.array(source, dtype, order="C") if source.dtype == dtype else _cast(source, dtype)
    array.flags.writeable = False
    return array


def _of_sequence(values: "list[Any] | tuple[Any, ...] | range", dtype: np.dtype[Any]) -> Any:
    if not values:
        return np.zeros(0, dtype)
    try:
        source = np.asarray(values)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"must be a sequence of {dtype} numbers") from error
    if source.dtype == np.float64 and dtype == np.float32:
        # Python's floats have no width of their own: they are rounded, but not to infinity.
        with np.errstate(over="ignore"):
            single = source.astype(dtype)
        if np.isfinite(source).tobytes() != np.isfinite(single).tobytes():
            raise ValueError("must hold numbers that fit float32")
        return single
    return source


def _cast(source: npt.NDArray[Any], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    kinds = (source.dtype.kind, dtype.kind)
    if source.dtype.kind not in "biuf" or ("b" in kinds and kinds != ("b", "b")):
        raise ValueError(f"must be a sequence of {dtype} numbers, not of {source.dtype}")
    if source.size == 0:
        return np.zeros(0, dtype)
    if kinds[0] in "iu" and kinds[1] in "iu":
        limits = np.iinfo(dtype)
        lossless = limits.min <= int(source.min()) and int(source.max()) <= limits.max
        array = source.astype(dtype)
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            array = source.astype(dtype)
            lossless = np.array_equal(array.astype(source.dtype), source, equal_nan=True)
    if not lossless:
        raise ValueError(f"must hold numbers that {dtype} represents exactly")
    return array
