"""A plugin that raises, wherever it does, is told with its name and cause, and supervised."""

import re

import pytest

from cairn.testing.launching import Launching
from tests.commands import cairn
from tests.faults.orders import set_fault

pytestmark = pytest.mark.processes


FAILS_AT_START = """
    components:
      beacon: {{plugin: test_beacon}}
      base: {{plugin: test_faulty, parameters: {{fault: raise, where: {where}}}}}
    """
ONCE = """
    components:
      beacon: {plugin: test_beacon}
      base: {plugin: test_faulty}
    """


@pytest.mark.parametrize("where", ["constructor", "on_configure", "on_activate"])
def test_one_that_raises_at_its_first_start_ends_the_deployment_at_once(
    launch: Launching, where: str
) -> None:
    run = launch(FAILS_AT_START.format(where=where))

    assert run.await_end() == 1

    failures = [line for line in run.lines if "ERROR   robot.root: base could not be star" in line]
    assert len(failures) == 1
    assert "ValueError: broken on purpose" in failures[0]
    run.await_line("beacon stopped: shut down")
    run.await_line("cairn: deployment0.yaml failed: on_activate: base: .*broken on purpose; logs: ")
    assert "Traceback" in run.log_of("base")


def test_one_that_raises_in_a_handler_is_restarted(launch: Launching) -> None:
    run = launch(ONCE)
    active = run.await_line("base active")
    pid = run.pid_of("base")

    set_fault(run, "raise")

    failed = run.await_line(
        rf"WARNING robot.root: base failed \(process {pid}, log {run.report}/logs/base.log\): "
        "tick: ValueError: broken on purpose",
        after=active,
    )
    run.await_line("base active", after=failed)
    assert "in tick" in run.log_of("base")
    assert run.stop() == 0


def test_one_that_publishes_nan_fails_before_it_reaches_the_bus(launch: Launching) -> None:
    run = launch(ONCE)
    active = run.await_line("base active")

    set_fault(run, "publish_nan")

    failed = run.await_line(
        r"base failed \(.*\): tick: .*geometry_msgs/msg/Vector3.*x = nan", after=active
    )
    run.await_line("base active", after=failed)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("abort", r"base was killed by SIGABRT \(process \d+, log .*/base.log\)"),
        ("exit", r"base ended with exit code 3 \(process \d+, log .*/base.log\)"),
        ("sys_exit", r"base failed \(.*\): tick: it called sys.exit\(3\)"),
    ],
)
def test_one_that_ends_its_process_is_restarted(launch: Launching, fault: str, told: str) -> None:
    run = launch(ONCE)
    active = run.await_line("base active")

    set_fault(run, fault)

    run.await_line("base active", after=run.await_line(told, after=active))


def test_one_that_cannot_be_imported_keeps_the_deployment_from_starting(launch: Launching) -> None:
    run = launch("components: {base: {plugin: test_broken}}")

    assert run.await_end() == 1

    run.await_line(
        r"deployment0.yaml:\d+: components.base.plugin: the module cairn_test_plugins.broken "
        "cannot be imported: RuntimeError: this module is broken on purpose"
    )
    assert not any("active" in line for line in run.lines)


@pytest.mark.parametrize("interpreter", ["shared", "fresh"])
def test_one_that_cannot_be_imported_where_components_run_is_named(
    launch: Launching, interpreter: str
) -> None:
    run = launch(
        f"""
    supervision: {{max_restarts: 0}}
    components:
      moody: {{plugin: "cairn_test_plugins.moody:Moody", interpreter: {interpreter}}}
    """
    )

    assert run.await_end() == 1

    run.await_line(
        "moody could not be started: .*cairn_test_plugins.moody cannot be imported: "
        "RuntimeError: not in this environment"
    )


def test_one_in_its_parents_process_that_raises_is_restarted_there(launch: Launching) -> None:
    run = launch(
        """
    components:
      mobile:
        plugin: supervisor
        children:
          base: {plugin: test_faulty, placement: in_process}
          beacon: {plugin: test_beacon, placement: in_process}
    """
    )
    active = run.await_line("mobile active")
    mobile = run.pid_of("mobile")
    statuses = {row["component"]: row for row in cairn("ps", "--json", connect=run.endpoint).json}
    assert statuses["/robot/base"]["pid"] == mobile

    set_fault(run, "raise")

    failed = run.await_line(
        "WARNING robot.mobile: base failed: tick: ValueError: broken on purpose", after=active
    )
    run.await_line("base active", after=failed)
    assert run.pid_of("mobile") == mobile
    assert not any(re.search("beacon (ended|failed|stopped)", line) for line in run.lines)
    assert run.stop() == 0


def test_one_with_a_fresh_interpreter_is_restarted(launch: Launching) -> None:
    run = launch("components: {base: {plugin: test_faulty, interpreter: fresh}}")
    active = run.await_line("base active")

    set_fault(run, "abort")

    run.await_line("base active", after=run.await_line("base was killed by SIGABRT", after=active))
    assert run.stop() == 0
