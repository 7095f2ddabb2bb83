"""Gives an order to move from a terminal and tells how it gets on, until its result."""

from __future__ import annotations

import math
import queue
import secrets
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from cairn import CairnError
from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.control import ControlError, NoReplyError, request
from cairn.cli.connection import Connection
from cairn.cli.tables import OutputLost, line, note, print_json
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    NavigationStatus,
)
from cairn.schemas.message import InvalidMessage
from cairn.supervisors.mobile.reaching import await_active, linked

# AutoMove tells twice a second how it gets on; what is told is repeated so often, if it is no news.
_REPEAT_S = 5.0
# After so long without a word the supervisor is asked, again and again; it may be started anew and
# go on with the order; after so long it has not, and after so long nobody has [s].
_SILENT_S, _LOST_S, _GONE_S = 3.0, 8.0, 20.0
_LOADING_S = 90.0  # beyond what a component takes to start, unless it is given more
_ANSWER_S = 5.0


class Operator:
    """Whoever gives orders to one mobile supervisor."""

    def __init__(self, connection: Connection, supervisor: str) -> None:
        """`supervisor` is its full name (`/robot/mobile_supervisor`)."""
        self._connection = connection
        self._supervisor = supervisor
        self._codec = Codec()
        self._token = secrets.token_hex(8)

    def go(self, goals: Sequence[Sequence[float]]) -> int:
        """Give an order; its number."""
        asked = {"goals": [list(goal) for goal in goals], "token": self._token}
        return int(self._ask("go", asked, _LOADING_S)["mission_id"])

    def cancel(self) -> int:
        """Take back whichever order is under way; its number."""
        return self._cancel({})

    def cancel_own(self) -> int:
        """Take back the order that was given here, answered or not yet; its number."""
        return self._cancel({"token": self._token})

    def order(self) -> dict[str, Any] | None:
        """The last order with its result, empty if it is under way; None if there was none."""
        order: dict[str, Any] | None = self._ask("mission", {}, _ANSWER_S)
        return order

    def linked(self) -> bool:
        """Whether the deployment is still there."""
        return linked(self._connection)

    @contextmanager
    def statuses(self) -> Iterator[queue.Queue[Any]]:
        """All that is told of orders from now on, as samples."""
        topic = f"{self._supervisor.rpartition('/')[0]}/navigation_status"
        key = keys.message_key(self._connection.domain, topic, NavigationStatus, self._codec)
        with self._connection.listen(key, latched=True) as samples:
            yield samples

    def next_status(self, samples: queue.Queue[Any], wait_s: float) -> NavigationStatus | None:
        """The next that is told; None if nothing comes in time, or it is not readable."""
        try:
            sample = samples.get(timeout=wait_s)
            return self._codec.decode(NavigationStatus, sample.payload.to_bytes())
        except (queue.Empty, InvalidMessage):
            return None

    def _cancel(self, which: dict[str, Any]) -> int:
        try:
            answer = self._ask("cancel", which, _LOADING_S)
        except NoReplyError:  # it hung and was killed; started anew, it goes on with the order
            await_active(self._connection, self._supervisor)
            answer = self._ask("cancel", which, _LOADING_S)
        return int(answer["mission_id"])

    def _ask(self, verb: str, arguments: dict[str, Any], limit_s: float) -> Any:
        connection = self._connection
        return request(
            connection.session,
            connection.domain,
            self._supervisor,
            verb,
            arguments,
            timeout_s=limit_s,
        )


@contextmanager
def refusals_told(*, as_json: bool) -> Iterator[None]:
    """Print a refusal as JSON, if that is asked for, before it goes on as the error that it is."""
    try:
        yield
    except CairnError as error:
        if as_json:
            state = "unanswered" if isinstance(error, NoReplyError) else "refused"
            print_json({"state": state, "reason": str(error)})
        raise


def follow(operator: Operator, goals: Sequence[Sequence[float]], *, as_json: bool) -> None:
    """Give an order and tell how it gets on; Ctrl-C, SIGTERM and a closed terminal cancel it.

    Raises `CairnError` if it does not end at its goal, `SystemExit` after SIGTERM or SIGHUP.
    """
    with _exit_on(signal.SIGTERM, signal.SIGHUP), operator.statuses() as samples:
        try:
            with refusals_told(as_json=as_json):
                order = operator.go(goals)
            if not as_json:
                line(f"order {order}: go to {', then '.join(map(_place, goals))}; Ctrl-C cancels")
            status = _await_end(operator, order, samples, as_json=as_json)
        except (KeyboardInterrupt, SystemExit, BrokenPipeError, OutputLost):
            _take_back(operator, as_json=as_json)
            raise
    if as_json:
        print_json(_fields(status))
    state = NAVIGATION_STATES[status.state]
    if status.state != NavigationStatus.SUCCEEDED:
        raise CairnError(f"order {order} {state} after {status.elapsed:.1f} s: {status.reason}")
    if not as_json:
        line(f"{status.elapsed:6.1f} s  {status.reason}")


