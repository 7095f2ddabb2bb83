// The shape of the selected zone while it is changed: its corners are moved, added and removed.
//
// Rings are [[[x, y], ...], ...] as in zones.js; a corner is [ring, index].

import { Store } from "../store.js";
import { isArea, LEAST_POINTS } from "./zones.js";

/** The changed shape that is not saved: {name, rings (null: unchanged), corner (null: none is selected)}; null without one. */
export const shape = new Store(null);

/** Return the rings of a zone, as changed. */
export function ringsOf(zone) {
  return (shape.value?.name === zone.name && shape.value.rings) || zone.rings;
}

/** Return the corner at most `reach` [m] from a position, the nearest one; null without one. */
export function cornerAt(rings, [x, y], reach) {
  let [best, least] = [null, reach];
  rings.forEach((ring, r) =>
    ring.forEach((point, i) => {
      const apart = Math.hypot(point[0] - x, point[1] - y);
      if (apart <= least) [best, least] = [[r, i], apart];
    }),
  );
  return best;
}

/** Return where a corner would be added on an edge at most `reach` [m] from a position: the corner, and its point. */
export function edgeAt(zone, rings, [x, y], reach) {
  let [best, least] = [null, reach];
  if (zone.kind === "place") return null;
  rings.forEach((ring, r) => {
    const edges = isArea(zone) ? ring.length : ring.length - 1;
    for (let i = 0; i < edges; i++) {
      const [[x0, y0], [x1, y1]] = [ring[i], ring[(i + 1) % ring.length]];
      const [dx, dy] = [x1 - x0, y1 - y0];
      const share = Math.min(1, Math.max(0, ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1)));
      const point = [x0 + share * dx, y0 + share * dy];
      const apart = Math.hypot(point[0] - x, point[1] - y);
      if (apart <= least) [best, least] = [{ corner: [r, i + 1], point }, apart];
    }
  });
  return best;
}

export const withMoved = (rings, [r, i], point) => changed(rings, r, (ring) => ring.map((one, k) => (k === i ? point : one)));
export const withAdded = (rings, [r, i], point) => changed(rings, r, (ring) => [...ring.slice(0, i), point, ...ring.slice(i)]);

/** Return the rings without a corner; null if too few would be left. */
export function withoutCorner(zone, rings, [r, i]) {
  return rings[r].length > LEAST_POINTS[zone.kind] ? changed(rings, r, (ring) => ring.filter((_, k) => k !== i)) : null;
}

/** Return the corner after (`step` 1) or before (-1) one, in all rings; the first or last one if there was none. */
export function nextCorner(rings, corner, step) {
  const all = rings.flatMap((ring, r) => ring.map((_, i) => [r, i]));
  const at = corner ? all.findIndex(([r, i]) => r === corner[0] && i === corner[1]) : step > 0 ? -1 : 0;
  return all[(at + step + all.length) % all.length];
}

const changed = (rings, r, change) => rings.map((ring, k) => (k === r ? change(ring) : ring));
