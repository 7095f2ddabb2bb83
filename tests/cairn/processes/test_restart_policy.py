"""The restart policy: Erlang/OTP's semantics, by example and by property."""

from typing import get_args

from hypothesis import given
from hypothesis import strategies as st

from cairn.processes.restart_policy import RestartDecision, RestartPolicy
from cairn.runtime.child_spec import ChildSpec, Restart, Strategy, Supervision
from tests.wording import assert_words

NAMES = ("base", "scanner", "localizer", "planner")


def child(restart: Restart = "permanent", *, significant: bool = False) -> ChildSpec:
    return ChildSpec(plugin="test", restart=restart, significant=significant)


def policy(strategy: Strategy = "one_for_one", **restarts: Restart) -> RestartPolicy:
    """Return a policy with all of `NAMES` loaded, permanent by default."""
    children = {name: child(restarts.get(name, "permanent")) for name in NAMES}
    made = RestartPolicy(children, Supervision(strategy=strategy))
    for name in NAMES:
        made.load(name)
    return made


def loaded(**children: ChildSpec) -> RestartPolicy:
    """Return a policy with these children loaded."""
    made = RestartPolicy(children, Supervision())
    for name in children:
        made.load(name)
    return made


def test_one_for_one_restarts_only_the_child_that_ended() -> None:
    decision = policy().ended("scanner", normal=False, at_s=0.0, reason="crash")
    assert decision == RestartDecision(start=("scanner",))


def test_rest_for_one_also_restarts_children_started_after_it() -> None:
    decision = policy("rest_for_one").ended("scanner", normal=False, at_s=0.0, reason="crash")
    assert decision == RestartDecision(
        stop=("planner", "localizer"), start=("scanner", "localizer", "planner")
    )


def test_one_for_all_restarts_all_children_and_stops_them_in_reverse_order() -> None:
    decision = policy("one_for_all").ended("scanner", normal=False, at_s=0.0, reason="crash")
    assert decision == RestartDecision(stop=("planner", "localizer", "base"), start=NAMES)


def test_transient_child_is_restarted_after_a_crash_but_not_after_a_normal_end() -> None:
    supervised = policy(base="transient", scanner="transient")
    assert supervised.ended("base", normal=True, at_s=0.0, reason="done") == RestartDecision()
    crashed = supervised.ended("scanner", normal=False, at_s=0.0, reason="crash")
    assert crashed.start == ("scanner",)
    assert supervised.required == ("scanner", "localizer", "planner")


def test_transient_child_that_has_finished_starts_again_with_its_siblings() -> None:
    supervised = policy("one_for_all", base="transient")
    supervised.ended("base", normal=True, at_s=0.0, reason="done")
    assert supervised.ended("planner", normal=False, at_s=1.0, reason="crash").start == NAMES


def test_temporary_child_is_never_restarted_not_even_with_its_siblings() -> None:
    supervised = policy("one_for_all", localizer="temporary")
    decision = supervised.ended("base", normal=False, at_s=0.0, reason="crash")
    assert decision.stop == ("planner", "localizer", "scanner")
    assert decision.start == ("base", "scanner", "planner")


def test_unloaded_child_stays_unloaded_when_its_siblings_are_restarted() -> None:
    supervised = policy("one_for_all")
    supervised.unload("localizer")
    decision = supervised.ended("base", normal=False, at_s=0.0, reason="crash")
    assert decision.start == ("base", "scanner", "planner")


def test_one_restart_too_many_within_the_window_gives_up_with_the_last_reason() -> None:
    supervised = policy()
    for at_s in (0.0, 4.0, 9.0):
        assert not supervised.ended("base", normal=False, at_s=at_s, reason="crash").give_up
    decision = supervised.ended(
        "base", normal=False, at_s=10.0, reason="killed by SIGSEGV (signal 11)"
    )
    assert_words(decision.give_up, "given up", "3 restarts", "10 s", "base", "SIGSEGV")
    assert supervised.required == ()


def test_restarts_older_than_the_window_are_forgotten() -> None:
    supervised = policy()
    for count in range(100):
        decision = supervised.ended("base", normal=False, at_s=count * 3.4, reason="crash")
        assert decision.start == ("base",)


def test_slow_failing_starts_are_not_repeated_forever() -> None:
    supervised = policy()
    decisions = [
        supervised.start_failed("base", at_s=count * 20.0, reason="no answer", refused=False)
        for count in range(4)
    ]
    assert [bool(decision.give_up) for decision in decisions] == [False, False, False, True]
    assert_words(decisions[-1].give_up, "given up", "4 failed starts", "base", "no answer")


def test_child_that_refuses_its_first_start_makes_the_supervisor_fail_at_once() -> None:
    supervised = policy()
    decision = supervised.start_failed("base", at_s=0.0, reason="no device", refused=True)
    assert decision.give_up == "base: no device"
    assert supervised.required == ()


