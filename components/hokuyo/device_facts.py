"""What a sensor says of itself: PP (its measuring), VV (who made it), II (how it is)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cairn.components.hokuyo.scip_text import ScipError, check_sum


@dataclass(frozen=True)
class Measuring:
    """How a sensor measures. Command PP.

    Angles are counted in steps, of which a full turn has `turn_steps`, to the left; at step
    `front` it looks ahead.
    """

    model: str
    least_mm: int
    most_mm: int
    turn_steps: int
    first: int
    last: int
    front: int
    rpm: int

    @property
    def turn_s(self) -> float:
        """Time of a turn of its mirror [s]."""
        return 60.0 / self.rpm


# Sensors that speak SCIP 1.1 alone cannot be asked; there is one: the first URG-04LX.
URG_04LX = Measuring("URG-04LX", 20, 5600, 1024, 44, 725, 384, 600)


def keyed(lines: Sequence[bytes]) -> dict[str, str]:
    """The values of lines such as `MODL:UTM-30LX;3`, by key, their check sums verified.

    Sensors sum up the line with its semicolon or without it, and the UTM-30LX leaves out what
    stands behind `<-` in a line of II. Raises `ScipError` if no such sum is right.
    """
    found = {}
    for line in lines:
        text, given = line[:-1], line[-1:]
        summed = (text, text.removesuffix(b";"), text.partition(b"<-")[0])
        if not any(check_sum(one) == given for one in summed):
            raise ScipError(f"the check sum of {line!r} is wrong")
        key, colon, value = text.decode("ascii", "replace").removesuffix(";").partition(":")
        if colon:
            found[key.strip()] = value.strip()
    return found


def measuring(values: Mapping[str, str]) -> Measuring:
    """How a sensor measures, from the values of PP; keys that are not known are left alone.

    Raises `ScipError` naming what is missing or cannot be.
    """
    keys = ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")
    try:
        numbers = [int(values[key]) for key in keys]
    except KeyError as error:
        raise ScipError(f"the answer to PP has no {error.args[0]}") from error
    except ValueError as error:
        raise ScipError(f"the answer to PP has a number that is none: {error}") from error
    found = Measuring(values.get("MODL", "unknown"), *numbers)
    if not (
        0 <= found.least_mm < found.most_mm
        and 0 <= found.first < found.last
        and found.turn_steps > 0
        and found.last - found.first < found.turn_steps
        and found.rpm > 0
    ):
        raise ScipError(f"the answer to PP cannot be: {dict(values)}")
    return found
