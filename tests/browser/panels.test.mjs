// The logic of the panels: fields and plots, logs, components, parameters, topics, diagnostics, outlines.

import assert from "node:assert/strict";
import { test } from "node:test";

import { makeDecoder } from "../../cairn/console/static/cdr.js";
import { distorted, infoTopicOf, outlineOf } from "../../cairn/console/static/panels/camera.js";
import { asTree, consequence, descendants } from "../../cairn/console/static/panels/components.js";
import { sortStatuses, takeStatuses, toneOf } from "../../cairn/console/static/panels/diagnostics.js";
import { numberAt, numericFields, parsePath, searchFields } from "../../cairn/console/static/panels/fields.js";
import { LogBuffer, filterRecords, nextProblem, recordOf } from "../../cairn/console/static/panels/logs.js";
import { editorOf, grouped, inputText, parseInput } from "../../cairn/console/static/panels/parameters.js";
import { withField } from "../../cairn/console/static/panels/plots.js";
import { Series, decimate } from "../../cairn/console/static/panels/series.js";
import { constantName, endpoints, mergeTopics, preview } from "../../cairn/console/static/panels/topics.js";

const SEPARATOR = "=".repeat(80);
const SCAN = `Stamp stamp
string frame
float32[] ranges
Point[] points
bool valid
int64 count
uint8 STOPPED=4
uint8 state
${SEPARATOR}
MSG: test/Stamp
int32 sec
${SEPARATOR}
MSG: test/Point
float64 x
string name
`;
const decode = makeDecoder("test/msg/Scan", SCAN);

test("the field picker offers all numeric fields with an index for sequences, and no texts", () => {
  const paths = numericFields(decode).map((one) => one.path);
  assert.deepEqual(paths, ["stamp.sec", "ranges[0]", "points[0].x", "valid", "count", "state"]);
});

test("a path leads to numbers, booleans and 64-bit integers, and to NaN where there is nothing", () => {
  const message = { stamp: { sec: 3 }, ranges: new Float32Array([1, 2]), points: [{ x: 0.5, name: "a" }], valid: true, count: 12n };
  const at = (path) => numberAt(message, parsePath(path));
  assert.deepEqual(["stamp.sec", "ranges[1]", "points[0].x", "valid", "count"].map(at), [3, 2, 0.5, 1, 12]);
  for (const path of ["ranges[7]", "points[3].x", "points[0].name", "missing.x", "stamp"]) assert.ok(Number.isNaN(at(path)), path);
});

test("a text that is not a path is rejected with that text", () => {
  for (const text of ["", "a..b", "a[", "[0]", "a[-1]", "a b", ".a"]) assert.throws(() => parsePath(text), /not a field/);
});

test("a search needs all words, and fields named so come first", () => {
  const fields = ["twist.linear.x", "x", "pose.position.x", "linear.y"].map((path) => ({ path }));
  assert.deepEqual(searchFields(fields, "X lin").map((one) => one.path), ["twist.linear.x"]);
  assert.deepEqual(searchFields(fields, "lin").map((one) => one.path), ["twist.linear.x", "linear.y"]);
  assert.equal(searchFields(fields, " ").length, 4);
});

function seriesOf(values, { capacity = 1000, period = 1 } = {}) {
  const series = new Series(capacity);
  values.forEach((value, index) => series.push(index * period, value));
  return series;
}

test("a series keeps the newest values, and starts anew when time is set back", () => {
  const series = seriesOf([0, 1, 2, 3, 4, 5, 6], { capacity: 5 });
  assert.deepEqual([series.length, series.timeAt(0), series.valueAt(0), series.last()], [5, 2, 2, 6]);
  assert.deepEqual([series.indexAt(-1), series.indexAt(3.5), series.indexAt(9)], [0, 2, 5]);
  series.push(1, 42);
  assert.deepEqual([series.length, series.last()], [1, 42]);
});

