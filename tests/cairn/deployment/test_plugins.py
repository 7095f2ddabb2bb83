"""Plugins are found by entry point, from packages outside of the repository too."""

from pathlib import Path

import pytest

from cairn.deployment.plugins import PluginError, installed_plugins, load_plugin
from tests.wording import assert_words


def test_installed_plugins_are_listed_with_package_summary_and_ports() -> None:
    listed = {plugin.name: plugin for plugin in installed_plugins()}

    base = listed["acme_base"]
    assert (base.target, base.package) == ("acme_robot.parts:Base", "acme-robot 1.2")
    assert base.summary == "Drives the wheels."
    assert [(port.direction, port.name) for port in base.ports] == [
        ("in", "command"),
        ("out", "odom"),
    ]
    assert base.error == ""


def test_unusable_plugin_is_listed_with_its_error() -> None:
    listed = {plugin.name: plugin for plugin in installed_plugins()}

    assert "No module named 'acme_camera_library'" in listed["acme_camera"].error
    assert "is not a component" in listed["acme_no_component"].error
    assert "the port has no message type" in listed["acme_odd_port"].error


def test_entry_point_and_class_name_give_the_same_class() -> None:
    assert load_plugin("acme_base") is load_plugin("acme_robot.parts:Base")


def test_plugin_name_of_two_packages_is_ambiguous(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "other-3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 3\n")
    (info / "entry_points.txt").write_text("[cairn.components]\nacme_base = other.base:Base\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    with pytest.raises(PluginError) as caught:
        load_plugin("acme_base")

    assert_words(caught.value.found, "acme_base", "other 3", "acme-robot 1.2")
    assert_words(caught.value.remedy, "class", "other.base:Base", "acme_robot.parts:Base")


@pytest.mark.parametrize(
    ("body", "error"),
    [
        ("def broken(:\n", "SyntaxError"),
        ("import sys\nsys.exit(3)\n", "SystemExit: 3"),
        ("1 / 0\n", "ZeroDivisionError: division by zero at {file}:1"),
    ],
)
def test_any_failure_on_import_is_a_plugin_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, error: str
) -> None:
    file = tmp_path / "acme_failing.py"
    file.write_text(body)
    monkeypatch.syspath_prepend(str(tmp_path))

    with pytest.raises(PluginError, match=error.format(file=file)):
        load_plugin("acme_failing:Thing")
