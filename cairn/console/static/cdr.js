// Messages: a parser of ROS 2 definitions ("ros2msg") and a decoder of CDR into plain objects.
//
// Numbers become numbers, 64-bit integers BigInts, sequences of numbers typed arrays, all other
// sequences arrays. Lengths are checked against the bytes that are there before anything is allocated.

const NUMBERS = {
  bool: { size: 1, read: (view, at) => view.getUint8(at) !== 0, array: Uint8Array },
  byte: { size: 1, read: (view, at) => view.getUint8(at), array: Uint8Array },
  char: { size: 1, read: (view, at) => view.getUint8(at), array: Uint8Array },
  int8: { size: 1, read: (view, at) => view.getInt8(at), array: Int8Array },
  uint8: { size: 1, read: (view, at) => view.getUint8(at), array: Uint8Array },
  int16: { size: 2, read: (view, at, le) => view.getInt16(at, le), array: Int16Array },
  uint16: { size: 2, read: (view, at, le) => view.getUint16(at, le), array: Uint16Array },
  int32: { size: 4, read: (view, at, le) => view.getInt32(at, le), array: Int32Array },
  uint32: { size: 4, read: (view, at, le) => view.getUint32(at, le), array: Uint32Array },
  int64: { size: 8, read: (view, at, le) => view.getBigInt64(at, le), array: BigInt64Array },
  uint64: { size: 8, read: (view, at, le) => view.getBigUint64(at, le), array: BigUint64Array },
  float32: { size: 4, read: (view, at, le) => view.getFloat32(at, le), array: Float32Array },
  float64: { size: 8, read: (view, at, le) => view.getFloat64(at, le), array: Float64Array },
};

const FIELD = /^([A-Za-z][\w/]*)(<=\d+)?(\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)\s*(=\s*(.*)|.*)?$/;
const SEPARATOR = /^={20,}\s*$/m;
const DEEPEST = 32; // nested messages; a definition that contains itself would not end
const HOST_IS_LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;
const text = new TextDecoder();

/**
 * Parse a definition with all definitions that it depends on, separated by lines of "=".
 *
 * Returns {name, types: Map of full name -> [{name, type, isArray, length}], constants: {NAME: value}}.
 * `type` is the name of a number type, "string", "wstring" or the full name of a message. Throws an
 * Error that names the line at fault.
 */
export function parseDefinition(name, definition) {
  const root = fullName(name);
  const types = new Map();
  let constants = {};
  definition.split(SEPARATOR).forEach((section, index) => {
    let lines = section.split("\n").map((line) => line.trim());
    let current = root;
    if (index > 0) {
      const header = lines.findIndex((line) => line.startsWith("MSG:"));
      if (header < 0) throw new Error(`${name}: section ${index} has no line "MSG: package/Type"`);
      current = fullName(lines[header].slice(4).trim());
      lines = lines.slice(header + 1);
    }
    const parsed = parseFields(current, lines);
    if (index === 0) constants = parsed.constants;
    types.set(current, parsed.fields);
  });
  for (const [owner, fields] of types)
    for (const field of fields) {
      if (field.type in NUMBERS || field.type === "string" || field.type === "wstring") continue;
      field.type = resolve(field.type, owner);
      if (!types.has(field.type)) throw new Error(`${owner}: ${field.name}: no definition of ${field.type}`);
    }
  return { name: root, types, constants };
}

