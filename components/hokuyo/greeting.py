"""Finds out how a sensor speaks, whatever a program before us has left it doing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cairn.components.hokuyo.dialogue import Dialogue
from cairn.components.hokuyo.replies import Reply
from cairn.driver.errors import DeviceError, LinkLost

SPEEDS = (115200, 19200, 57600, 750000, 500000, 250000, 38400)
"""All that command SS knows [bit/s], the usual ones first."""

_QUIET_S, _QUIET_LIMIT_S = 0.14, 0.5
_TRIES = 4
_TOLD = 40  # bytes, of what is not understood


@dataclass(frozen=True)
class Greeting:
    """What a sensor turned out to speak: SCIP 2, else 1.1; at which speed [bit/s]."""

    scip2: bool
    baud: int


def greet(dialogue: Dialogue, speeds: Sequence[int]) -> Greeting:
    """Bring a sensor to rest, at the first of these speeds at which it answers.

    It may be streaming, be in the mode that adjusts clocks, or speak SCIP 1.1, from which it is
    switched to 2 if it can. Its laser is off then. Raises `DeviceError` if nothing answers.
    """
    for baud in speeds:
        try:
            dialogue.set_baud(baud)
        except LinkLost:
            raise
        except DeviceError:
            if baud == speeds[0]:
                raise  # this one was asked for
            continue
        scip2 = _at_rest(dialogue)
        if scip2 is not None:
            return Greeting(scip2, baud)
    tried = f" (tried {', '.join(map(str, speeds))} bit/s)" if len(speeds) > 1 else ""
    raise DeviceError(
        f"{dialogue.link.name}: nothing answers as a SCIP sensor{tried}; "
        + (
            f"what comes is no SCIP: {dialogue.last[-_TOLD:]!r}; is another device there?"
            if dialogue.last
            else "is it switched on, and is no other program using it?"
        )
    )


def _at_rest(dialogue: Dialogue) -> bool | None:
    """Whether it speaks SCIP 2; None if it does not answer."""
    dialogue.send("")  # ends whatever was begun on the line
    dialogue.quieten(_QUIET_S, _QUIET_LIMIT_S)
    refusal = ""
    for _ in range(_TRIES):
        before = dialogue.heard
        dialogue.send("QT")
        reply = dialogue.find("QT")
        if reply is None:
            if dialogue.heard == before:
                break
            continue  # something is there: the answer may be damaged, or stand behind a scan
        match reply.status:
            case b"00P":
                return True
            case b"0" | b"E":
                return _switched(dialogue)
            case b"0Ee" | b"10Q":  # it adjusts clocks, and takes nothing else
                dialogue.send("TM2")
                dialogue.find("TM2")
            case other:
                refusal = other.decode("ascii", "replace")
    if refusal:
        raise DeviceError(
            f"{dialogue.link.name}: a sensor is there, but answers QT with status {refusal}: it is "
            "starting, or has a defect; see its manual"
        )
    return None


def _switched(dialogue: Dialogue) -> bool:
    dialogue.send("L0")  # it knows no QT, and may be measuring
    dialogue.find("L0")
    dialogue.send("SCIP2.0")
    reply: Reply | None = dialogue.find("SCIP2.0")
    return reply is not None and reply.status == b"0"
