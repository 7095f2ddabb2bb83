"""The panels of the console's page in Chromium, with a simulated robot."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from tests.browser.conftest import OpenTab, RunningRobot, Tab, with_map


@pytest.fixture
def speed(robot: RunningRobot) -> Iterator[float]:
    """Return motion control's parameter `speed`, and set it again after the test."""
    value = float(robot.client.parameters("motion_control")["speed"].value)
    yield value
    robot.client.set_parameters("motion_control", {"speed": value})


def test_parameter_is_changed_rejected_and_reset(
    robot: RunningRobot, tab: Tab, speed: float
) -> None:
    page = tab.page
    tab.show("Parameters")
    page.get_by_label("Component", exact=True).select_option("motion_control")
    field = page.get_by_label("speed", exact=True)
    field.wait_for()
    assert field.is_disabled()
    page.get_by_text("Changes need the lease").wait_for()
    tab.take_lease()

    field.fill("7")
    field.press("Enter")
    page.get_by_role("alert").get_by_text("less than or equal to 3").wait_for()
    assert robot.client.parameters("motion_control")["speed"].value == speed

    field.fill("0.5")
    field.press("Enter")
    reset = page.get_by_role("button", name=f"Reset to {speed:g}")
    reset.wait_for()
    assert robot.client.parameters("motion_control")["speed"].value == 0.5

    reset.click()
    reset.wait_for(state="hidden")
    assert robot.client.parameters("motion_control")["speed"].value == speed


def test_restart_states_its_consequences_and_can_be_canceled(robot: RunningRobot, tab: Tab) -> None:
    before = robot.client.components()["range_scanner"].pid
    tab.take_lease()
    tab.show("Components")
    tab.page.get_by_text(re.compile(r"(\d+) of \1 loaded")).first.wait_for()
    tab.component("range_scanner").get_by_role("button", name="Restart", exact=True).click()
    question = tab.page.get_by_role("alertdialog", name="Restart range_scanner?")
    question.get_by_text("motion depends on it").wait_for()

    tab.page.keyboard.press("Enter")  # the focus is on Cancel

    question.wait_for(state="hidden")
    assert robot.client.components()["range_scanner"].pid == before


def test_logs_have_the_history_and_are_filtered(tab: Tab) -> None:
    page = tab.page
    tab.show("Logs")
    rows = page.get_by_role("option").filter(has=page.locator(".log-text"))
    rows.first.wait_for()
    page.get_by_label("Filter by text").fill("child active localizer")
    page.wait_for_function("() => document.querySelectorAll('.log-row').length === 1")
    assert "child active: localizer" in rows.first.inner_text()

    page.get_by_role("listbox", name="Log messages").press("ArrowDown")

    page.get_by_role("region", name="Message").get_by_text("child active: localizer").wait_for()
    page.get_by_label("Filter by text").fill("no such words")
    page.get_by_role("button", name="Show all messages").click()
    page.wait_for_function("() => document.querySelectorAll('.log-row').length > 5")


def test_field_is_plotted_by_keyboard_alone(tab: Tab) -> None:
    tab.show("Plots")
    search = tab.page.get_by_role("combobox", name="Add a field to the plot")
    search.press_sequentially("localization health")
    tab.page.get_by_role("option").first.wait_for()
    search.press("Enter")
    chip = tab.page.locator(".series-chip")
    tab.page.wait_for_function(
        "() => Number(document.querySelector('.series-value')?.textContent) > 0"
    )
    assert "localization health" in chip.inner_text()
    assert tab.page.locator(".plot-frame canvas").count() == 1


def test_field_of_the_last_message_is_plotted_by_click(tab: Tab) -> None:
    page = tab.page
    tab.show("Topics")
    page.get_by_label("Filter topics and types").fill("motion_status")
    page.get_by_role("button", name="motion_status").click()
    page.get_by_text("automove", exact=False).first.wait_for()  # among the subscribers
    page.get_by_role("button", name="Plot clearance").click()
    page.get_by_role("region", name="Plot 1: motion_status clearance").wait_for()


def test_hidden_tab_is_not_subscribed(robot: RunningRobot, open_tab: OpenTab) -> None:
    tab = open_tab(robot.url)
    page = tab.page
    page.add_init_script(
        """
        const subscribed = (window.subscribed = new Map());
        const send = WebSocket.prototype.send;
        WebSocket.prototype.send = function (data) {
            const message = JSON.parse(data);
            if (message.op === "subscribe")
                for (const one of message.subscriptions) subscribed.set(one.id, one.channelId);
            if (message.op === "unsubscribe")
                for (const id of message.subscriptionIds) subscribed.delete(id);
            return send.call(this, data);
        };
        window.turn = (hidden) => {
            Object.defineProperty(document, "hidden", {value: hidden, configurable: true});
            document.dispatchEvent(new Event("visibilitychange"));
        };
        """
    )
    page.reload()
    with_map(tab)
    tab.show("Status")
    page.get_by_role("region", name="Velocity gate").wait_for()

    page.evaluate("turn(true)")
    page.wait_for_function("() => window.subscribed.size === 0")
    scan = page.evaluate("cairnConsole.map.scene.scanStamp")

    page.evaluate("turn(false)")
    page.wait_for_function("(scan) => cairnConsole.map.scene.scanStamp > scan", arg=scan)
