"""Tests of the graph without chains of steps: its optimum is that of the whole graph."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from cairn.components.slam.pose_graph import Edge, EdgeKind, PoseGraph, Sighting
from cairn.planar.poses import Pose, compose, relative

LAP = 120  # steps of one turn of a circle
STEP: Pose = (0.2, 0.0, 2 * np.pi / LAP)
STEP_INFORMATION = np.diag([1e4, 1e4, 1e4])
CLOSURE_INFORMATION = np.diag([400.0, 400.0, 2500.0])


def circles(laps: float, drift: float, seed: int = 0) -> tuple[PoseGraph, list[Pose]]:
    """Return a graph of steps that drift by `drift` [rad] each, and the true poses."""
    random = np.random.default_rng(seed)
    graph = PoseGraph()
    graph.add_pose((0.0, 0.0, 0.0))
    truth: list[Pose] = [(0.0, 0.0, 0.0)]
    for number in range(1, round(laps * LAP)):
        truth.append(compose(truth[-1], STEP))
        noise = random.normal(0.0, (0.01, 0.01, 0.003))
        x, y, turn = (np.array(STEP) + noise + (0.0, 0.0, drift)).tolist()
        graph.add_pose(compose(graph.pose(number - 1), (x, y, turn)))
        step = Edge(EdgeKind.STEP, number - 1, number, (x, y, turn), STEP_INFORMATION)
        graph.edges.append(step)
    return graph, truth


def closure(truth: list[Pose], first: int, second: int, error: float = 0.0) -> Edge:
    x, y, turn = relative(truth[first], truth[second])
    return Edge(EdgeKind.CLOSURE, first, second, (x + error, y, turn), CLOSURE_INFORMATION)


def both(graph: PoseGraph) -> tuple[PoseGraph, PoseGraph]:
    """Return the graph after the two ways of optimization."""
    whole, quick = copy.deepcopy(graph), graph
    whole.optimize()
    quick.optimize_quickly()
    return whole, quick


def largest_difference(a: PoseGraph, b: PoseGraph) -> float:
    return float(np.hypot(*(a.poses - b.poses)[:, :2].T).max())


def test_loop_that_moves_the_robot_by_meters_is_closed_as_in_the_whole_graph() -> None:
    graph, truth = circles(2.0, drift=0.003)
    before = graph.poses.copy()
    for first in (3, 40, 75):
        graph.edges.append(closure(truth, first, first + LAP))

    whole, quick = both(graph)

    assert quick.rejected == 0
    assert np.hypot(*(before - quick.poses)[:, :2].T).max() > 0.5
    assert largest_difference(whole, quick) < 1e-3
    assert np.abs(whole.poses - quick.poses)[:, 2].max() < 1e-3


def test_wrong_closure_is_removed_as_from_the_whole_graph() -> None:
    graph, truth = circles(2.0, drift=0.0)
    right = [closure(truth, first, first + LAP) for first in (3, 40, 75)]
    wrong = closure(truth, 20, 20 + LAP, error=2.0)
    graph.edges += [*right, wrong]

    whole, quick = both(graph)

    assert quick.rejected == whole.rejected == 1
    assert [edge for edge in quick.edges if edge.kind is EdgeKind.CLOSURE] == right
    assert largest_difference(whole, quick) < 1e-3


def test_landmarks_are_where_the_whole_graph_puts_them() -> None:
    graph, truth = circles(2.0, drift=0.003)
    place = (1.0, 3.0)
    for number in (5, 6, 20, 5 + LAP, 20 + LAP):
        x, y, theta = truth[number]
        dx, dy = place[0] - x, place[1] - y
        bearing = float(np.arctan2(dy, dx)) - theta
        graph.add_sighting(Sighting(number, 7, float(np.hypot(dx, dy)), bearing, 0.05, 0.01))

    whole, quick = both(graph)

    assert quick.landmarks[7] == pytest.approx(whole.landmarks[7], abs=1e-3)
    assert largest_difference(whole, quick) < 1e-3


def test_islands_stay_where_they_begin() -> None:
    graph, _ = circles(1.0, drift=0.0)
    cut = 50
    graph.edges = [edge for edge in graph.edges if edge.second != cut]
    before = graph.poses.copy()

    graph.optimize_quickly()

    assert graph.poses[[0, cut]] == pytest.approx(before[[0, cut]], abs=1e-6)
    assert set(graph.islands().tolist()) == {0, cut}


def test_graph_of_one_pose_and_of_none_stay() -> None:
    graph = PoseGraph()
    graph.optimize_quickly()
    graph.add_pose((1.0, 2.0, 0.5))

    graph.optimize_quickly()

    assert graph.pose(0) == pytest.approx((1.0, 2.0, 0.5))
