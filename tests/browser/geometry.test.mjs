// The map's geometry: views, poses over time, covariances, cells.

import assert from "node:assert/strict";
import { test } from "node:test";

import { compose, ellipseOf, PoseHistory, scaleBar, Viewport } from "../../cairn/console/static/map/geometry.js";
import { GridMap } from "../../cairn/console/static/map/grid.js";

const near = (found, expected, tolerance = 1e-9) => found.forEach((value, i) => assert.ok(Math.abs(value - expected[i]) <= tolerance, `${found} is not ${expected}`));

test("zooming keeps the point under the pointer", () => {
  const view = Object.assign(new Viewport(), { width: 800, height: 600, x: 3, y: -2 });
  const before = view.toWorld(200, 450);
  view.zoom(2.5, 200, 450);
  near(view.toWorld(200, 450), before);
  near(view.toWorld(...view.toScreen(1.25, 7.5)), [1.25, 7.5]);
});

test("the view fits a rectangle with its margins", () => {
  const view = Object.assign(new Viewport(), { width: 800, height: 600 });
  view.fit([0, 0, 9, 7], { left: 50, right: 50, top: 20, bottom: 60 });
  const [left, bottom] = view.toScreen(0, 0);
  const [right, top] = view.toScreen(9, 7);
  assert.ok(left >= 49.9 && right <= 750.1 && top >= 19.9 && bottom <= 540.1);
  near([(left + right) / 2, (top + bottom) / 2], [400, 280], 1e-6);
});

test("poses are interpolated over the shorter turn, and forgotten when time goes back", () => {
  const history = new PoseHistory(2);
  assert.equal(history.add(10, [0, 0, 3]), true);
  assert.equal(history.add(11, [1, 2, -3]), false);
  near(history.at(10.5), [0.5, 1, Math.PI], 1e-6);
  near(history.at(9), [0, 0, 3]);
  assert.equal(history.add(5, [7, 7, 0]), true);
  near(history.at(10.5), [7, 7, 0]);
});

test("poses are composed", () => near(compose([1, 2, Math.PI / 2], [1, 0, Math.PI]), [1, 3, -Math.PI / 2]));

test("an ellipse has the axes of its covariance", () => {
  const { a, b, angle } = ellipseOf(2.5, 1.5, 2.5, 2); // eigenvalues 4 and 1, at 45 degrees
  near([a, b, angle], [4, 2, Math.PI / 4]);
});

test("a scale bar has a round length", () => {
  assert.equal(scaleBar(100, 110), 1);
  assert.equal(scaleBar(60, 110), 1);
  assert.equal(scaleBar(20, 110), 5);
  assert.ok(Math.abs(scaleBar(1000, 110) - 0.1) < 1e-12);
});

const grid = () =>
  new GridMap({
    header: { stamp: { sec: 1, nanosec: 0 } },
    info: { width: 3, height: 2, resolution: 0.5, origin: { position: { x: -1, y: 2 }, orientation: { x: 0, y: 0, z: 0, w: 1 } } },
    data: Int8Array.from([0, 100, -1, -1, -1, -1]),
  });

test("cells are found by position, and updates within the map change them", () => {
  const map = grid();
  assert.equal(map.valueAt(-0.4, 2.1), 100);
  assert.equal(map.valueAt(0.1, 2.1), -1);
  assert.equal(map.valueAt(0.6, 2.1), null);
  near(map.bounds(), [-1, 2, 0, 2.5]);
  map.update({ x: 1, y: 0, width: 2, height: 2, data: Int8Array.from([5, 6, 7, 8]) });
  assert.equal(map.valueAt(0.4, 2.9), 8);
  map.update({ x: 2, y: 0, width: 2, height: 1, data: Int8Array.from([1, 1]) }); // beyond the edge
  assert.equal(map.valueAt(0.4, 2.1), 6);
});

test("a map whose size disagrees with its cells is rejected", () => {
  assert.throws(() => new GridMap({ info: { width: 3, height: 2, resolution: 1, origin: grid().origin }, data: new Int8Array(5) }), /3 x 2 cells with 5/);
});
