// The tool for zones: a press adds a point to the draft, selects a zone, or changes the shape of the selected one.

import { draft, newZone, withPoint, zoneAt } from "./zones.js";
import { cornerAt, edgeAt, nextCorner, ringsOf, shape, withAdded, withMoved, withoutCorner } from "./zone_shape.js";

const KEY_STEP_M = 0.05; // by which an arrow moves a corner: a cell of a usual map
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** `add(zone)` adds what was drawn, `save()` saves the changed shape. */
export function zoneTool(controller, add, save) {
  const zones = () => controller.scene?.zones ?? [];
  const selected = () => {
    const { kind, name } = controller.selected.value ?? {};
    return kind === "zone" && !draft.value.kind ? (zones().find((zone) => zone.name === name) ?? null) : null;
  };
  const isChanged = () => Boolean(selected() && shape.value?.rings);
  const select = (zone) => {
    if (isChanged()) return; // it is saved or discarded first
    if (zone?.name !== shape.value?.name) shape.set(null);
    controller.selected.set(zone && { kind: "zone", name: zone.name });
  };
  const cornerOf = (zone) => (shape.value?.name === zone.name ? shape.value.corner : null);
  const change = (zone, rings, corner) => rings && shape.set({ name: zone.name, rings, corner });
  const choose = (zone, corner) => shape.set({ name: zone.name, rings: shape.value?.name === zone.name ? shape.value.rings : null, corner });
  /** Remove the corner at a position, else add one to the edge there; return whether there is one of them. */
  const toggle = (zone, position, reach) => {
    const rings = ringsOf(zone);
    const corner = cornerAt(rings, position, reach);
    const edge = edgeAt(zone, rings, position, reach);
    if (corner) change(zone, withoutCorner(zone, rings, corner), null);
    else if (edge) change(zone, withAdded(rings, edge.corner, edge.point), edge.corner);
    return Boolean(corner || edge);
  };
  const keys = {
    "[": (zone) => choose(zone, nextCorner(ringsOf(zone), cornerOf(zone), -1)),
    "]": (zone) => choose(zone, nextCorner(ringsOf(zone), cornerOf(zone), 1)),
    Delete: (zone, rings, corner) => corner && change(zone, withoutCorner(zone, rings, corner), null),
    Insert: (zone, rings, corner) => {
      if (!corner || zone.kind === "place") return;
      const [r, i] = corner;
      const [here, next] = [rings[r][i], rings[r][(i + 1) % rings[r].length]];
      if (zone.kind === "lane" && i === rings[r].length - 1) return;
      change(zone, withAdded(rings, [r, i + 1], [0, 1].map((axis) => (here[axis] + next[axis]) / 2)), [r, i + 1]);
    },
  };
  return {
    get panOnEmpty() {
      return draft.value.kind === "";
    },
    onPress: (position, reach, isAlt) => {
      if (draft.value.kind) return { draws: true };
      const zone = selected();
      if (zone && isAlt) return { toggles: true, reach };
      const corner = zone && cornerAt(ringsOf(zone), position, reach);
      return corner ? { corner } : zoneAt(zones(), position, reach);
    },
    onRelease: (drag) => {
      const { kind, points } = draft.value;
      const zone = selected();
      if (kind === "place") add(newZone(kind, [drag.from], zones(), drag.theta));
      else if (kind) draft.set({ kind, points: withPoint(points, drag.from) });
      else if (drag.data.toggles) zone && toggle(zone, drag.from, drag.data.reach);
      else if (drag.data.corner) {
        if (zone && drag.moved) change(zone, withMoved(ringsOf(zone), drag.data.corner, drag.to), drag.data.corner);
        else if (zone) choose(zone, drag.data.corner);
      } else select(drag.data);
      controller.redraw();
    },
    onDouble: (position, reach) => {
      const zone = selected();
      if (zone) toggle(zone, position, reach);
    },
    pick: (position, reach) => {
      const zone = selected();
      const corner = zone && cornerAt(ringsOf(zone), position, reach);
      if (corner) choose(zone, corner);
      else select(zoneAt(zones(), position, reach));
      return true;
    },
    /** Act on a key for the selected zone; return whether it is one. */
    onKey: (key) => {
      const zone = selected();
      if (!zone) return false;
      const [rings, corner] = [ringsOf(zone), cornerOf(zone)];
      if (key === "Escape" && (corner || isChanged())) shape.set(null);
      else if (key === "Enter" && isChanged()) save();
      else if (ARROWS[key] && corner) {
        const [x, y] = rings[corner[0]][corner[1]];
        const [dx, dy] = ARROWS[key];
        change(zone, withMoved(rings, corner, [x + dx * KEY_STEP_M, y + dy * KEY_STEP_M]), corner);
      } else if (keys[key]) keys[key](zone, rings, corner);
      else return false;
      return true;
    },
    draw: (painter, drag) => {
      const { kind, points } = draft.value;
      const isPressed = drag?.kind === "tool" && drag.data?.draws;
      if (kind) {
        painter.draft(kind, isPressed ? [...points, drag.from] : points);
        if (isPressed && kind === "place" && drag.theta !== null) painter.arrow(...drag.from, drag.theta, 30, painter.colors.place);
        return;
      }
      const zone = selected();
      if (!zone) return;
      const dragged = drag?.kind === "tool" && drag.moved && drag.data?.corner;
      const rings = dragged ? withMoved(ringsOf(zone), dragged, drag.to) : ringsOf(zone);
      painter.shape(zone, rings, dragged || cornerOf(zone), rings !== zone.rings);
    },
  };
}
