"""The plan of faults is a function of the campaign and its seed; wrong files are refused."""

from pathlib import Path
from typing import Any

import pytest

from cairn import CairnError
from cairn_lab.campaign import Campaign, read_campaign
from cairn_lab.campaign.cli import campaign_file
from cairn_lab.campaign.model import parse_campaign
from cairn_lab.campaign.plan import planned_faults
from cairn_lab.campaign.report import FaultRecord

KEYS: dict[str, Any] = {
    "cairn_campaign": 1,
    "deployment": "sim",
    "count": 400,
    "interval_s": 10.0,
    "faults": [
        {"kind": "kill", "weight": 3},
        {"kind": "stop", "weight": 1, "parameters": {"longest_s": 5}},
    ],
}


def campaign(**keys: Any) -> Campaign:
    return parse_campaign({**KEYS, **keys}, "test.yaml")


def test_same_seed_draws_the_same_faults_and_another_one_others() -> None:
    plan = list(planned_faults(campaign(seed=5)))

    assert plan == list(planned_faults(campaign(seed=5)))
    assert [one.seed for one in plan] != [one.seed for one in planned_faults(campaign(seed=6))]


def test_faults_come_by_weight_and_mean_interval() -> None:
    plan = list(planned_faults(campaign()))

    kills = sum(one.kind == "kill" for one in plan)
    assert 260 < kills < 340
    assert 3000 < plan[-1].at_s < 5000
    assert [one.at_s for one in plan] == sorted(one.at_s for one in plan)


def test_longer_campaign_begins_with_the_faults_of_a_shorter_one() -> None:
    short = list(planned_faults(campaign(count=20)))

    assert list(planned_faults(campaign()))[:20] == short


def test_no_fault_comes_before_or_after_the_time_to_settle() -> None:
    plan = list(planned_faults(campaign(count=None, duration_s=500, settle_s=100)))

    assert plan[0].at_s >= 100
    assert plan[-1].at_s <= 400


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"interval": 3}, "interval: unknown key"),
        ({"interval_s": 0}, "interval_s = '0': should be greater than 0"),
        ({"count": None}, "give duration_s or count"),
        ({"faults": []}, "faults: should have at least 1 item"),
        (
            {"faults": [{"kind": "kill", "wight": 2}]},
            "test.yaml: faults.0.wight: unknown key; remove",
        ),
        ({"faults": [{"kind": "kil"}]}, "there is no fault kil; did you mean kill"),
        (
            {"faults": [{"kind": "stop", "parameters": {"longest_s": -1}}]},
            "fault stop: parameters: longest_s: should be greater than 0",
        ),
        (
            {
                "invariants": [
                    {"kind": "keeps_publishing", "parameters": {"topics": {"odom": "Odometry"}}}
                ]
            },
            "topics.odom: there is no message type Odometry; `cairn schema list`",
        ),
        ({"invariants": [{"kind": "pathlib:Path"}]}, "pathlib:Path is not a class of"),
        ({"invariants": [{"kind": "no_such_module:X"}]}, "cannot be imported"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_wrong_key_is_refused_with_the_file_and_the_remedy(
    keys: dict[str, Any], problem: str
) -> None:
    with pytest.raises(CairnError) as refused:
        campaign(**keys)

    assert str(refused.value).startswith("test.yaml: ")
    assert problem in str(refused.value)


def test_file_that_is_no_campaign_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.yaml"
    file.write_text("cairn: 1\n", encoding="utf-8")

    with pytest.raises(CairnError, match=r"other\.yaml: not a campaign"):
        read_campaign(file)


@pytest.mark.parametrize("name", ["devices", "machines", "sim"])
def test_shipped_campaign_is_valid(name: str) -> None:
    file = campaign_file(name)
    shipped = read_campaign(file)

    assert {one.kind for one in shipped.invariants} >= {"keeps_publishing", "no_orphan"}
    assert shipped.read(file.parent).deployment.robot.name == "robot"


def test_fault_is_followed_by_lines_that_do_not_repeat_each_other() -> None:
    fault = FaultRecord(1, "flood", 3.0)

    for count in range(100):
        fault.follow(f"ERROR robot.base: port cmd_vel: rejected invalid message ({count} so far)")
    fault.follow("WARNING robot.root: child failed: base: killed by SIGKILL")

    assert [one.split()[0] for one in fault.followed] == ["ERROR", "WARNING"]
