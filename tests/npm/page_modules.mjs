// Modules of the live view's page, without a browser:
//
//   node page_modules.mjs messages FILE.mcap     every message of a recording, by the page's reader and by the reference's
//   node page_modules.mjs pictures               pixel formats against what they must come to
//   node page_modules.mjs history                a plot's memory of a long run
import assert from "node:assert/strict";
import { open, readFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { parse } from "@foxglove/rosmsg";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const page = join(dirname(fileURLToPath(import.meta.url)), "../../bench/live/page");
const asUrl = (text) => `data:text/javascript,${encodeURIComponent(text)}`;
/// The page's modules are modules without saying so to Node.js.
async function load(name) {
  let text = await readFile(join(page, name), "utf8");
  for (const [whole, other] of text.matchAll(/from "\.\/(\w+\.js)"/g)) text = text.replace(whole, `from "${asUrl(await readFile(join(page, other), "utf8"))}"`);
  return import(asUrl(text));
}

const plain = (key, value) => (typeof value === "bigint" ? value.toString() : ArrayBuffer.isView(value) ? Array.from(value, (v) => (typeof v === "bigint" ? v.toString() : v)) : typeof value === "number" && !Number.isFinite(value) ? String(value) : value);
const text = (message) => JSON.stringify(message, plain);

async function messages(file) {
  const { compile } = await load("cdr.js");
  const recording = await open(file);
  const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(recording), decompressHandlers: await loadDecompressHandlers() });
  const readers = new Map(), seen = new Set();
  for await (const message of reader.readMessages()) {
    const schema = reader.schemasById.get(reader.channelsById.get(message.channelId).schemaId);
    if (!readers.has(schema.id)) {
      const definition = new TextDecoder().decode(schema.data);
      readers.set(schema.id, [compile(schema.name, definition), new MessageReader(parse(definition, { ros2: true }))]);
    }
    const [ours, theirs] = readers.get(schema.id);
    assert.equal(text(ours(message.data)), text(theirs.readMessage(message.data)), schema.name);
    seen.add(schema.name);
    for (const cut of [3, 4, message.data.length >> 1, message.data.length - 1])
      assert.throws(() => ours(message.data.subarray(0, cut)), /ends too early|longer than|at least/, `${schema.name} cut at ${cut}`);
  }
  await recording.close();
  assert.ok(seen.size >= 8, `only ${[...seen]}`);

  // Alignment and bounds that no message of ours has.
  const definition = "byte C=1\nuint8 a\nint64 b\nstring<=20 s\nuint8 c\nfloat64[<=4] d\nbool[3] e\nx/Y[] f\nuint8 g\nuint16[2] h\n================================================================================\nMSG: x/Y\nuint8 p\nfloat32 q\nstring r\n";
  const sample = { a: 1, b: -5n, s: "um", c: 2, d: Float64Array.of(1.5, -2), e: [true, false, true], f: [{ p: 3, q: 0.5, r: "" }, { p: 4, q: 1.5, r: "ab" }], g: 9, h: Uint16Array.of(7, 8) };
  const bytes = new MessageWriter(parse(definition, { ros2: true })).writeMessage(sample);
  assert.equal(text(compile("t/T", definition)(new Uint8Array(bytes))), text(sample));
  const absurd = new Uint8Array([0, 1, 0, 0, 255, 255, 255, 127]);
  assert.throws(() => compile("t/S", "string[] s")(absurd), /longer than/);
  assert.throws(() => compile("t/S", "uint8[] s")(absurd), /ends too early/);
  assert.throws(() => compile("t/S", "missing/Type s"), /missing/);
}