def test_child_that_ran_before_is_restarted_even_if_it_refuses_to_start() -> None:
    supervised = policy()
    supervised.started("base")
    decision = supervised.start_failed("base", at_s=0.0, reason="no device", refused=True)
    assert (decision.start, decision.give_up) == (("base",), "")


def test_temporary_child_that_refuses_to_start_is_left_alone() -> None:
    supervised = loaded(base=child(), notes=child("temporary"))
    decision = supervised.start_failed("notes", at_s=0.0, reason="no file", refused=True)
    assert decision == RestartDecision()
    assert supervised.required == ("base",)


def test_successful_start_resets_the_count_of_failed_starts() -> None:
    supervised = policy()
    for count in range(20):
        decision = supervised.start_failed(
            "base", at_s=count * 20.0, reason="no answer", refused=False
        )
        assert not decision.give_up
        if count % 3 == 2:
            supervised.started("base")


def test_normal_end_of_a_significant_child_finishes_the_supervisor() -> None:
    supervised = loaded(base=child(), replay=child(significant=True))
    decision = supervised.ended("replay", normal=True, at_s=0.0, reason="end of recording")
    assert_words(decision.finished, "replay", "finished", "end of recording")
    assert not decision.start
    assert supervised.required == ()


def test_significant_temporary_child_that_crashes_makes_the_supervisor_fail() -> None:
    supervised = loaded(replay=child("temporary", significant=True))
    decision = supervised.ended("replay", normal=False, at_s=0.0, reason="crash")
    assert_words(decision.give_up, "replay", "not restarted", "crash")


def test_supervisor_passes_the_normal_end_of_a_significant_child_on() -> None:
    mobile = ChildSpec(plugin="test", children={"replay": child(significant=True)})
    supervised = loaded(base=child(), mobile=mobile)
    decision = supervised.ended("mobile", normal=True, at_s=0.0, reason="replay has finished")
    assert decision.finished == "mobile has finished: replay has finished"
    assert loaded(mobile=mobile).ended("mobile", normal=False, at_s=0.0, reason="").start


supervisors = st.builds(
    lambda restarts, strategy, allowed, within_s: (
        dict(zip(NAMES, restarts, strict=True)),
        Supervision(strategy=strategy, max_restarts=allowed, within_s=within_s),
    ),
    st.tuples(*[st.sampled_from(get_args(Restart))] * len(NAMES)),
    st.sampled_from(get_args(Strategy)),
    st.integers(0, 4),
    st.floats(0.1, 10.0),
)
events = st.lists(
    st.tuples(
        st.sampled_from(NAMES),
        st.sampled_from(["load", "unload", "normal", "crash", "failed", "started"]),
        st.floats(0.0, 3.0),
    ),
    max_size=40,
)


@given(supervisors, events)
def test_order_group_and_restart_limit_hold_for_random_events(
    supervisor: tuple[dict[str, Restart], Supervision], history: list[tuple[str, str, float]]
) -> None:
    restarts, supervision = supervisor
    children = {name: child(restart) for name, restart in restarts.items()}
    supervised = RestartPolicy(children, supervision)
    now = 0.0
    counted: list[float] = []
    unloaded = set(NAMES)
    for name, what, passed_s in history:
        now += passed_s
        before = set(supervised.required)
        decision = RestartDecision()
        match what:
            case "load":
                supervised.load(name)
                unloaded.discard(name)
            case "unload":
                supervised.unload(name)
                unloaded.add(name)
            case "started":
                supervised.started(name)
            case "failed":
                decision = supervised.start_failed(name, at_s=now, reason="", refused=False)
            case _:
                decision = supervised.ended(name, normal=what == "normal", at_s=now, reason="")
        after = set(supervised.required)
        is_end = what in ("normal", "crash", "failed")
        touched = set(decision.stop) | set(decision.start)

        assert list(decision.start) == [n for n in NAMES if n in decision.start]
        assert list(decision.stop) == [n for n in reversed(NAMES) if n in decision.stop]
        assert set(decision.stop) <= before
        assert set(decision.start) <= after
        assert not unloaded & after
        assert not decision.finished
        if is_end and not decision.give_up:
            assert name not in decision.stop
            assert not any(restarts[n] == "temporary" for n in decision.start)
            if supervision.strategy == "one_for_one":
                assert touched <= {name}
            if supervision.strategy == "rest_for_one":
                assert all(NAMES.index(n) >= NAMES.index(name) for n in touched)
        if is_end and name in before:
            restarted = restarts[name] == "permanent" or (
                restarts[name] == "transient" and what != "normal"
            )
            if restarted:
                counted.append(now)
            recent = [at for at in counted if now - at <= supervision.within_s]
            if restarted and len(recent) > supervision.max_restarts:
                assert decision.give_up
            elif what != "failed":
                assert not decision.give_up
            assert (name in decision.start) == (restarted and not decision.give_up)
        elif is_end:
            assert decision == RestartDecision()
        if decision.give_up:
            assert not after
            assert not decision.start
            unloaded = set(NAMES)
