// What a press on the map does: goals, waypoints, the initial pose, and changes of a simulated world.
//
// A tool has onPress(position, reach, isAlt) -> data, onRelease(drag), draw(painter, drag), pick(position, reach),
// and panOnEmpty: whether a press that onPress does not take moves the map. It may have onDouble(position, reach),
// for a double click, and onKey(key), which returns whether it takes the key. A drag is
// {from, to, theta (null for a short drag), moved, data}.

import { Store } from "../store.js";

/** Poses that wait to be sent: [[x, y, theta], ...]. */
export const waypoints = new Store([]);

/** Without a drag, the robot faces the way it came. */
function headingTo([x, y], from) {
  return from && Math.hypot(x - from[0], y - from[1]) > 0.05 ? Math.atan2(y - from[1], x - from[0]) : 0;
}

export function goalTool(controller, send) {
  const poseOf = (drag) => [...drag.from, drag.theta ?? headingTo(drag.from, controller.scene?.pose)];
  return {
    onPress: () => true,
    onRelease: (drag) => send([poseOf(drag)]),
    draw: (painter, drag) => drag?.kind === "tool" && painter.waypoints([poseOf(drag)], painter.colors.goal, 0),
  };
}

export function waypointTool(controller) {
  const poseOf = (drag) => [...drag.from, drag.theta ?? headingTo(drag.from, waypoints.value.at(-1) ?? controller.scene?.pose)];
  return {
    onPress: () => true,
    onRelease: (drag) => {
      waypoints.update((poses) => [...poses, poseOf(drag)]);
      controller.redraw();
    },
    draw: (painter, drag) => {
      const poses = drag?.kind === "tool" ? [...waypoints.value, poseOf(drag)] : waypoints.value;
      painter.waypoints(poses, painter.colors.accent, 1);
    },
  };
}

export function poseTool(controller, send) {
  const poseOf = (drag) => [...drag.from, drag.theta ?? controller.scene?.pose?.[2] ?? 0];
  return {
    onPress: () => true,
    onRelease: (drag) => send(poseOf(drag)),
    draw: (painter, drag) => drag?.kind === "tool" && painter.robot(poseOf(drag), controller.scene ?? {}, painter.colors.accent, "", 0.8),
  };
}

/** Things of a simulated world: [{kind, name, x, y, theta}]. */
export const things = new Store([]);

/** What the next press adds: "" for nothing, "person" or "box". */
export const adding = new Store("");

const BOX_M = 0.5;

export function worldTool(controller, change) {
  const nearest = ([x, y], reach) => {
    let [best, least] = [null, Math.max(reach, 0.25)];
    for (const thing of things.value) {
      const distance = Math.hypot(thing.x - x, thing.y - y);
      if (distance < least) [best, least] = [thing, distance];
    }
    return best;
  };
  const moved = (drag) => [drag.data.x + drag.to[0] - drag.from[0], drag.data.y + drag.to[1] - drag.from[1], drag.data.theta];
  return {
    panOnEmpty: true,
    onPress: (position, reach) => (adding.value ? { adds: adding.value } : nearest(position, reach)),
    onRelease: (drag) => {
      const { data } = drag;
      if (data.adds) {
        adding.set("");
        change(...addition(data.adds, drag));
        return;
      }
      controller.selected.set({ kind: "thing", name: data.name });
      if (!drag.moved) return;
      change(...movement(data, moved(drag)));
    },
    pick: () => {
      controller.selected.set(null);
      return true;
    },
    draw: (painter, drag) => {
      const { colors } = painter;
      const selected = controller.selected.value;
      for (const thing of things.value) {
        const isDragged = drag?.kind === "tool" && drag.data?.name === thing.name && drag.moved;
        const [x, y] = isDragged ? moved(drag) : [thing.x, thing.y];
        const isSelected = selected?.kind === "thing" && selected.name === thing.name;
        painter.circle(x, y, 7, { fill: colors.surface, stroke: isSelected ? colors.accent : colors.person, width: isSelected ? 3 : 2 });
        painter.label(x, y, 10, thing.name);
      }
      if (drag?.kind === "tool" && drag.data?.adds) {
        painter.circle(...drag.from, 8, { stroke: colors.accent, width: 2.5 });
        if (drag.theta !== null) painter.arrow(...drag.from, drag.theta, 30, colors.accent);
      }
    },
  };
}

/** Return verb and arguments of the request that moves a thing to a pose. */
export function movement(thing, [x, y, theta]) {
  const pose = { x: round(x), y: round(y), theta: round(theta) };
  return thing.kind === "robot" ? ["kidnap", pose] : ["move", { name: thing.name, ...pose }];
}

/** Return verb and arguments of the request that adds a box, or a person that walks along the drag. */
function addition(kind, { from, to, theta }) {
  const name = freeName(kind);
  const [x, y] = from.map(round);
  if (kind === "box") return ["furniture", { name, x, y, theta: round(theta ?? 0), size: [BOX_M, BOX_M] }];
  return ["person", { name, waypoints: theta === null ? [[x, y]] : [[x, y], to.map(round)] }];
}

function freeName(kind) {
  const taken = new Set(things.value.map((thing) => thing.name));
  let number = 1;
  while (taken.has(`${kind}_${number}`)) number++;
  return `${kind}_${number}`;
}

const round = (value) => Math.round(1000 * value) / 1000;
