// Uses the console as Foxglove does: npm's client of its protocol, and its decoder of ROS 2 messages.
//
// node client.mjs MODULES URL SUBPROTOCOL: prints one JSON object with what it has received.

import { createRequire } from "node:module";

const [modules, url, subprotocol] = process.argv.slice(2);
const require = createRequire(`${modules}/`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const WebSocket = require("ws");

const client = new FoxgloveClient({ ws: new WebSocket(url, [subprotocol]) });
const found = {};
const next = (event) => new Promise((resolve) => client.on(event, resolve));
client.on("error", (error) => {
  console.error(error);
  process.exit(1);
});
client.on("close", (event) => {
  console.error(`closed: ${event.code} ${event.reason}`);
  process.exit(1);
});

const [info, channels, services] = await Promise.all([
  next("serverInfo"),
  next("advertise"),
  next("advertiseServices"),
]);
found.capabilities = info.capabilities;
found.services = services.map(({ name, request }) => [name, request.encoding]);

const scan = channels.find((channel) => channel.topic === "/robot/scan");
const definition = parse(scan.schema, { ros2: true });
const message = next("message");
const subscription = client.subscribe(scan.id);
const { subscriptionId, timestamp, data } = await message;
found.subscribed = subscriptionId === subscription;
found.timestamp = String(timestamp);
found.scan = new MessageReader(definition).readMessage(data);
client.unsubscribe(subscription);

const channel = { topic: "/robot/scan", encoding: "cdr", schemaName: scan.schemaName };
const published = client.advertise(channel);
client.sendMessage(published, new MessageWriter(definition).writeMessage(found.scan));
client.unadvertise(published);

let values = next("parameterValues");
client.getParameters(["localizer.particles"], "first");
found.parameters = await values;
client.subscribeParameterUpdates(["localizer.particles"]);
values = next("parameterValues");
client.setParameters([{ name: "localizer.particles", value: 700 }], "second");
found.changed = await values;

const call = (name, request) => {
  const service = services.find((one) => one.name === name);
  const payload = new TextEncoder().encode(JSON.stringify(request));
  const view = new DataView(payload.buffer, payload.byteOffset, payload.byteLength);
  client.sendServiceCallRequest({ serviceId: service.id, callId: 9, encoding: "json", data: view });
};
let answer = next("serviceCallResponse");
call("/robot/add", { a: 2, b: 3 });
found.sum = JSON.parse(new TextDecoder().decode((await answer).data));
answer = next("serviceCallFailure");
call("/robot/add", { a: 2 });
found.failure = (await answer).message;

const graph = next("connectionGraphUpdate");
client.subscribeConnectionGraph();
found.graph = await graph;

answer = next("fetchAssetResponse");
client.fetchAsset("package://robot/robot.urdf", 4);
found.asset = (await answer).error;

const plain = (key, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);
console.log(JSON.stringify(found, plain));
process.exit(0);