function parseFields(owner, lines) {
  const fields = [];
  const constants = {};
  for (const line of lines) {
    const isText = /^w?string(<=\d+)?\s+[A-Za-z]\w*\s*=/.test(line); // a text may contain a #
    const bare = isText ? line : line.replace(/#.*$/, "").trim();
    if (!bare) continue;
    const match = FIELD.exec(bare);
    if (!match) throw new Error(`${owner}: cannot parse the line "${line.slice(0, 80)}"`);
    const [, type, , array, bounded, length, name, rest, constant] = match;
    if (rest?.startsWith("=")) {
      constants[name] = constantValue(type, constant.trim());
    } else {
      const fixed = array && !bounded && length ? Number(length) : null;
      fields.push({ name, type, isArray: Boolean(array), length: fixed });
    }
  }
  return { fields, constants };
}

function constantValue(type, written) {
  if (type === "string" || type === "wstring") return written.replace(/^["']|["']$/g, "");
  if (/^(true|false)$/i.test(written)) return written.toLowerCase() === "true";
  return Number(written);
}

function fullName(name) {
  const parts = name.split("/");
  return parts.length === 2 ? `${parts[0]}/msg/${parts[1]}` : name;
}

function resolve(type, owner) {
  if (type.includes("/")) return fullName(type);
  if (type === "Header") return "std_msgs/msg/Header";
  return `${owner.split("/")[0]}/msg/${type}`;
}

/**
 * Return a function that decodes a Uint8Array of CDR (either byte order) into an object.
 *
 * It throws an Error when the bytes end early or are not plain CDR.
 */
export function makeDecoder(name, definition) {
  const parsed = parseDefinition(name, definition);
  const read = messageReader(parsed.types, parsed.name, 0);
  const decode = (bytes) => {
    if (bytes.byteLength < 4) throw new Error(`${name}: ${bytes.byteLength} bytes, fewer than the 4 of a CDR header`);
    if (bytes[0] !== 0 || bytes[1] > 1)
      throw new Error(`${name}: representation ${bytes[0]}, ${bytes[1]}; expected plain CDR: 0, 0 or 0, 1`);
    return read(new Reader(bytes, name));
  };
  decode.constants = parsed.constants;
  decode.fields = (type = parsed.name) => parsed.types.get(type) ?? [];
  decode.type = parsed.name;
  return decode;
}

class Reader {
  constructor(bytes, name) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.little = bytes[1] === 1;
    this.name = name;
    this.at = 4; // CDR aligns relative to the end of its header, also of 4 bytes
  }

  /** Align to `size`, and return the position of the next `bytes` bytes. */
  take(size, bytes) {
    const at = 4 + Math.ceil((this.at - 4) / size) * size;
    if (at + bytes > this.bytes.byteLength)
      throw new Error(`${this.name}: ends after ${this.bytes.byteLength} bytes, ${at + bytes} needed`);
    this.at = at + bytes;
    return at;
  }

  length(smallest) {
    const count = this.view.getUint32(this.take(4, 4), this.little);
    if (count * smallest > this.bytes.byteLength - this.at)
      throw new Error(`${this.name}: a sequence of ${count} elements, with ${this.bytes.byteLength - this.at} bytes left`);
    return count;
  }

  string() {
    const count = this.length(1);
    const at = this.take(1, count);
    const end = count > 0 && this.bytes[at + count - 1] === 0 ? at + count - 1 : at + count;
    return text.decode(this.bytes.subarray(at, end));
  }

  wstring() {
    const count = this.length(2);
    const at = this.take(2, 2 * count);
    let result = "";
    for (let i = 0; i < count; i++) result += String.fromCharCode(this.view.getUint16(at + 2 * i, this.little));
    return result;
  }

  numbers(kind, count) {
    const { size, array: Typed } = kind;
    if (count === 0) return new Typed(0);
    const at = this.take(size, count * size);
    const start = this.bytes.byteOffset + at;
    const copy = this.bytes.buffer.slice(start, start + count * size);
    if (size > 1 && this.little !== HOST_IS_LITTLE_ENDIAN) swap(new Uint8Array(copy), size);
    return new Typed(copy);
  }
}

function swap(bytes, size) {
  for (let at = 0; at < bytes.length; at += size) bytes.subarray(at, at + size).reverse();
}

function messageReader(types, name, depth) {
  if (depth > DEEPEST) throw new Error(`${name}: messages are nested more than ${DEEPEST} deep`);
  const fields = types.get(name).map((field) => [field.name, fieldReader(types, field, depth)]);
  if (fields.length === 0)
    return (reader) => {
      reader.take(1, 1); // ROS 2 sends one byte for a message without fields
      return {};
    };
  return (reader) => {
    const value = {};
    for (const [key, read] of fields) value[key] = read(reader);
    return value;
  };
}

function fieldReader(types, field, depth) {
  const kind = NUMBERS[field.type];
  if (kind) {
    const { size, read } = kind;
    if (!field.isArray) return (reader) => read(reader.view, reader.take(size, size), reader.little);
    if (field.length !== null) return (reader) => reader.numbers(kind, field.length);
    return (reader) => reader.numbers(kind, reader.length(size));
  }
  let one;
  if (field.type === "string") one = (reader) => reader.string();
  else if (field.type === "wstring") one = (reader) => reader.wstring();
  else one = messageReader(types, field.type, depth + 1);
  if (!field.isArray) return one;
  return (reader) => {
    const count = field.length ?? reader.length(1);
    const items = [];
    for (let i = 0; i < count; i++) items.push(one(reader));
    return items;
  };
}

/** Return a ROS time ({sec, nanosec}) in seconds. */
export const seconds = (time) => time.sec + time.nanosec * 1e-9;
