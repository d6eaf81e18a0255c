// Reads a recording with the reference libraries, apart from all code of Rigor, and prints what it found as JSON:
// per topic the messages, decoded by the schema that the file carries; pixels and points as SHA-256 of their bytes.
//
//   node read_recording.mjs FILE.mcap
import { createHash } from "node:crypto";
import { open, readFile } from "node:fs/promises";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const BULK = 256; // byte arrays longer than this are given as a digest

function plain(key, value) {
  if (typeof value === "bigint") return value.toString();
  if (value instanceof Uint8Array && value.length > BULK)
    return { bytes: value.length, sha256: createHash("sha256").update(value).digest("hex") };
  return ArrayBuffer.isView(value) ? Array.from(value, (v) => (typeof v === "bigint" ? v.toString() : v)) : value;
}

class Decoder {
  readers = new Map();
  decode(schema, data) {
    if (!this.readers.has(schema.id)) {
      if (schema.encoding !== "ros2msg") throw new Error(`schema ${schema.name}: encoding ${schema.encoding}`);
      const text = new TextDecoder().decode(schema.data);
      this.readers.set(schema.id, new MessageReader(parse(text, { ros2: true })));
    }
    return this.readers.get(schema.id).readMessage(data);
  }
}

const path = process.argv[2];
const decompressHandlers = await loadDecompressHandlers();
const file = await open(path, "r");
const indexed = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
const decoder = new Decoder();
const topics = {};
let last = -1n;
let ordered = true;
for await (const message of indexed.readMessages()) {
  const channel = indexed.channelsById.get(message.channelId);
  const schema = indexed.schemasById.get(channel.schemaId);
  ordered &&= message.logTime >= last;
  last = message.logTime;
  (topics[channel.topic] ??= { type: schema.name, encoding: channel.messageEncoding, qos: channel.metadata.get("offered_qos_profiles") ?? null, messages: [] }).messages.push({
    sequence: message.sequence,
    log_time_ns: message.logTime,
    publish_time_ns: message.publishTime,
    value: decoder.decode(schema, message.data),
  });
}
const metadata = [];
for await (const m of indexed.readMetadata()) metadata.push({ name: m.name, values: Object.fromEntries(m.metadata) });
const attachments = [];
for await (const a of indexed.readAttachments())
  attachments.push({ name: a.name, media_type: a.mediaType, sha256: createHash("sha256").update(a.data).digest("hex") });

// The streaming reader goes through every record from the start, and checks the CRC of each chunk.
const stream = new McapStreamReader({ decompressHandlers, includeChunks: true, validateCrcs: true });
stream.append(await readFile(path));
const records = {};
for (let record; (record = stream.nextRecord()); ) records[record.type] = (records[record.type] ?? 0) + 1;
const done = stream.done();
await file.close();

process.stdout.write(
  JSON.stringify(
    {
      profile: indexed.header.profile,
      library: indexed.header.library,
      statistics: { ...indexed.statistics, channelMessageCounts: Object.fromEntries(indexed.statistics.channelMessageCounts) },
      chunks: indexed.chunkIndexes.length,
      compressions: [...new Set(indexed.chunkIndexes.map((c) => c.compression))],
      ordered,
      stream: { records, done },
      metadata,
      attachments,
      topics,
    },
    plain,
  ) + "\n",
);
