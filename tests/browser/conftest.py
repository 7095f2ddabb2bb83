"""A simulated robot, its console, and Chromium that opens the page."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, sync_playwright

import cairn.client
from cairn.deployment.shipped import deployment_file
from cairn.testing.launching import CAIRN, free_port, launching

PICTURES = Path(__file__).parents[2] / "build" / "browser"
"""Where the tests leave pictures of the page."""

LIMIT_MS = 60_000
"""Longest wait for what the page is expected to show [ms]."""

_CHROMIUM = "/usr/bin/chromium"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is in this folder."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.browser)


Figure = Callable[[str], None]
_figures: list[str] = []


@pytest.fixture
def figure() -> Figure:
    """Report a measured figure at the end of the run."""
    return _figures.append


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the measured figures."""
    for line in _figures:
        terminalreporter.write_line(line)


class Tab:
    """A tab with the console's page."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.errors: list[str] = []
        page.set_default_timeout(LIMIT_MS)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", self._note)

    def _note(self, message: ConsoleMessage) -> None:
        if message.type == "error" and "WebSocket" not in message.text:
            self.errors.append(message.text)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return the position in the page [px] of a position in the map [m]."""
        px, py = self.page.evaluate(
            """([x, y]) => {
                const box = document.querySelector(".map-canvas").getBoundingClientRect();
                const [px, py] = cairnConsole.map.view.toScreen(x, y);
                return [box.left + px, box.top + py];
            }""",
            [x, y],
        )
        return px, py

    def drag(self, x: float, y: float, theta: float, length_px: float = 50.0) -> None:
        """Press at a position in the map, and drag toward a heading."""
        px, py = self.at(x, y)
        mouse = self.page.mouse
        mouse.move(px, py)
        mouse.down()
        mouse.move(px + length_px * math.cos(theta), py - length_px * math.sin(theta), steps=5)
        mouse.up()

    def take_lease(self) -> None:
        """Become the operator."""
        self.page.get_by_role("button", name="Steer", exact=True).first.click()
        self.page.get_by_text("you steer").wait_for()

    def tab_to(self, name: str, key: str = "Tab") -> None:
        """Move the focus by the keyboard to the element whose name begins so."""
        for _ in range(80):
            self.page.keyboard.press(key)
            focused = self.page.evaluate(
                """() => {
                    const one = document.activeElement;
                    return (one.ariaLabel ?? one.labels?.[0]?.textContent ?? one.innerText).trim();
                }"""
            )
            if focused.startswith(name):
                return
        raise AssertionError(f"{key} does not reach {name}")

    def show(self, panel: str) -> None:
        """Open a panel, unless it is open."""
        tab = self.page.get_by_role("tab", name=panel, exact=True)
        if tab.get_attribute("aria-selected") != "true":
            tab.click()

    def component(self, name: str) -> Locator:
        """Open a component's row of the panel Components, and return it."""
        row = self.page.get_by_role("listitem").filter(
            has=self.page.locator(".component-name", has_text=re.compile(f"^{name}$"))
        )
        row.locator(".component-row").click()
        return row

    def picture(self, name: str) -> None:
        """Keep a picture of the page."""
        PICTURES.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=PICTURES / f"{name}.png")


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    if not Path(_CHROMIUM).exists():
        pytest.skip(f"{_CHROMIUM} is missing: install the package chromium")
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=arguments)
        yield browser
        browser.close()


class RunningRobot:
    """A simulated robot, a client of it, and the address of its console's page."""

    def __init__(
        self, client: cairn.client.Robot, endpoint: str, url: str, viewer: Mapping[str, str]
    ) -> None:
        """`viewer` is the environment of a user on the network who may view."""
        self.client, self.endpoint, self.url, self.viewer = client, endpoint, url, viewer


@contextmanager
def console(*arguments: str, environment: Mapping[str, str] | None = None) -> Iterator[str]:
    """Run `cairn console`; yield the address of its page."""
    process = subprocess.Popen(
        [CAIRN, "console", "--port", "0", *arguments],
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env={**os.environ, **(environment or {})},
    )
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if found := re.match(r"console: (http\S+)", line):
                yield found[1]
                break
        else:
            raise AssertionError(f"cairn console ended with {process.wait()}")
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


@pytest.fixture(scope="session")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningRobot]:
    """The robot of deploy/sim.yaml, located, near where it starts."""
    folder = tmp_path_factory.mktemp("robot")
    password = folder / "password"
    password.touch(mode=0o600)
    password.write_text("correct horse\n")
    network = f"tcp/127.0.0.1:{free_port()}"
    users = f"bus.users={{vera: {{role: view, password_file: {password}}}}}"
    viewer = {
        "CAIRN_CONNECT": network, "CAIRN_USER": "vera", "CAIRN_PASSWORD_FILE": str(password),
    }  # fmt: skip
    with launching(folder) as launch:
        run = launch(deployment_file("sim"), "--set", users, "--set", f"bus.listen=[{network}]")
        run.await_line("child active: vision_supervisor")
        with (
            cairn.client.connect(run.endpoint) as client,
            console("--connect", run.endpoint) as url,
        ):
            with client.go(1.5, 1.0) as goal:
                goal.result(timeout_s=120.0)
            yield RunningRobot(client, run.endpoint, url, viewer)


OpenTab = Callable[..., Tab]


@pytest.fixture
def open_tab(chromium: Browser) -> Iterator[OpenTab]:
    """Open tabs, each in a window of its own; at the end, none may have reported an error."""
    tabs: list[Tab] = []

    def open_one(
        url: str, *, width: int = 1280, height: int = 800, theme: str = "light", touch: bool = False
    ) -> Tab:
        context = chromium.new_context(
            viewport={"width": width, "height": height},
            color_scheme="dark" if theme == "dark" else "light",
            has_touch=touch,
        )
        tabs.append(Tab(context.new_page()))
        tabs[-1].page.goto(url)
        return tabs[-1]

    yield open_one
    errors = [error for tab in tabs for error in tab.errors]
    for tab in tabs:
        tab.page.context.close()
    assert not errors, "\n".join(errors)


@pytest.fixture
def tab(robot: RunningRobot, open_tab: OpenTab) -> Tab:
    """A tab that shows the robot on its map."""
    return with_map(open_tab(robot.url))


def with_map(tab: Tab) -> Tab:
    """Wait until a tab shows the map, and the robot on it."""
    tab.page.wait_for_function(
        "() => globalThis.cairnConsole?.map?.scene?.grid && cairnConsole.map.scene.pose"
    )
    return tab


def node() -> str:
    """Return the program node; skip the test where there is none."""
    found = shutil.which("node")
    if found is None or shutil.which("npm") is None:
        pytest.skip("node or npm is missing: install the packages nodejs and npm")
    return found
