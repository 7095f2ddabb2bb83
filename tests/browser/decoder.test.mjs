// The page's decoder of messages, against bytes of cairn.schemas and against Foxglove's decoder.
//
// MESSAGES names a file of lines {name, schema, samples: [{bytes (hex), value}]}, made by messages.py;
// MODULES a folder with the packages of package.json.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { test } from "node:test";

import { makeDecoder, parseDefinition } from "../../cairn/console/static/cdr.js";

const require = createRequire(`${process.env.MODULES}/`);
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const messages = readFileSync(process.env.MESSAGES, "utf8").trim().split("\n").map((line) => JSON.parse(line));

/** Bring values of both decoders and of JSON to one form: texts for numbers that JSON does not have. */
function plain(value) {
  if (typeof value === "bigint") return String(value);
  if (typeof value === "number" && !Number.isFinite(value)) return String(value);
  if (ArrayBuffer.isView(value)) return Array.from(value, plain);
  if (Array.isArray(value)) return value.map(plain);
  if (value !== null && typeof value === "object") {
    const entries = Object.entries(value).map(([key, one]) => [key === "nsec" ? "nanosec" : key, plain(one)]);
    return Object.fromEntries(entries);
  }
  return value;
}

/** The page has bools in arrays as bytes, as they are on the wire. */
const bytesOfBools = (value) =>
  Array.isArray(value) ? value.map(bytesOfBools) : typeof value === "boolean" ? Number(value) : value !== null && typeof value === "object" ? Object.fromEntries(Object.entries(value).map(([key, one]) => [key, bytesOfBools(one)])) : value;

/** Whether all texts of a value have ASCII characters alone. */
const isAscii = (value) => /^[\x00-\x7f]*$/.test(JSON.stringify(value));

/** Messages of constants alone: Foxglove's reader treats their definition as a module of IDL. */
const WITHOUT_FIELDS = new Set(["rcl_interfaces/msg/ParameterType", "statistics_msgs/msg/StatisticDataType"]);

for (const { name, schema, samples } of messages)
  test(`${name} is decoded as Cairn encoded it, and decoded and encoded as Foxglove does`, () => {
    const decode = makeDecoder(name, schema);
    const types = parse(schema, { ros2: true });
    if (WITHOUT_FIELDS.has(name)) {
      for (const { bytes, value } of samples) assert.deepEqual(decode(Uint8Array.from(Buffer.from(bytes, "hex"))), value);
      assert.throws(() => new MessageReader(types), /no root/);
      return;
    }
    const reader = new MessageReader(types);
    const writer = new MessageWriter(types);
    let written = 0;
    for (const { bytes, value } of samples) {
      const data = Uint8Array.from(Buffer.from(bytes, "hex"));
      const found = bytesOfBools(plain(decode(data)));
      assert.deepEqual(found, bytesOfBools(value));
      const theirs = reader.readMessage(data);
      assert.deepEqual(found, bytesOfBools(plain(theirs)));
      if (!isAscii(value)) continue; // Foxglove's encoder counts UTF-16 units, and so cuts other texts
      assert.equal(Buffer.from(writer.writeMessage(theirs)).toString("hex"), bytes);
      written += 1;
    }
    assert.ok(written > 0);
  });

test("a message that ends early is rejected at every length", () => {
  const { name, schema, samples } = messages.find((one) => one.name === "sensor_msgs/msg/LaserScan");
  const decode = makeDecoder(name, schema);
  const data = Uint8Array.from(Buffer.from(samples.at(-1).bytes, "hex"));
  for (let length = 0; length < data.length; length++) assert.throws(() => decode(data.subarray(0, length)), /LaserScan: /);
});

test("a length beyond the bytes is rejected before anything is allocated", () => {
  const decode = makeDecoder("a/msg/B", "float64[] values");
  const data = Uint8Array.from([0, 1, 0, 0, 255, 255, 255, 255]);
  assert.throws(() => decode(data), /4294967295 elements, with 0 bytes left/);
  const texts = makeDecoder("a/msg/B", "string[] names");
  assert.throws(() => texts(data), /4294967295 elements/);
});

test("big-endian messages are decoded", () => {
  const decode = makeDecoder("a/msg/B", "uint16 one\nfloat64 two\nint32[] three");
  const data = Uint8Array.from([0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0x3f, 0xf8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 1, 255, 255, 255, 254]);
  assert.deepEqual(plain(decode(data)), { one: 258, two: 1.5, three: [1, -2] });
});

test("definitions with constants, defaults, bounds, comments and wide strings are parsed", () => {
  assert.throws(() => parseDefinition("a/B", "uint8 A=1\nint32[ bad"), /cannot parse the line "int32\[ bad"/);
  const parsed = parseDefinition("a/B", "uint8 A=1 # one\nstring S=\"x # y\"\nbool ON=true\nint32 n 5\nstring<=10 s \"#\"\nuint8[<=3] b\nC[2] c\nwstring w\n================================================================================\nMSG: a/C\nHeader h\n================================================================================\nMSG: std_msgs/Header\nuint8 x");
  assert.deepEqual(parsed.constants, { A: 1, S: "x # y", ON: true });
  assert.deepEqual(parsed.types.get("a/msg/B").map((field) => [field.name, field.type, field.isArray, field.length]), [
    ["n", "int32", false, null], ["s", "string", false, null], ["b", "uint8", true, null], ["c", "a/msg/C", true, 2], ["w", "wstring", false, null],
  ]);
  assert.throws(() => parseDefinition("a/B", "c/D d"), /no definition of c\/msg\/D/);
  assert.throws(() => makeDecoder("a/B", "a/B again"), /nested more than 32 deep/);
});
