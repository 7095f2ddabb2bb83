"""A plugin that fails in any call is logged with its name and cause, and supervised."""

import re

import pytest

from cairn.testing.launching import Launching
from tests.commands import cairn
from tests.faults.requests import set_fault
from tests.sweeps import sampled

pytestmark = pytest.mark.processes


FAILS_AT_START = """
    components:
      beacon: {{plugin: test_beacon}}
      base:
        plugin: test_faulty
        start_timeout_s: 600  # longer than the test waits: the end of the process must be noticed
        parameters: {{fault: raise, where: {where}}}
    """


@pytest.mark.parametrize("where", sampled(["constructor", "on_configure", "on_activate"]))
def test_plugin_that_raises_at_its_first_start_ends_the_deployment_at_once(
    launch: Launching, where: str
) -> None:
    run = launch(FAILS_AT_START.format(where=where))

    assert run.await_end() == 1

    failures = [line for line in run.lines if "robot.root: child start failed: base: " in line]
    assert len(failures) == 1
    assert "ValueError: broken on purpose" in failures[0]
    assert len([line for line in run.lines if " ERROR " in line]) == 1
    run.await_line("child stopped: beacon: shut down")
    run.await_line("cairn: deployment0.yaml failed: base: .*broken on purpose.*; logs: ")
    assert "Traceback" in run.log_of("base")


def test_components_that_fail_while_running_are_restarted_and_the_cause_is_logged(
    launch: Launching,
) -> None:
    expected = {
        "raise": r"tick: ValueError: broken on purpose \(process {pid}, log {log}\)",
        "publish_nan": r"tick: .*geometry_msgs/msg/Vector3.*x = nan",
        "abort": r"killed by SIGABRT \(signal 6\) \(process {pid}, log {log}\)",
        "exit": r"exit code 3: .* \(process {pid}, log {log}\)",
        "sys_exit": r"tick: it called sys.exit\(3\)",
    }
    components = "".join(
        f"      {fault}: {{plugin: test_faulty, topics: {{velocity: {fault}}}}}\n"
        for fault in expected
    )
    run = launch(
        f"""
    stop_limit_s: 60
    supervision: {{max_restarts: 10}}
    components:
{components}      fresh_abort: {{plugin: test_faulty, interpreter: fresh}}
    """
    )
    active = run.await_line("child active: fresh_abort")
    pids = {fault: run.pid_of(fault) for fault in expected}

    for fault in expected:
        set_fault(run, fault, fault)
    set_fault(run, "abort", "fresh_abort")

    for fault, cause in expected.items():
        log = f"{run.report}/logs/{fault}.log"
        reason = cause.format(pid=pids[fault], log=log)
        failed = run.await_line(
            f"WARNING robot.root: child failed: {fault}: {reason}", after=active
        )
        run.await_line(f"child active: {fault}", after=failed)
    failed = run.await_line("child failed: fresh_abort: killed by SIGABRT", after=active)
    run.await_line("child active: fresh_abort", after=failed)
    assert "in tick" in run.log_of("raise"), "the log has no traceback"
    assert run.stop() == 0


@pytest.mark.accuracy
def test_deployment_with_a_broken_plugin_does_not_start(
    launch: Launching,
) -> None:
    run = launch("components: {base: {plugin: test_broken}}")

    assert run.await_end() == 1

    run.await_line(
        r"deployment0.yaml:\d+: components.base.plugin: the module cairn_test_plugins.broken "
        "cannot be imported: RuntimeError: this module is broken on purpose"
    )
    assert not any("active" in line for line in run.lines)


@pytest.mark.accuracy
@pytest.mark.parametrize("interpreter", sampled(["shared", "fresh"]))
def test_plugin_that_cannot_be_imported_by_its_process_is_named(
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
        "child start failed: moody: .*cairn_test_plugins.moody cannot be imported: "
        "RuntimeError: not in this environment"
    )


@pytest.mark.accuracy
def test_component_that_raises_in_its_supervisors_process_is_restarted(
    launch: Launching,
) -> None:
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
    active = run.await_line("child active: mobile")
    mobile = run.pid_of("mobile")
    statuses = {row["component"]: row for row in cairn("ps", "--json", connect=run.endpoint).json}
    assert statuses["/robot/base"]["pid"] == mobile

    set_fault(run, "raise")

    failed = run.await_line(
        "WARNING robot.mobile: child failed: base: tick: ValueError: broken on purpose",
        after=active,
    )
    run.await_line("child active: base", after=failed)
    assert run.pid_of("mobile") == mobile
    assert not any(re.search("child (ended|failed|stopped): beacon", line) for line in run.lines)
    assert run.stop() == 0
