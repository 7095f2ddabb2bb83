"""Types of message fields: ROS 2 primitives, arrays and covariances, each with its validation.

They are annotations (`x: Float64`); `Scalar`, `Text` and `Array` make new ones with limits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from math import isfinite
from typing import Annotated, Any, get_origin

import numpy as np
import numpy.typing as npt
from pydantic_core import CoreSchema, core_schema

Check = Callable[[npt.NDArray[Any]], None]

INTEGER_LIMITS = {
    f"{sign}int{bits}": (0 if sign else -(2 ** (bits - 1)), 2 ** (bits if sign else bits - 1) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
} | {"byte": (0, 255), "char": (0, 255)}
"""The least and the greatest value of each integer type of ROS 2."""


@dataclass(frozen=True)
class Scalar:
    """Marks a field as a ROS 2 number or bool within limits; numpy scalars are accepted, too.

    `ros_type` is its name in a .msg file. A limit rules out NaN and infinities, as `finite` does.
    """

    ros_type: str
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    finite: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return how pydantic validates such a field."""
        strict = self._strict()
        # pydantic-core checks Python's own types; numpy's scalars are converted first.
        from_numpy = core_schema.chain_schema(
            [core_schema.no_info_plain_validator_function(_python_value), strict]
        )
        return core_schema.union_schema(
            [strict, from_numpy],
            mode="left_to_right",
            custom_error_type="scalar",
            custom_error_message=f"must be {self._requirement()}",
        )

    def _strict(self) -> CoreSchema:
        if self.ros_type == "bool":
            return core_schema.bool_schema(strict=True)
        if self.ros_type in INTEGER_LIMITS:
            low, high = self._integers()
            return core_schema.int_schema(strict=True, ge=low, le=high)
        above, at_least, at_most = self.above, self.at_least, self.at_most
        if self.ros_type == "float32":
            # Messages round float32 fields after this check, and the result must pass it, too.
            at_least, at_most = _rounded(at_least), _rounded(at_most)
            if above is not None:
                above = None
                at_least = float(np.nextafter(np.float32(self.above), np.float32(np.inf)))
        return core_schema.float_schema(
            strict=True, gt=above, ge=at_least, le=at_most, allow_inf_nan=not self._is_finite()
        )

    def _integers(self) -> tuple[int, int]:
        low, high = INTEGER_LIMITS[self.ros_type]
        if self.at_least is not None:
            low = max(low, int(self.at_least))
        if self.at_most is not None:
            high = min(high, int(self.at_most))
        return low, high

    def _is_finite(self) -> bool:
        return self.finite or (self.above, self.at_least, self.at_most) != (None, None, None)

    def _requirement(self) -> str:
        if self.ros_type == "bool":
            return "True or False"
        if self.ros_type in INTEGER_LIMITS:
            return "an integer from {} to {}".format(*self._integers())
        limits = [
            f"{word} {limit:g}"
            for word, limit in (
                ("above", self.above), ("at least", self.at_least), ("at most", self.at_most),
            )
            if limit is not None
        ]  # fmt: skip
        number = "a finite number" if self._is_finite() else "a number"
        return " ".join([number, " and ".join(limits)]).rstrip()


