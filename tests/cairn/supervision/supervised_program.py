"""A small deployment of real processes: what the root, a supervisor and a component do.

The root supervises `base`, which has a helper, and `mobile`, which supervises `localizer` and
`planner`. Each reports to the test, and takes requests from its supervisor over a socket. In a
`ChildSpec`, `plugin` is the name of the function below.
"""

import queue
import signal
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from cairn import CairnError
from cairn.deployment.model import ChildSpec, Supervision
from cairn.process_exit import ExitReport
from cairn.supervision.child import ChildEvent, Verb
from cairn.supervision.supervisor import ChildGroup, Escalate
from cairn.supervision.zygote_client import ChildProcess, ZygoteClient, ZygoteLost
from cairn.supervision.zygote_process import start_zygote
from tests.patience import LIMIT_S

from .reports import Report, Reports
from .zygote_children import announce, keep_helper_of

MODULE = f"{__package__}.supervised_program"


class SocketHandle:
    """A component in a process, which answers "ok" to requests."""

    def __init__(self, process: ChildProcess, control: Report) -> None:
        self.process = process
        self.control = control
        self.terminate = process.terminate
        self.kill = process.kill

    def request(self, verb: Verb, timeout_s: float) -> None:
        self.control.connection.settimeout(timeout_s)
        try:
            self.control.lines.write(f"{verb}\n")
            self.control.lines.flush()
            answer = self.control.lines.readline()
        except OSError as error:
            raise CairnError(f"{self.process.name} did not {verb}: {error}") from error
        if answer != "ok\n":
            raise CairnError(f"{self.process.name} did not {verb}: it has ended")

    def wait(self, timeout_s: float) -> ExitReport | None:
        exited = self.process.wait(timeout_s)
        return None if exited is None else ExitReport(exited.code == 0, str(exited))


class SupervisorProcess:
    """A supervisor with its connection to the zygote, and the loop that drives it."""

    def __init__(self, name: str, children: dict[str, ChildSpec], argument: dict[str, Any]) -> None:
        self.name = name
        self.argument = argument
        self.inbox: queue.SimpleQueue[str | ZygoteLost] = queue.SimpleQueue()
        self.controls = Reports(Path(tempfile.mkdtemp(dir=argument["directory"])))
        self.children = ChildGroup(
            name,
            children,
            Supervision(max_restarts=2, within_s=60.0),
            self,
            observe=self.observe,
            report_progress=lambda step: None,
            on_exit=lambda: self.inbox.put("exit"),
        )

    def launch(
        self,
        name: str,
        spec: ChildSpec,
        incarnation: int,
        previous_exit: str,
        on_exit: Callable[[], None],
    ) -> SocketHandle:
        argument = {**self.argument, "name": name, "controls": self.controls.path}
        argument["incarnation"] = incarnation
        entry = f"{MODULE}:{spec.plugin}"
        process = self.client.spawn(name, entry, argument, Path(argument["log"]))
        process.on_exit(lambda _: on_exit())
        return SocketHandle(process, self.controls.of(name))

    def request_stop(self) -> None:
        """Do nothing: a start is not cut short."""

    def observe(self, event: ChildEvent) -> None:
        sys.stderr.write(f"{self.name}: {event.child} {event.kind} {event.reason}\n")

    def connect(self, zygote: Path) -> None:
        self.argument["zygote"] = str(zygote)
        self.client = ZygoteClient(zygote, self.inbox.put)

    def react(self) -> bool:
        """Wait for an event and handle it; return False for a request to stop."""
        event = self.inbox.get(timeout=LIMIT_S * 2)
        if event == "stop" or self.children.stop_requested:
            return False
        if isinstance(event, ZygoteLost):
            raise event
        self.children.reconcile()
        return True


def component(argument: dict[str, Any]) -> None:
    """Do what is requested."""
    control = announce({**argument, "reports": argument["controls"]})
    with control.makefile("rw") as requests:
        answer(requests, "configure", "activate")
        with announce(argument, incarnation=argument["incarnation"]):
            answer(requests, "deactivate", "shutdown")


def base(argument: dict[str, Any]) -> None:
    """Do what is requested, with a helper process."""
    keep_helper_of({**argument, "how": "own session"})
    component(argument)


def supervise(argument: dict[str, Any]) -> None:
    """Supervise two components, whether or not anything is requested, until shut down."""
    children = {name: ChildSpec(plugin="component") for name in ("localizer", "planner")}
    process = SupervisorProcess("mobile", children, dict(argument))
    signal.signal(signal.SIGTERM, lambda *_: process.inbox.put("stop"))
    process.connect(Path(argument["zygote"]))
    process.children.start_all()
    control = announce({**argument, "reports": argument["controls"]})
    with control.makefile("rw") as requests:
        answer(requests, "configure", "activate")
        with announce(argument, incarnation=argument["incarnation"]):
            while process.react():
                pass
            process.children.stop_all()


def answer(requests: TextIO, *verbs: Verb) -> None:
    """Answer requests, which are to come in this order, with "ok"."""
    for verb in verbs:
        assert requests.readline() == f"{verb}\n"
        requests.write("ok\n")
        requests.flush()


def main() -> int:
    """The root: arguments are a directory and the path of the test's socket."""
    directory, reports = Path(sys.argv[1]), sys.argv[2]
    argument = {"directory": str(directory), "reports": reports, "log": str(directory / "log")}
    children = {
        "base": ChildSpec(plugin="base"),
        "mobile": ChildSpec(plugin="supervise", stop_timeout_s=0.2),
    }
    process = SupervisorProcess("root", children, argument)

    def stop(*_: object) -> None:
        process.children.request_stop()
        process.inbox.put("stop")

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    code = 0
    again = True
    while again:
        zygote = start_zygote([MODULE], directory / "run")
        process.connect(zygote.socket_path)
        again = False
        try:
            process.children.start_all()
            with announce({**argument, "name": "root"}, zygote=zygote.pid):
                while process.react():
                    pass
        except ZygoteLost:
            again = True
        except Escalate as error:
            announce({**argument, "name": "escalation"}, reason=str(error)).close()
            code = 1
        process.children.stop_all()
        process.client.close()
        zygote.close()
    return code


if __name__ == "__main__":
    sys.exit(main())