test("decimation keeps every extreme value, whatever the rate", () => {
  const values = Array.from({ length: 50_000 }, (_, index) => Math.sin(index / 900));
  values[31_234] = 77;
  values[31_240] = -55;
  const series = seriesOf(values, { capacity: 60_000, period: 0.001 });
  const [times, shown] = decimate([series], 0, 50, 300);
  assert.equal(times.length, 600);
  assert.equal(shown.length, 600);
  const numbers = shown.filter((value) => typeof value === "number");
  assert.equal(Math.max(...numbers), 77);
  assert.equal(Math.min(...numbers), -55);
  const at = times[shown.indexOf(77)];
  assert.ok(Math.abs(at - 31.234) < 50 / 300, `drawn at ${at} s`);
  assert.ok(shown.indexOf(77) < shown.indexOf(-55), "in order of time");
});

test("a slow topic is drawn as one line, and time without a subscription as a gap", () => {
  const series = new Series();
  series.push(1, 10);
  series.push(5, 20);
  series.gap();
  series.gap();
  series.push(8, 30);
  assert.equal(series.length, 4);
  const [, shown] = decimate([series], 0, 10, 100);
  const kept = shown.filter((value) => value !== undefined);
  assert.deepEqual(kept, [10, 20, null, 30]);
});

test("the line enters the window from the value before it", () => {
  const [, shown] = decimate([seriesOf([3, 4, 5])], 1.5, 2.5, 10);
  assert.deepEqual(shown.filter((value) => value !== undefined), [4, 5]);
});

test("a field is added to a plot once, in a color of its own", () => {
  let plots = [[], []];
  plots = withField(plots, 1, "odom", "a");
  plots = withField(plots, 1, "odom", "a");
  plots = withField(plots, 1, "odom", "b");
  assert.deepEqual(plots, [[], [{ topic: "odom", path: "a", color: 0 }, { topic: "odom", path: "b", color: 1 }]]);
  assert.equal(withField([[{ topic: "t", path: "p", color: 1 }]], 0, "t", "q")[0][1].color, 0);
});

const log = (sec, level, name, msg) => recordOf({ stamp: { sec, nanosec: 0 }, level, name, msg });

test("history and live messages are merged in order of time, each once, with a limit", () => {
  const buffer = new LogBuffer(10);
  buffer.add([log(5, 20, "robot.base", "five"), log(6, 20, "robot.base", "six")]);
  assert.equal(buffer.add([log(1, 20, "robot.base", "one"), log(5, 20, "robot.base", "five")]), 1);
  assert.deepEqual(buffer.records.map((one) => one.text), ["one", "five", "six"]);
  for (let index = 10; index < 40; index += 1) buffer.add([log(index, 20, "robot.base", `${index}`)]);
  assert.ok(buffer.records.length <= 11 && buffer.records.at(-1).text === "39");
  assert.equal(buffer.dropped + buffer.records.length, 33);
  assert.equal(buffer.ids.size, buffer.records.length);
});

test("logs are filtered by component, level and words; a step leads to the next problem", () => {
  const records = [
    log(1, 20, "robot.base", "started"), log(2, 40, "robot.localizer", "Exit code 1"), log(3, 30, "robot.base", "slow device"), log(4, 20, "robot.base", "ready"),
  ];
  assert.deepEqual(filterRecords(records, { component: "base", level: 30 }).map((one) => one.text), ["slow device"]);
  assert.deepEqual(filterRecords(records, { text: "code exit" }).map((one) => one.component), ["localizer"]);
  assert.equal(filterRecords(records, {}), records);
  const restart = [log(5, 30, "robot.root", "restarting child base: exit code 1"), log(6, 20, "robot.root", "child active: base_2")];
  assert.deepEqual(filterRecords(restart, { component: "base" }), [restart[0]]);
  assert.deepEqual([nextProblem(records, 4, -1), nextProblem(records, 2, -1), nextProblem(records, 2, 1)], [2, 1, -1]);
});

