// Zones of the map: messages, GeoJSON features, and what a press hits.

import assert from "node:assert/strict";
import { test } from "node:test";

import { cornerAt, edgeAt, nextCorner, withAdded, withMoved, withoutCorner } from "../../cairn/console/static/map/zone_shape.js";
import { featureOf, isInside, middleOf, nearestPlace, newZone, withPoint, zoneAt, zonesOf } from "../../cairn/console/static/map/zones.js";

const square = (kind, name, [x0, y0, x1, y1], properties = {}) => ({ kind, name, speed: 0, width: 0, heading: null, rings: [[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]], ...properties });
const dock = { kind: "place", name: "dock", speed: 0, width: 0, heading: null, rings: [[[1, 1]]] };
const aisle = { kind: "lane", name: "aisle", speed: 0, width: 1, heading: null, rings: [[[0, 5], [10, 5]]] };

test("a message becomes zones with their rings", () => {
  const points = Float64Array.from([0, 0, 4, 0, 4, 4, 1, 1, 2, 1, 2, 2]);
  const message = { zones: [{ kind: 1, name: "ramp", speed: 0.2, width: 0, heading: NaN, rings: Uint32Array.from([3, 3]), points }] };
  assert.deepEqual(zonesOf(message), [
    { kind: "slow", name: "ramp", speed: 0.2, width: 0, heading: null, rings: [[[0, 0], [4, 0], [4, 4]], [[1, 1], [2, 1], [2, 2]]] },
  ]);
});

test("a feature has the properties of its kind alone, and closed rings", () => {
  const slow = featureOf(square("slow", "ramp", [0, 0, 1.23456, 1], { speed: 0.2, width: 9, heading: 1 }));
  assert.deepEqual(slow.properties, { zone: "slow", name: "ramp", speed: 0.2 });
  assert.deepEqual(slow.geometry.coordinates, [[[0, 0], [1.235, 0], [1.235, 1], [0, 1], [0, 0]]]);
  assert.deepEqual(featureOf({ ...dock, heading: 1.5 }).properties, { zone: "place", name: "dock", heading: 1.5 });
  assert.deepEqual(featureOf(dock), { type: "Feature", properties: { zone: "place", name: "dock" }, geometry: { type: "Point", coordinates: [1, 1] } });
  assert.deepEqual(featureOf(aisle).geometry, { type: "LineString", coordinates: [[0, 5], [10, 5]] });
});

test("a new zone has a name that no other has", () => {
  const zones = [square("keepout", "keepout 1", [0, 0, 1, 1])];
  assert.equal(newZone("keepout", [[0, 0]], zones).name, "keepout 2");
  assert.deepEqual(newZone("slow", [[0, 0]], zones).speed, 0.2);
  assert.deepEqual(newZone("place", [[0, 0]], zones, 1).heading, 1);
});

test("a double click adds one point", () => {
  const once = withPoint([[0, 0]], [1, 2]);
  assert.deepEqual(once, [[0, 0], [1, 2]]);
  assert.deepEqual(withPoint(once, [1, 2.0001]), once);
  assert.deepEqual(withPoint(once, [1, 2.1]), [...once, [1, 2.1]]);
  assert.deepEqual(withPoint([], [0, 0]), [[0, 0]]);
});

test("a press hits places before lanes before areas, the last drawn one first", () => {
  const zones = [square("keepout", "a", [0, 0, 9, 9]), square("slow", "b", [0, 0, 4, 9]), aisle, dock];
  assert.equal(zoneAt(zones, [1.1, 1], 0.3), dock);
  assert.equal(zoneAt(zones, [6, 5.4], 0.1), aisle);
  assert.equal(zoneAt(zones, [2, 2], 0.1), zones[1]);
  assert.equal(zoneAt(zones, [6, 2], 0.1), zones[0]);
  assert.equal(zoneAt(zones, [9.2, 2], 0.3), zones[0]);
  assert.equal(zoneAt(zones, [20, 2], 0.3), null);
  assert.equal(nearestPlace(zones, [1.5, 1], 0.3), null);
});

test("a hole is outside", () => {
  const ring = square("keepout", "a", [0, 0, 4, 4]);
  ring.rings.push([[1, 1], [3, 1], [3, 3], [1, 3]]);
  assert.ok(isInside(ring, 0.5, 2));
  assert.ok(!isInside(ring, 2, 2));
  assert.deepEqual(middleOf(ring), [2, 2]);
});

test("a corner is moved, added and removed without changing the zone itself", () => {
  const zone = square("keepout", "a", [0, 0, 4, 4]);
  assert.deepEqual(withMoved(zone.rings, [0, 2], [5, 6]), [[[0, 0], [4, 0], [5, 6], [0, 4]]]);
  const { corner, point } = edgeAt(zone, zone.rings, [-0.1, 1], 0.3); // the edge from the last corner to the first one
  assert.deepEqual([corner, point], [[0, 4], [0, 1]]);
  const five = withAdded(zone.rings, corner, point);
  assert.deepEqual(five, [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 1]]]);
  assert.deepEqual(withoutCorner(zone, five, [0, 4]), zone.rings);
  assert.deepEqual(zone.rings, [[[0, 0], [4, 0], [4, 4], [0, 4]]]);
});

test("a zone keeps the fewest points of its kind", () => {
  const triangle = { ...square("slow", "a", [0, 0, 4, 4]), rings: [[[0, 0], [4, 0], [4, 4]]] };
  assert.equal(withoutCorner(triangle, triangle.rings, [0, 1]), null);
  assert.equal(withoutCorner(aisle, aisle.rings, [0, 1]), null);
  assert.equal(withoutCorner(dock, dock.rings, [0, 0]), null);
});

test("a lane has no edge from its end to its start, and a place has none", () => {
  const bent = { ...aisle, rings: [[[0, 0], [4, 0], [4, 4]]] };
  assert.equal(edgeAt(bent, bent.rings, [2, 2], 0.3), null);
  assert.deepEqual(edgeAt(bent, bent.rings, [4.1, 2], 0.3), { corner: [0, 2], point: [4, 2] });
  assert.equal(edgeAt(dock, dock.rings, [1, 1], 0.3), null);
});

test("corners of holes are found, and chosen one after the other", () => {
  const rings = [...square("keepout", "a", [0, 0, 9, 9]).rings, [[2, 2], [3, 2], [3, 3]]];
  assert.deepEqual(cornerAt(rings, [3.1, 2], 0.3), [1, 1]);
  assert.equal(cornerAt(rings, [5, 5], 0.3), null);
  assert.deepEqual(nextCorner(rings, null, 1), [0, 0]);
  assert.deepEqual(nextCorner(rings, null, -1), [1, 2]);
  assert.deepEqual(nextCorner(rings, [0, 3], 1), [1, 0]);
  assert.deepEqual(nextCorner(rings, [0, 0], -1), [1, 2]);
});