async function pictures() {
  globalThis.ImageData = class {
    constructor(width, height) {
      Object.assign(this, { width, height, data: new Uint8ClampedArray(4 * width * height) });
    }
  };
  const { PictureDecoder } = await load("picture.js");
  const bytesOf = (values) => new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  const image = (encoding, width, height, values, step = undefined) => ({ encoding, width, height, step: step ?? bytesOf(values).length / height, data: bytesOf(values) });
  const decode = (picture, prepare = () => {}) => {
    const decoder = new PictureDecoder();
    prepare(decoder);
    return decoder.decode(picture);
  };
  const pixel = ({ pixels }, i) => [...pixels.data.subarray(4 * i, 4 * i + 4)];

  assert.deepEqual(pixel(decode(image("mono8", 2, 1, Uint8Array.of(7, 200))), 1), [200, 200, 200, 255]);
  // Rows with padding.
  assert.deepEqual(pixel(decode(image("mono8", 2, 2, Uint8Array.of(1, 2, 99, 3, 4, 99), 3)), 2), [3, 3, 3, 255]);
  assert.deepEqual(pixel(decode(image("rgb8", 1, 1, Uint8Array.of(1, 2, 3))), 0), [1, 2, 3, 255]);
  assert.deepEqual(pixel(decode(image("bgr8", 1, 1, Uint8Array.of(1, 2, 3))), 0), [3, 2, 1, 255]);
  // 12 bits in 16: by the settings, or by the brightest pixel; 4095 is white.
  assert.deepEqual(pixel(decode(image("mono16", 2, 1, Uint16Array.of(2048, 100)), (d) => d.settings("Mono12")), 0), [128, 128, 128, 255]);
  assert.deepEqual(pixel(decode(image("mono16", 7, 1, Uint16Array.of(4095, 0, 0, 0, 0, 0, 0))), 0), [255, 255, 255, 255]);
  // Mono12p: two pixels in three bytes, 0xABC and 0xDEF.
  const packed = decode(image("mono12p", 2, 1, Uint8Array.of(0xbc, 0xfa, 0xde)));
  assert.deepEqual([pixel(packed, 0)[0], pixel(packed, 1)[0]], [0xab, 0xde]);

  // A mosaic of one colour comes back as this colour in each pixel, at the border too, whatever the pattern.
  const colour = { R: 200, G: 100, B: 40 };
  for (const pattern of ["rggb", "grbg", "gbrg", "bggr"]) {
    const [width, height] = [6, 5], values = new Uint8Array(width * height);
    for (let v = 0; v < height; v++) for (let u = 0; u < width; u++) values[v * width + u] = colour[pattern[2 * (v & 1) + (u & 1)].toUpperCase()];
    const shown = decode(image(`bayer_${pattern}8`, width, height, values));
    for (let i = 0; i < values.length; i++) assert.deepEqual(pixel(shown, i), [200, 100, 40, 255], `${pattern}, pixel ${i}`);
  }

  // Ranges: the ends of viridis (68 1 84, 253 231 37), and nothing where nothing came back.
  const shown = decode(image("32FC1", 3, 1, Float32Array.of(1, NaN, 3)));
  assert.deepEqual(shown.range, [1, 3]);
  for (const [i, expected] of [[0, [68, 1, 84]], [2, [253, 231, 37]]]) pixel(shown, i).slice(0, 3).forEach((c, k) => assert.ok(Math.abs(c - expected[k]) <= 6, `${pixel(shown, i)} for ${expected}`));
  assert.equal(pixel(shown, 1)[3], 0);

  assert.throws(() => decode(image("yuv422", 2, 1, Uint8Array.of(1, 2, 3, 4))), /yuv422/);
  assert.throws(() => decode({ ...image("mono8", 2, 1, Uint8Array.of(1, 2)), width: 1e9 }), /picture of/);
}

async function history() {
  const { History } = await load("history.js");
  const h = new History(), count = 1_000_000;
  for (let i = 0; i < count; i++) h.add(i / 100, i === 777 ? 50 : i === 900_000 ? -50 : Math.sin(i / 1e4));
  let points = 0, least = Infinity, greatest = -Infinity, before = -1;
  h.each(-Infinity, Infinity, (t, low, high) => {
    assert.ok(t >= before, `${t} s after ${before} s`);
    before = t;
    points++;
    least = Math.min(least, low);
    greatest = Math.max(greatest, high);
  });
  assert.ok(points < 8192, `${points} points are kept of ${count}`);
  assert.equal(h.first, 0);
  assert.equal(before, (count - 1) / 100);
  assert.deepEqual([least, greatest], [-50, 50], "a peak is lost where neighbours become one");
  assert.equal(h.at(9990), Math.sin(99.9)); // among the newest
  assert.ok(Math.abs(h.at(5000) - Math.sin(50)) < 0.05);
  assert.ok(Number.isNaN(h.at(-1)));
}

const [, , what, ...rest] = process.argv;
await { messages, pictures, history }[what](...rest);
