"""A running deployment that the tests of a module share, and commands against it."""

from collections.abc import Callable, Iterator

import pytest

from cairn.client import connection
from cairn.testing.launching import Run, launching
from tests.commands import Answer, await_status, cairn
from tests.patience import LIMIT_S

Command = Callable[..., Answer]

ROVER = """
    external_topics: [goal_pose]
    components:
      mobile:
        plugin: supervisor
        children:
          listener: {plugin: test_listener}
          reader: {plugin: test_reader, load: on_request}
      beacon: {plugin: test_beacon}
      talker: {plugin: test_talker}
    """


@pytest.fixture(autouse=True)
def patient_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands wait for the whole graph, however busy the router is."""
    monkeypatch.setattr(connection, "_GRAPH_LIMIT_S", LIMIT_S)


@pytest.fixture(scope="module")
def rover(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """The deployment above, running."""
    with launching(tmp_path_factory.mktemp("rover")) as launch:
        run = launch(ROVER, robot="rover")
        run.await_line("child active: talker")
        run.await_line("received 1,")
        await_status("/rover/root", lambda row: row["state"] == "active", run.endpoint)
        yield run
        assert run.stop() == 0


@pytest.fixture
def command(rover: Run) -> Command:
    """Runs `cairn` commands against it."""

    def against(*arguments: str) -> Answer:
        return cairn(*arguments, connect=rover.endpoint)

    return against