const port = (name, topic, direction) => ({ port: name, topic, direction, messages: 0, dropped: 0 });
const COMPONENTS = [
  { name: "root", parent: "", state: "active", ports: [] },
  { name: "world", parent: "root", state: "active", ports: [] },
  { name: "mobile", parent: "root", state: "active", ports: [] },
  { name: "base", parent: "mobile", state: "active", ports: [port("cmd_vel", "/r/cmd_vel", "in"), port("odom", "/r/odom", "out")] },
  { name: "gate", parent: "mobile", state: "active", ports: [port("out", "/r/cmd_vel", "out"), port("scan", "/r/scan", "in")] },
  { name: "scanner", parent: "mobile", state: "active", ports: [port("scan", "/r/scan", "out")] },
  { name: "recorder", parent: "root", state: "active", ports: [port("scan", "/r/scan", "in")] },
  { name: "spare", parent: "mobile", state: "not loaded", ports: [] },
];

test("components are listed below their supervisors, also if these are unknown or in a circle", () => {
  assert.deepEqual(asTree(COMPONENTS).map(([one, depth]) => `${depth} ${one.name}`), [
    "0 root", "1 world", "1 mobile", "2 base", "2 gate", "2 scanner", "2 spare", "1 recorder",
  ]);
  const strange = [{ name: "a", parent: "b" }, { name: "b", parent: "a" }, { name: "c", parent: "gone" }];
  assert.deepEqual(asTree(strange).map(([one]) => one.name).sort(), ["a", "b", "c"]);
  assert.deepEqual(descendants(COMPONENTS, "mobile"), ["base", "gate", "scanner", "spare"]);
});

