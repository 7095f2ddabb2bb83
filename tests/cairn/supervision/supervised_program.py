"""A small deployment of real processes: what the root, a supervisor and a component do.

The root supervises `base`, which has a helper, and `mobile`, which supervises `localizer` and
`planner`. Each tells the test of itself, and takes requests from its supervisor over a socket.
"""

import queue
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any, TextIO

from cairn import CairnError
from cairn.supervision.child import ChildEnd, ChildRules, Verb
from cairn.supervision.child_process import ChildExit, ChildProcess
from cairn.supervision.events import SupervisionEvent
from cairn.supervision.policy import Intensity
from cairn.supervision.supervisor import Escalate, Supervisor
from cairn.supervision.zygote_client import ZygoteClient, ZygoteLost
from cairn.supervision.zygote_process import start_zygote
from tests.patience import LIMIT_S

from .reports import Report, Reports
from .zygote_children import announce, keep_helper_of

MODULE = f"{__package__}.supervised_program"
ENTRIES = {"base": "base", "mobile": "supervise", "localizer": "component", "planner": "component"}


class ProcessChild:
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

    def wait(self, timeout_s: float) -> ChildEnd | None:
        how = self.process.wait(timeout_s)
        return None if how is None else ChildEnd(how.normal, str(how))


class Household:
    """A supervisor with its connection to the zygote, and the loop that drives it."""

    def __init__(self, name: str, children: list[ChildRules], argument: dict[str, Any]) -> None:
        self.name = name
        self.argument = argument
        self.happened: queue.SimpleQueue[ChildExit | ZygoteLost | None] = queue.SimpleQueue()
        self.controls = Reports(Path(tempfile.mkdtemp(dir=argument["directory"])))
        self.supervisor = Supervisor(
            name,
            children,
            self,
            observe=self.observe,
            progress=lambda text, limit_s: None,
            intensity=Intensity(2, 60.0),
        )

    def launch(self, spec: ChildRules, incarnation: int, previous_exit: str) -> ProcessChild:
        argument = {**self.argument, "name": spec.name, "controls": self.controls.path}
        argument["incarnation"] = incarnation
        entry = f"{MODULE}:{ENTRIES[spec.name]}"
        process = self.client.spawn(spec.name, entry, argument, Path(argument["log"]))
        return ProcessChild(process, self.controls.of(spec.name))

    def observe(self, event: SupervisionEvent) -> None:
        sys.stderr.write(f"{self.name}: {event.child} {event.what} {event.reason}\n")

    def connect(self, zygote: Path) -> None:
        self.argument["zygote"] = str(zygote)
        self.client = ZygoteClient(zygote, self.happened.put, self.happened.put)

    def react(self) -> bool:
        """Wait for something to happen and see to it; False for a request to stop."""
        what = self.happened.get(timeout=LIMIT_S * 2)
        if what is None or self.supervisor.stop_requested:
            return False
        if isinstance(what, ZygoteLost):
            raise what
        self.supervisor.reconcile()
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
    children = [ChildRules("localizer"), ChildRules("planner")]
    household = Household("mobile", children, dict(argument))
    signal.signal(signal.SIGTERM, lambda *_: household.happened.put(None))
    household.connect(Path(argument["zygote"]))
    household.supervisor.start_all()
    control = announce({**argument, "reports": argument["controls"]})
    with control.makefile("rw") as requests:
        answer(requests, "configure", "activate")
        with announce(argument, incarnation=argument["incarnation"]):
            while household.react():
                pass
            household.supervisor.stop_all()


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
    children = [ChildRules("base"), ChildRules("mobile", stop_timeout_s=0.2)]
    household = Household("root", children, argument)

    def stop(*_: object) -> None:
        household.supervisor.request_stop()
        household.happened.put(None)

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    code = 0
    again = True
    while again:
        zygote = start_zygote([MODULE], directory / "run")
        household.connect(zygote.socket_path)
        again = False
        try:
            household.supervisor.start_all()
            with announce({**argument, "name": "root"}, zygote=zygote.pid):
                while household.react():
                    pass
        except ZygoteLost:
            again = True
        except Escalate as error:
            announce({**argument, "name": "escalation"}, reason=str(error)).close()
            code = 1
        household.supervisor.stop_all()
        household.client.close()
        zygote.close()
    return code


if __name__ == "__main__":
    sys.exit(main())
