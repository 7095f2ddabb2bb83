// Zones on the map: as they are received, as they are drawn by hand, and as GeoJSON features.
//
// A zone is {kind, name, speed, width, heading (null if any), rings: [[[x, y], ...], ...]}.

import { Store } from "../store.js";

export const KINDS = ["keepout", "slow", "lane", "place"];
export const KIND_TITLES = { keepout: "Keepout", slow: "Slow", lane: "Lane", place: "Place" };
/** Fewest points of a zone of each kind. */
export const LEAST_POINTS = { keepout: 3, slow: 3, lane: 2, place: 1 };

const FIRST_SPEED = 0.2; // of a new slow zone [m/s]
const FIRST_WIDTH_M = 0.8; // of a new lane

/** What is being drawn: its kind, "" for nothing, and the points so far. */
export const draft = new Store({ kind: "", points: [] });

export const isArea = (zone) => zone.kind === "keepout" || zone.kind === "slow";

/** Return the zones of a message `cairn_nav_msgs/msg/Zones`. */
export function zonesOf(message) {
  return message.zones.map((zone) => {
    let at = 0;
    const rings = Array.from(zone.rings, (count) => Array.from({ length: count }, () => [zone.points[at++], zone.points[at++]]));
    const heading = Number.isNaN(zone.heading) ? null : zone.heading;
    return { kind: KINDS[zone.kind], name: zone.name, speed: zone.speed, width: zone.width, heading, rings };
  });
}

/** Return a zone as GeoJSON feature, with the properties of its kind alone. */
export function featureOf(zone) {
  const properties = { zone: zone.kind, name: zone.name };
  if (zone.kind === "slow") properties.speed = zone.speed;
  if (zone.kind === "lane") properties.width = zone.width;
  if (zone.kind === "place" && zone.heading !== null) properties.heading = zone.heading;
  const rounded = zone.rings.map((ring) => ring.map((point) => point.map(round)));
  const geometry = {
    place: () => ({ type: "Point", coordinates: rounded[0][0] }),
    lane: () => ({ type: "LineString", coordinates: rounded[0] }),
  }[zone.kind]?.() ?? { type: "Polygon", coordinates: rounded.map((ring) => [...ring, ring[0]]) };
  return { type: "Feature", properties, geometry };
}

/** Return a new zone of points, with a name that none of `zones` has. */
export function newZone(kind, points, zones, heading = null) {
  const taken = new Set(zones.map((zone) => zone.name));
  let number = 1;
  while (taken.has(`${kind} ${number}`)) number++;
  const of = (wanted, value) => (kind === wanted ? value : 0);
  return { kind, name: `${kind} ${number}`, speed: of("slow", FIRST_SPEED), width: of("lane", FIRST_WIDTH_M), heading, rings: [points] };
}

/** Return the points with one more, unless it is the last one again: the second press of a double click. */
export function withPoint(points, [x, y]) {
  const last = points.at(-1);
  const isSame = last !== undefined && round(last[0]) === round(x) && round(last[1]) === round(y);
  return isSame ? points : [...points, [x, y]];
}

/** Return the zone at a position, or within `reach` [m] of it: places before lanes before areas. */
export function zoneAt(zones, [x, y], reach) {
  const near = (zone, most) => distanceTo(zone, x, y) <= most;
  const last = (predicate) => zones.filter(predicate).at(-1) ?? null;
  return (
    nearestPlace(zones, [x, y], reach) ??
    last((zone) => zone.kind === "lane" && near(zone, Math.max(reach, zone.width / 2))) ??
    last((zone) => isArea(zone) && (isInside(zone, x, y) || near(zone, reach)))
  );
}

/** Return the place nearest to a position, at most `reach` [m] away; null without one. */
export function nearestPlace(zones, [x, y], reach) {
  let [best, least] = [null, reach];
  for (const zone of zones) {
    if (zone.kind !== "place") continue;
    const apart = distanceTo(zone, x, y);
    if (apart <= least) [best, least] = [zone, apart];
  }
  return best;
}

export function isInside(zone, x, y) {
  let inside = false;
  for (const [[x0, y0], [x1, y1]] of edgesOf(zone)) if (y0 > y !== y1 > y && x < x0 + ((y - y0) / (y1 - y0)) * (x1 - x0)) inside = !inside;
  return inside;
}

/** Return where the name of a zone is written: the middle of its points. */
export function middleOf(zone) {
  const points = zone.rings[0];
  const mean = (axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length;
  return [mean(0), mean(1)];
}

function edgesOf(zone) {
  return zone.rings.flatMap((ring) => {
    const edges = ring.slice(1).map((point, i) => [ring[i], point]);
    return isArea(zone) ? [...edges, [ring.at(-1), ring[0]]] : edges;
  });
}

function distanceTo(zone, x, y) {
  if (zone.kind === "place") return Math.hypot(zone.rings[0][0][0] - x, zone.rings[0][0][1] - y);
  return Math.min(
    ...edgesOf(zone).map(([[x0, y0], [x1, y1]]) => {
      const [dx, dy] = [x1 - x0, y1 - y0];
      const share = Math.min(1, Math.max(0, ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1)));
      return Math.hypot(x0 + share * dx - x, y0 + share * dy - y);
    }),
  );
}

const round = (value) => Math.round(1000 * value) / 1000;
