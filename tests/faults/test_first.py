from tests.launching import Launching

TALK = """\
    components:
      mobile:
        plugin: mobile_supervisor
        children:
          listener: {plugin: test_listener}
      talker: {plugin: test_talker}
    """

def test_a(launch: Launching) -> None:
    run = launch(TALK)
    run.await_line("listener: heard 10")
    print(run.pids())
    assert run.stop() == 0
    print(run)