@contextmanager
def _exit_on(*numbers: signal.Signals) -> Iterator[None]:
    """Turn signals into `SystemExit` with the status that a shell gives them."""
    heeded = [one for one in numbers if signal.getsignal(one) is not signal.SIG_IGN]  # nohup

    def leave(number: int, _frame: object) -> None:
        for one in heeded:  # a terminal that closes may hang up twice
            signal.signal(one, signal.SIG_IGN)
        raise SystemExit(128 + number)

    before = {number: signal.signal(number, leave) for number in heeded}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def _take_back(operator: Operator, *, as_json: bool) -> None:
    with suppress(OSError, OutputLost):  # whoever is told may have closed the terminal
        try:
            order = operator.cancel_own()
        except CairnError as error:  # it has just ended, was pre-empted, or its robot has gone
            note(f"nothing is canceled: {error}")
            return
        if as_json:
            print_json({"mission_id": order, "state": "canceled"})
        else:
            line("canceled: the robot stops")


def _await_end(
    operator: Operator, order: int, samples: queue.Queue[Any], *, as_json: bool
) -> NavigationStatus:
    last = NavigationStatus(mission_id=order)
    told: tuple[int | str, ...] | None = None
    told_at = 0.0
    heard = asked = time.monotonic()
    while True:
        status = operator.next_status(samples, 0.5)
        now = time.monotonic()
        if status is not None and status.mission_id > order:
            raise CairnError(f"order {order} was pre-empted by order {status.mission_id}")
        if status is not None and status.mission_id == order:
            last, heard = status, now
            if status.state in NAVIGATION_END_STATES:
                return status
            loading = status.reason if status.state == NavigationStatus.LOADING else ""
            news = (status.state, status.goal, status.reason_code, status.recoveries, loading)
            if not as_json and (news != told or now - told_at >= _REPEAT_S):
                told, told_at = news, now
                line(_sentence(status))
        elif now - heard > _SILENT_S and now - asked > 1.0:
            asked = now
            if not operator.linked():
                raise CairnError(f"order {order}: the deployment has ended, and with it the order")
            try:
                ended = _result(order, operator.order(), last, now - heard)
            except ControlError as error:
                if now - heard > _GONE_S:
                    raise CairnError(
                        f"nothing was heard of order {order} for {now - heard:.0f} s: {error}"
                    ) from error
                continue
            if ended is not None:
                return ended
            if now - heard > _LOADING_S:
                raise CairnError(
                    f"AutoMove has said nothing of order {order} for {now - heard:.0f} s; see "
                    "`cairn ps` and `cairn logs`"
                )


def _result(
    order: int, found: dict[str, Any] | None, last: NavigationStatus, silent_s: float
) -> NavigationStatus | None:
    """The result by the supervisor's word, None if the order is under way."""
    if found is None or int(found["mission_id"]) < order:
        if silent_s < _LOST_S:
            return None
        raise CairnError(
            f"order {order} was lost: its supervisor was started anew and does not know it; the "
            "robot stands"
        )
    if int(found["mission_id"]) > order:
        raise CairnError(f"order {order} was pre-empted by order {found['mission_id']}")
    state, _, reason = str(found["result"]).partition(": ")
    for number, name in NAVIGATION_STATES.items():
        if state == name:
            return NavigationStatus(
                mission_id=order,
                state=number,
                goal=last.goal,
                goals=last.goals,
                elapsed=last.elapsed,
                recoveries=last.recoveries,
                reason=reason,
            )
    return None


def _place(goal: Sequence[float]) -> str:
    return f"({goal[0]:.2f}, {goal[1]:.2f}, {math.degrees(goal[2]):.0f} deg)"


def _sentence(status: NavigationStatus) -> str:
    of = f"goal {status.goal + 1} of {status.goals}: " if status.goals > 1 else ""
    left = ""
    if status.state == NavigationStatus.DRIVING and status.distance_left > 0.0:
        left = f": {status.distance_left:.1f} m left, about {status.time_left:.0f} s"
    why = f"{', but' if left else ':'} {status.reason}" if status.reason else ""
    return f"{status.elapsed:6.1f} s  {of}{NAVIGATION_STATES[status.state]}{left}{why}"


def _fields(status: NavigationStatus) -> dict[str, object]:
    return {
        "mission_id": status.mission_id,
        "state": NAVIGATION_STATES[status.state],
        "goal": status.goal,
        "goals": status.goals,
        "elapsed_s": status.elapsed,
        "recoveries": status.recoveries,
        "reason": status.reason,
    }