test("the question before a restart states whether the robot stops, and what else stops", () => {
  assert.match(consequence(COMPONENTS, "scanner"), /^The robot's motion depends on it/);
  assert.match(consequence(COMPONENTS, "recorder"), /does not depend/);
  assert.match(consequence(COMPONENTS, "mobile"), /^Its components stop with it: base, gate, scanner\. The robot's motion depends on it/);
});

const parameter = (type, bounds = "", description = "") => editorOf({ type, bounds, description });

test("a parameter's editor follows from its type, bounds and description", () => {
  const speed = parameter("float", "> 0, <= 3", "Maximum speed [m/s].");
  assert.deepEqual([speed.kind, speed.minimum, speed.maximum, speed.unit, speed.words], ["number", 0, 3, "m/s", "Maximum speed."]);
  assert.equal(parameter("float", ">= -3.141593, <= 3.141593").minimum, -3.141593);
  assert.deepEqual(parameter("Literal['lr', 'paper']").choices, ["lr", "paper"]);
  assert.deepEqual([parameter("float | None").kind, parameter("float | None").optional], ["number", true]);
  assert.equal(parameter("tuple[tuple[float, float], ...]").kind, "json");
  assert.equal(parameter("dict[str, int | None] | None").kind, "json");
  assert.equal(parameter("Path | None").kind, "text");
});

test("what is typed becomes a value of the type, or an error that names it", () => {
  const value = (text, type) => parseInput(text, parameter(type)).value;
  assert.deepEqual([value(" 0.5 ", "float"), value("7", "int"), value("", "float | None"), value("[[1, 2]]", "tuple[int, ...]")], [0.5, 7, null, [[1, 2]]]);
  assert.equal(value("a b", "str"), "a b");
  assert.match(parseInput("1,5", parameter("float")).error, /1,5 is not a number/);
  assert.match(parseInput("", parameter("float")).error, /not a number/);
  assert.match(parseInput("1.5", parameter("int")).error, /not an integer/);
  assert.match(parseInput("[1", parameter("list[int]")).error, /not JSON/);
  for (const [type, one] of [["float", 0.1], ["float | None", null], ["tuple[int, ...]", [1, 2]]])
    assert.deepEqual(parseInput(inputText(one, parameter(type)), parameter(type)).value, one);
});

test("parameters are listed by group, those without one first", () => {
  const names = ["speed", "base.noise", "rate", "base.kind"].map((name) => ({ name }));
  assert.deepEqual(grouped(names).map(([group, members]) => [group, members.length]), [["", 2], ["base", 2]]);
});

test("topics are those with a rate and those that are only advertised, in order", () => {
  const rows = mergeTopics(
    [{ topic: "/r/scan", type: "", publishers: 1, subscribers: 2, rate_hz: 10, age_s: null }],
    [{ topic: "/r/odom", type: "nav_msgs/msg/Odometry", channels: 1 }, { topic: "/r/scan", type: "sensor_msgs/msg/LaserScan", channels: 1 }],
  );
  assert.deepEqual(rows.map((one) => [one.topic, one.type, one.rate]), [["/r/odom", "nav_msgs/msg/Odometry", NaN], ["/r/scan", "sensor_msgs/msg/LaserScan", 10]]);
  assert.equal(endpoints(COMPONENTS, "/r/scan", "in", 3), "gate, recorder, 1 other");
  assert.equal(endpoints(COMPONENTS, "/r/scan", "in", 4, ["/ros/rviz"]), "gate, recorder, /ros/rviz (foreign), 1 other");
  assert.equal(endpoints(COMPONENTS, "/r/none", "out", 0), "none");
  assert.equal(endpoints(COMPONENTS, "/r/none", "out", 2), "2");
});

test("a message's tree names constants and summarizes sequences", () => {
  assert.equal(constantName("state", 4, decode.constants), "STOPPED");
  assert.equal(constantName("count", 4, decode.constants), "");
  assert.equal(preview(new Float32Array(1081).fill(1.5)), "1081 elements: 1.5, 1.5, 1.5, 1.5, …");
  assert.equal(preview([]), "empty");
  assert.equal(preview({ sec: 5, nanosec: 42 }), "5.000000042 s");
  assert.equal(preview({ x: 1, y: -2.5 }), "x 1, y −2.5");
});

test("diagnostics are sorted by urgency; a silent part is not ok", () => {
  const statuses = new Map();
  const one = (name, level) => ({ level, name, message: "", hardware_id: "", values: [] });
  takeStatuses(statuses, "/r/diagnostics", { status: [one("old", 0)] }, 0);
  takeStatuses(statuses, "/r/diagnostics", { status: [one("b", 0), one("a", 0), one("w", 1), one("e", 2)] }, 9000);
  takeStatuses(statuses, "/diagnostics", { status: [one("w", 1)] }, 9500); // the same one, by `ros_names`
  const sorted = sortStatuses(statuses.values(), 10_000);
  assert.deepEqual(sorted.map((status) => status.name), ["e", "w", "old", "a", "b"]);
  assert.deepEqual([sorted[1].age, sorted[2].silent], [0.5, true]);
  assert.deepEqual(sorted.map((status) => toneOf(status)), ["bad", "warning", "warning", "ok", "ok"]);
});

test("corners of the rectified image are placed in the image as taken", () => {
  const camera = { k: [400, 0, 320, 0, 400, 240, 0, 0, 1], r: [1, 0, 0, 0, 1, 0, 0, 0, 1], p: [400, 0, 320, 0, 0, 400, 240, 0, 0, 0, 1, 0] };
  assert.deepEqual(distorted([100, 50], null), [100, 50]);
  const place = (point, d) => distorted(point, { ...camera, distortion_model: "plumb_bob", d }).map((value) => Number(value.toFixed(9)));
  assert.deepEqual(place([100, 50], [0, 0, 0, 0, 0]), [100, 50]);
  // x' = 0.5, y' = 0.25, r² = 0.3125: factor 1 - 0.2 r² = 0.9375
  assert.deepEqual(place([520, 340], [-0.2, 0, 0, 0, 0]), [507.5, 333.75]);
  assert.deepEqual(outlineOf({ corners: new Float64Array([0, 1, 2, 3, 4, 5, 6, 7]) }, null), [[0, 1], [2, 3], [4, 5], [6, 7]]);
  assert.deepEqual(outlineOf({ corners: new Float64Array(0) }, null), []);
  const topics = new Map(["/r/left_image", "/r/left_info", "/r/cam/image_raw", "/r/cam/camera_info"].map((name) => [name, {}]));
  assert.equal(infoTopicOf("/r/left_image", topics), "/r/left_info");
  assert.equal(infoTopicOf("/r/cam/image_raw", topics), "/r/cam/camera_info");
  assert.equal(infoTopicOf("/r/right_image", topics), null);
});
