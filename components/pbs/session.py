"""A conversation with a PBS-03JN: link code, link, distances again and again. Knows no line."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs import messages
from cairn.components.pbs.frames import framed

_ANSWER_S = 0.3  # an answer with distances takes 0.05 s on the line
_RENEW_S = 2.0  # of the three seconds for which the link holds
_TRIES = 4  # for a link, before the link code is asked for anew
_MISSED = 3  # answers with distances, before the link is asked for anew
_SILENT = 8  # requests of any kind in a row: nobody is there

_Question = Literal["code", "link", "distances"]


class Session:
    """Asks one thing at a time, and takes whatever answer comes. Times are of one clock [s]."""

    def __init__(self, period_s: float) -> None:
        """`period_s`: time from asking for distances to asking again [s]."""
        self.linked = False
        self.refusals = 0
        """How often it has refused the link since it granted it last."""
        self.missed = 0
        """Requests that were not answered so far."""
        self._period_s = period_s
        self._code: bytes | None = None
        self._asked: _Question | None = None
        self._asked_at = -math.inf
        self._linked_at = -math.inf
        self._distances_at = -math.inf
        self._failed: dict[_Question, int] = {"code": 0, "link": 0, "distances": 0}
        self._unanswered = 0

    @property
    def silent(self) -> bool:
        """Whether nothing was answered for so long that nobody can be there."""
        return self._unanswered >= _SILENT

    @property
    def asked_at(self) -> float:
        """When distances were asked for last [s]."""
        return self._distances_at

    def due(self) -> float:
        """When `step` has something to do next [s]."""
        if self._asked is not None:
            return self._asked_at + _ANSWER_S
        if self._code is None or not self.linked:
            return -math.inf
        return min(self._linked_at + _RENEW_S, self._distances_at + self._period_s)

    def step(self, now: float) -> bytes | None:
        """What is to be sent now, if anything."""
        if now < self.due():
            return None
        if self._asked is not None:
            self._miss(self._asked)
        if self._code is None:
            return self._ask("code", messages.LINK_CODE, now)
        if not self.linked or now >= self._linked_at + _RENEW_S:
            return self._ask("link", messages.link_request(self._code), now)
        self._distances_at = now
        return self._ask("distances", messages.DISTANCES, now)

    def heard(self, payload: bytes, now: float) -> NDArray[np.int32] | None:
        """Take an answer, also one that was not asked for just now; distances [mm], if it has any.

        Now and then distances come where the link was to be confirmed: they are good all the same.
        """
        code, linked = messages.link_code(payload), messages.linked(payload)
        distances = messages.distances(payload)
        if code is not None:
            self._code = code
            self._answered("code")
        elif linked is not None:
            self.linked, self._linked_at = linked, now
            if linked:
                self._answered("link")
                self.refusals = 0
            else:
                self._code = None  # it may have another one by now
                self.refusals += 1
                self._asked, self._asked_at = "link", now  # it is asked again a little later
        elif distances is not None:
            self._answered("distances")
        return distances

    def farewell(self) -> bytes | None:
        """What ends the link, if there is one."""
        if self._code is None or not self.linked:
            return None
        self.linked = False
        return framed(messages.link_request(self._code, on=False))

    def _ask(self, question: _Question, payload: bytes, now: float) -> bytes:
        self._asked, self._asked_at = question, now
        return framed(payload)

    def _answered(self, question: _Question) -> None:
        self._unanswered = self._failed[question] = 0
        if self._asked == question:
            self._asked = None

    def _miss(self, question: _Question) -> None:
        self._asked = None
        self.missed += 1
        self._unanswered += 1
        self._failed[question] += 1
        limits: dict[_Question, tuple[int, Callable[[], None]]] = {
            "link": (_TRIES, self._forget_code),
            "distances": (_MISSED, self._forget_link),
        }
        if question in limits and self._failed[question] >= limits[question][0]:
            self._failed[question] = 0
            limits[question][1]()

    def _forget_code(self) -> None:
        self._code, self.linked = None, False

    def _forget_link(self) -> None:
        self.linked = False
