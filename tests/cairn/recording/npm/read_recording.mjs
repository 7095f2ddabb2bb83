// Prints the messages of a recording as JSON, decoded by the definitions in the file:
// node read_recording.mjs FOLDER_OF_MODULES RECORDING

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [, , modules, recording] = process.argv;
const load = createRequire(`${modules}/package.json`);
const { McapIndexedReader } = load("@mcap/core");
const { parse } = load("@foxglove/rosmsg");
const { MessageReader } = load("@foxglove/rosmsg2-serialization");
const lz4 = load("@foxglove/wasm-lz4");

await lz4.isLoaded;
const bytes = readFileSync(recording);
const reader = await McapIndexedReader.Initialize({
  readable: {
    size: async () => BigInt(bytes.length),
    read: async (offset, size) => bytes.subarray(Number(offset), Number(offset + size)),
  },
  decompressHandlers: { lz4: (data, size) => lz4(data, Number(size)) },
});
const decoders = new Map();
const rows = [];
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  if (!decoders.has(channel.schemaId)) {
    const schema = reader.schemasById.get(channel.schemaId);
    const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
    decoders.set(channel.schemaId, new MessageReader(definition));
  }
  const decoded = decoders.get(channel.schemaId).readMessage(message.data);
  const value = decoded.component ?? decoded.msg ?? decoded.linear?.x ?? "";
  rows.push([channel.topic, String(message.logTime), String(value)]);
}
console.log(JSON.stringify(rows));