@dataclass(frozen=True)
class Text:
    """Marks a field as a ROS 2 string: UTF-8 without NUL; with `one_of`, one of these texts.

    With `most`, it is a bounded string of at most so many bytes.
    """

    one_of: tuple[str, ...] = ()
    most: int | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return how pydantic validates such a field."""
        if self.one_of:
            inner: CoreSchema = core_schema.literal_schema(list(self.one_of))
        else:
            inner = core_schema.str_schema(strict=True, pattern="^[^\x00]*$")
        if self.most is not None:
            inner = core_schema.no_info_after_validator_function(self._within_bound, inner)
        return core_schema.custom_error_schema(
            inner, custom_error_type="text", custom_error_message=f"must be {self.requirement}"
        )

    def _within_bound(self, text: str) -> str:
        if self.most is not None and len(text.encode()) > self.most:
            raise ValueError(f"must be {self.requirement}")
        return text

    @property
    def requirement(self) -> str:
        """What a text must be, for errors."""
        if self.one_of:
            return f"one of {', '.join(map(repr, self.one_of))}"
        length = "" if self.most is None else f" of at most {self.most} bytes"
        return f"a string{length} without NUL that UTF-8 can encode"


@dataclass(frozen=True)
class Array:
    """Marks a field as a ROS 2 sequence of numbers, or with `length` as an array of that length.

    `check` is called with the array and raises `ValueError` with the rule that it breaks. With
    `most`, it is a bounded sequence of at most so many numbers.
    """

    ros_type: str
    length: int | None = None
    check: Callable[[npt.NDArray[Any]], None] | None = None
    most: int | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return how pydantic validates such a field."""
        dtype = np.dtype("uint8" if self.ros_type in ("byte", "char") else self.ros_type)
        check = _truth_values if self.ros_type == "bool" else self.check
        return core_schema.no_info_plain_validator_function(
            array_validator(dtype, self.length, check, self.most)
        )


