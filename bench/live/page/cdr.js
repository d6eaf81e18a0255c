// Reads CDR messages by the ros2msg definition that the server advertises with a channel; knows no message of its own.
//
//   const read = compile("sensor_msgs/msg/Image", schemaText);
//   const image = read(bytes);          // { header: { stamp: { sec, nanosec }, frame_id }, height, … }
//
// 64-bit integers become BigInt, uint8[] a Uint8Array on the message's own memory, other numbers' sequences typed
// arrays of their own. Encoding: XCDR1, little endian, alignment counted from behind the 4-byte header.

const decoder = new TextDecoder();

class Cursor {
  constructor(bytes) {
    if (bytes.byteLength < 4) throw new Error("a CDR message has at least 4 bytes");
    if (bytes[1] !== 1) throw new Error(`CDR of kind ${bytes[1]}: only little endian (1) is read`);
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 4;
  }
  /// Where a value of so many bytes lies; goes behind it.
  take(size) {
    const from = this.at + ((4 - this.at) & (size - 1));
    this.at = from + size;
    if (this.at > this.bytes.byteLength) throw new Error("a CDR message ends too early");
    return from;
  }
  span(length) {
    const from = this.at;
    this.at += length;
    if (this.at > this.bytes.byteLength) throw new Error("a CDR message ends too early");
    return this.bytes.subarray(from, this.at);
  }
  count() {
    return this.view.getUint32(this.take(4), true);
  }
  string() {
    const length = this.count();
    const bytes = this.span(length);
    return decoder.decode(length > 0 && bytes[length - 1] === 0 ? bytes.subarray(0, length - 1) : bytes);
  }
}

const number = (size, get, Many) => ({ size, Many, read: (c) => c.view[get](c.take(size), true) });
const PRIMITIVES = {
  bool: { size: 1, read: (c) => c.view.getUint8(c.take(1)) !== 0 },
  byte: number(1, "getUint8", Uint8Array),
  char: number(1, "getUint8", Uint8Array),
  uint8: number(1, "getUint8", Uint8Array),
  int8: number(1, "getInt8", Int8Array),
  uint16: number(2, "getUint16", Uint16Array),
  int16: number(2, "getInt16", Int16Array),
  uint32: number(4, "getUint32", Uint32Array),
  int32: number(4, "getInt32", Int32Array),
  uint64: number(8, "getBigUint64", BigUint64Array),
  int64: number(8, "getBigInt64", BigInt64Array),
  float32: number(4, "getFloat32", Float32Array),
  float64: number(8, "getFloat64", Float64Array),
  string: { size: 4, read: (c) => c.string() },
};

function readMany(element, count, cursor) {
  if (element.Many) {
    if (count === 0) return new element.Many(0);
    const first = cursor.at + ((4 - cursor.at) & (element.size - 1));
    cursor.at = first;
    const bytes = cursor.span(count * element.size);
    return element.Many === Uint8Array ? bytes : new element.Many(bytes.slice().buffer);
  }
  // A value takes a byte at least: a count beyond that is not believed.
  if (count > cursor.bytes.byteLength - cursor.at) throw new Error("a CDR sequence is longer than its message");
  const all = new Array(count);
  for (let i = 0; i < count; i++) all[i] = element.read(cursor);
  return all;
}

/// "pkg/msg/Name" and "pkg/Name" are one name.
const short = (name) => name.replace("/msg/", "/");

function parseDefinitions(mainName, text) {
  const all = new Map();
  for (const part of text.split(/^={20,}$/m)) {
    let name = short(mainName);
    const fields = [];
    for (const raw of part.split("\n")) {
      const line = raw.replace(/#.*/, "").trim();
      const told = /^MSG:\s*(\S+)/.exec(line);
      if (told) name = short(told[1]);
      const field = /^([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?(\d*)\])?\s+([A-Za-z]\w*)(\s*=)?/.exec(line);
      if (told || !field || field[5]) continue; // a constant has a "="
      const bounded = field[2]?.startsWith("[<=");
      fields.push({ type: field[1], many: field[2] !== undefined, fixed: bounded || !field[3] ? null : Number(field[3]), name: field[4] });
    }
    all.set(name, fields);
  }
  return all;
}

/// A function that reads such a message. Throws where the definition names a type that it does not hold.
export function compile(mainName, text) {
  const definitions = parseDefinitions(mainName, text);
  const made = new Map();
  const find = (type, owner) => {
    const name = short(type);
    if (definitions.has(name)) return name;
    const sibling = `${owner.split("/")[0]}/${name}`;
    if (definitions.has(sibling)) return sibling;
    if (name === "Header" && definitions.has("std_msgs/Header")) return "std_msgs/Header";
    throw new Error(`${owner}: the definition of ${type} is missing`);
  };
  const structure = (name) => {
    if (made.has(name)) return made.get(name);
    const result = { size: 1, read: null };
    made.set(name, result);
    const fields = definitions.get(name).map((f) => ({ ...f, element: PRIMITIVES[f.type] ?? structure(find(f.type, name)) }));
    result.read = (cursor) => {
      const message = {};
      for (const f of fields)
        message[f.name] = f.many ? readMany(f.element, f.fixed ?? cursor.count(), cursor) : f.element.read(cursor);
      return message;
    };
    return result;
  };
  const main = structure(short(mainName));
  return (bytes) => main.read(new Cursor(bytes));
}
