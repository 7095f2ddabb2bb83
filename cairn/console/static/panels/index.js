// The panels beside the map, in the order of their tabs.
//
// A panel is {id, title, icon (a name of ui.js), component, modes}: the component is rendered without
// properties and uses the hooks of hooks.js; `modes` are the modes of the console that have it ("live",
// "recording"), all by default.

import { Drive } from "../drive.js";
import { Camera } from "./camera.js";
import { Components } from "./components.js";
import { Diagnostics } from "./diagnostics.js";
import { Logs } from "./logs.js";
import { Parameters } from "./parameters.js";
import { Plots } from "./plots.js";
import { Proposals } from "./proposals.js";
import { Status } from "./status.js";
import { Topics } from "./topics.js";

export const panels = [
  { id: "drive", title: "Drive", icon: "drive", component: Drive, modes: ["live"] },
  { id: "status", title: "Status", icon: "info", component: Status },
  { id: "components", title: "Components", icon: "components", component: Components },
  { id: "logs", title: "Logs", icon: "logs", component: Logs },
  { id: "plots", title: "Plots", icon: "plots", component: Plots },
  { id: "topics", title: "Topics", icon: "topics", component: Topics },
  { id: "parameters", title: "Parameters", icon: "parameters", component: Parameters },
  { id: "diagnostics", title: "Diagnostics", icon: "diagnostics", component: Diagnostics },
  { id: "camera", title: "Camera", icon: "camera", component: Camera },
  { id: "proposals", title: "Proposals", icon: "proposal", component: Proposals },
];
