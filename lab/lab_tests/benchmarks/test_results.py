"""What the benchmarks measured is kept in a file, and the page shows what is in that file."""

import math
from pathlib import Path

import pytest
from pydantic import ValidationError

from cairn_lab.benchmarks.__main__ import BENCHMARKS
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.results import MARKED, RESULTS, Results, Run, record

PAGE = Path("docs/benchmarks.md")
PAGE_TEXT = "<!-- results: startup, make demo -->\n<!-- end -->\nprose\n"


@pytest.fixture
def page(pytestconfig: pytest.Config) -> str:
    return (pytestconfig.rootpath / PAGE).read_text()


def test_page_has_the_tables_of_the_results_file(page: str) -> None:
    assert page == Results.read(RESULTS).page(page), "run python -m cairn_lab.benchmarks --page"


def test_page_names_each_benchmark_and_each_run_once(page: str) -> None:
    markers = [found["what"] for found in MARKED.finditer(page)]
    named = [name for what in markers for name in what.removeprefix("results: ").split(", ")]

    assert sorted(named) == sorted({*BENCHMARKS, *Results.read(RESULTS).runs, "measured"})


def test_a_run_replaces_only_its_own_figures(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    record(file, "make demo", Run.now([Metric("dropped", 0, "")]))
    record(file, "startup", Run.now([Metric("start", 3.0, "s", at_most=2)]))
    record(file, "startup", Run.now([Metric("start", 1.5, "s", at_most=2, note="warm")]))

    results = Results.read(file)

    (figure,) = results.runs["startup"].figures
    assert (figure.value, figure.limit, figure.note) == (1.5, "<= 2", "warm")
    assert list(results.runs) == ["make demo", "startup"]
    assert results.runs["startup"].machine.cores >= 1


def test_page_has_figures_that_miss_their_limit_in_bold(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    metrics = [Metric("start", 3.0, "s", at_most=2), Metric("rays", 12345.6, "")]
    record(file, "startup", Run.now(metrics))

    page = Results.read(file).page(PAGE_TEXT)

    assert "|`startup`|start|**3 s**|≤2|\n||rays|12,346||\n" in page
    assert page.endswith("<!-- end -->\nprose\n")
    assert Results.read(file).page(page) == page


def test_page_has_the_first_figures_and_all_that_miss_their_limit(tmp_path: Path) -> None:
    metrics = [Metric(f"m{number}", number, "", at_most=5) for number in range(7)]
    record(tmp_path / "results.json", "startup", Run.now(metrics))

    page = Results.read(tmp_path / "results.json").page(PAGE_TEXT)

    assert [f"m{number}" for number in range(7) if f"|m{number}|" in page] == [
        "m0",
        "m1",
        "m2",
        "m6",
    ]


def test_a_value_that_is_not_finite_is_kept_as_text(tmp_path: Path) -> None:
    record(tmp_path / "results.json", "startup", Run.now([Metric("start", math.inf, "s", 2)]))

    (figure,) = Results.read(tmp_path / "results.json").runs["startup"].figures

    assert (figure.value, figure.missed) == ("inf", True)


@pytest.mark.parametrize("text", ['{"version": 2, "runs": {}}', '{"version": 1}', "{"])
def test_file_of_another_format_is_rejected(tmp_path: Path, text: str) -> None:
    (tmp_path / "results.json").write_text(text)

    with pytest.raises(ValidationError):
        Results.read(tmp_path / "results.json")