@dataclass(frozen=True)
class Several:
    """Marks a tuple of messages or texts as an array of `length`, or a sequence of at most `most`.

    A tuple without this mark is a sequence of any length.
    """

    length: int | None = None
    most: int | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return how pydantic validates such a field."""
        return core_schema.no_info_after_validator_function(self.checked, handler(source))

    def checked(self, items: Sequence[Any]) -> Sequence[Any]:
        """Return the items; raise `ValueError` if there are too many, or not as many as needed."""
        _check_count(len(items), self.length, self.most)
        return items


def several_of(annotation: object) -> Several | None:
    """Return the mark `Several` of an annotation, None if it has none."""
    if get_origin(annotation) is Annotated:
        for mark in annotation.__metadata__:  # type: ignore[attr-defined]
            if isinstance(mark, Several):
                return mark
    return None


def mark_of(annotation: object) -> "Scalar | Text | Array | None":
    """Return the mark of an annotation, None if it has none."""
    if get_origin(annotation) is Annotated:
        for mark in annotation.__metadata__:  # type: ignore[attr-defined]
            if isinstance(mark, Scalar | Text | Array):
                return mark
    return None


def finite(array: npt.NDArray[Any]) -> None:
    """Reject NaN and infinities; for `Array.check`."""
    if not np.isfinite(array).all():
        raise ValueError("must hold finite numbers only")


def zeros(length: int, dtype: npt.DTypeLike = np.float64) -> Any:
    """Return the default of an array field: `length` zeros, one read-only array for all."""
    value = np.zeros(length, dtype)
    value.flags.writeable = False
    return field(default_factory=lambda: value)


def empty(dtype: npt.DTypeLike) -> Any:
    """Return the default of a sequence of numbers: an empty one."""
    value = np.zeros(0, dtype)
    value.flags.writeable = False
    return field(default_factory=lambda: value)


Bool = Annotated[bool, Scalar("bool")]
Byte = Annotated[int, Scalar("byte")]
Int8 = Annotated[int, Scalar("int8")]
Int16 = Annotated[int, Scalar("int16")]
Int32 = Annotated[int, Scalar("int32")]
Int64 = Annotated[int, Scalar("int64")]
UInt8 = Annotated[int, Scalar("uint8")]
UInt16 = Annotated[int, Scalar("uint16")]
UInt32 = Annotated[int, Scalar("uint32")]
UInt64 = Annotated[int, Scalar("uint64")]
Float32 = Annotated[float, Scalar("float32")]
Float64 = Annotated[float, Scalar("float64")]
FiniteFloat32 = Annotated[float, Scalar("float32", finite=True)]
FiniteFloat64 = Annotated[float, Scalar("float64", finite=True)]
String = Annotated[str, Text()]

BoolArray = Annotated[npt.NDArray[np.bool_], Array("bool")]
Int8Array = Annotated[npt.NDArray[np.int8], Array("int8")]
Int16Array = Annotated[npt.NDArray[np.int16], Array("int16")]
Int32Array = Annotated[npt.NDArray[np.int32], Array("int32")]
Int64Array = Annotated[npt.NDArray[np.int64], Array("int64")]
UInt8Array = Annotated[npt.NDArray[np.uint8], Array("uint8")]
UInt16Array = Annotated[npt.NDArray[np.uint16], Array("uint16")]
UInt32Array = Annotated[npt.NDArray[np.uint32], Array("uint32")]
UInt64Array = Annotated[npt.NDArray[np.uint64], Array("uint64")]
Float32Array = Annotated[npt.NDArray[np.float32], Array("float32")]
Float64Array = Annotated[npt.NDArray[np.float64], Array("float64")]


_TOLERANCE = 1e-9  # relative to the largest entry: more than rounding, less than any error


def _check2(array: npt.NDArray[Any]) -> None:
    a, b, c, d = array.tolist()
    largest = max(abs(a), abs(b), abs(c), abs(d))
    if not isfinite(a + b + c + d) and not all(map(isfinite, (a, b, c, d))):
        raise ValueError("must hold finite numbers only")
    if largest == 0.0:
        return
    a, b, c, d = a / largest, b / largest, c / largest, d / largest
    if abs(b - c) > _TOLERANCE:
        raise ValueError("must be symmetric")
    if a < -_TOLERANCE or d < -_TOLERANCE or a * d - b * c < -_TOLERANCE:
        raise ValueError("must be positive semidefinite")


def _check3(array: npt.NDArray[Any]) -> None:
    values = array.tolist()
    if not all(map(isfinite, values)):
        raise ValueError("must hold finite numbers only")
    largest = max(map(abs, values))
    if largest == 0.0:
        return
    a, b, c, d, e, f, g, h, i = (value / largest for value in values)
    if max(abs(b - d), abs(c - g), abs(f - h)) > _TOLERANCE:
        raise ValueError("must be symmetric")
    # A symmetric matrix is positive semidefinite if and only if all principal minors are.
    minors = chain(
        (a, e, i),
        (a * e - b * d, a * i - c * g, e * i - f * h),
        (a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g),),
    )
    if min(minors) < -_TOLERANCE:
        raise ValueError("must be positive semidefinite")


Covariance2 = Annotated[npt.NDArray[np.float64], Array("float64", length=4, check=_check2)]
"""Covariance of 2 values, row-major 2x2: finite, symmetric, positive semidefinite."""

Covariance3 = Annotated[npt.NDArray[np.float64], Array("float64", length=9, check=_check3)]
"""Covariance of 3 values, row-major 3x3: finite, symmetric, positive semidefinite."""


def _rounded(limit: float | None) -> float | None:
    return None if limit is None else float(np.float32(limit))


def _python_value(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise ValueError


def _truth_values(array: npt.NDArray[Any]) -> None:
    # Data from the wire may have any byte in the place of a bool.
    if array.view(np.uint8).max(initial=0) > 1:
        raise ValueError("must hold the bytes 0 and 1 only")


def _check_count(count: int, length: int | None, most: int | None) -> None:
    if length is not None and count != length:
        raise ValueError(f"must have {length} elements, not {count}")
    if most is not None and count > most:
        raise ValueError(f"must have at most {most} elements, not {count}")


def array_validator(
    dtype: np.dtype[Any], length: int | None, check: Check | None, most: int | None = None
) -> Callable[[object], npt.NDArray[Any]]:
    """Return a function that converts any sequence to a one-dimensional read-only array of `dtype`.

    The function raises `ValueError` if the conversion would change a value, if there are not
    `length` elements or more than `most`, or if `check` does. It returns a read-only array of the
    right type without a copy.
    """

    def validate(value: object) -> npt.NDArray[Any]:
        if type(value) is np.ndarray and value.dtype is dtype:
            flags = value.flags
            unchanged = not flags.writeable and flags.c_contiguous and value.ndim == 1
            array = value if unchanged else _converted(value, dtype)
        else:
            array = _converted(value, dtype)
        _check_count(array.size, length, most)
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
        # Python's floats are not float64 on purpose: they are rounded, but not to infinity.
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
