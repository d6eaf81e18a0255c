#!/usr/bin/env node
// What the live view costs the loop: runs of a rig without it, with it and nobody there, and with a client that subscribes to
// everything, in turns, so that what else the machine does meets all three. Needs `npm ci --prefix tests/npm`.
//
//   node tools/measure_live.mjs build/release/rigor configs/demo.yaml [--seconds 30] [--rounds 5] [--json]
//
// Prints, of each way, the median over the rounds of the wake-up error and of the cycle's own time (p50, p99, max), misses, what
// was lost, and the ratio of the p99 with a client to that without.
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const require = createRequire(join(dirname(fileURLToPath(import.meta.url)), "../tests/npm/package.json"));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

const words = process.argv.slice(2);
const option = (name, fallback) => {
  const at = words.indexOf(name);
  return at < 0 ? fallback : Number(words.splice(at, 2)[1]);
};
const seconds = option("--seconds", 30);
const rounds = option("--rounds", 5);
const asJson = words.includes("--json");
const [rigor, rig, ...more] = words.filter((w) => w !== "--json");
if (!rigor || !rig) {
  process.stderr.write("expected: measure_live.mjs RIGOR RIG [--seconds S] [--rounds N] [--json] [more words for `rigor run`]\n");
  process.exit(2);
}
const ways = ["without", "nobody", "client"];
const folder = mkdtempSync(join(tmpdir(), "rigor-measure-live-"));

function watch(url, got) {
  const socket = new WebSocket(url.replace("http", "ws"), [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
  const client = new FoxgloveClient({ ws: socket });
  client.on("advertise", (channels) => channels.forEach((c) => client.subscribe(c.id)));
  client.on("message", ({ data }) => ((got.messages += 1), (got.bytes += data.byteLength)));
  client.on("error", () => {});
}

async function run(way) {
  const line = ["run", resolve(rig), "--clock", "wall", "--duration", String(seconds), "--report", join(folder, "report"), "--record", join(folder, "run.mcap"), "--json", ...more];
  if (way !== "without") line.push("--live", "0");
  const child = spawn(rigor, line, { stdio: ["ignore", "pipe", "pipe"], cwd: folder });
  let out = "", err = "";
  const got = { messages: 0, bytes: 0 };
  child.stdout.on("data", (d) => (out += d));
  child.stderr.on("data", (d) => {
    const before = err;
    err += d;
    const url = /live\s+(http:\/\/\S+)/.exec(err);
    if (way === "client" && url && !/live\s+http:\/\/\S+\s/.test(before)) watch(url[1], got);
  });
  const code = await new Promise((done) => child.on("exit", done));
  let result;
  try {
    result = JSON.parse(out);
  } catch {
    throw new Error(`rigor run ended with ${code}: ${err || out}`);
  }
  const loop = result.loop;
  const lost = result.channels.reduce((n, c) => n + (c.lost ?? 0), 0);
  return { way, wake: loop.wake_error, cycle: loop.cycle_time, misses: loop.late_wakeups + loop.overruns, skipped: loop.cycles_skipped, lost, ...got };
}

const median = (list) => {
  const s = list.toSorted ? list.toSorted((a, b) => a - b) : [...list].sort((a, b) => a - b);
  return s.length % 2 ? s[(s.length - 1) / 2] : (s[s.length / 2 - 1] + s[s.length / 2]) / 2;
};

const all = [];
for (let round = 0; round < rounds; round++)
  for (let i = 0; i < ways.length; i++) {
    const way = ways[(i + round) % ways.length];
    const r = await run(way);
    all.push(r);
    if (!asJson) process.stderr.write(`round ${round + 1} ${way.padEnd(8)} wake p99 ${(r.wake.p99_ns / 1e3).toFixed(1)} us, cycle p99 ${(r.cycle.p99_ns / 1e3).toFixed(1)} us\n`);
  }
rmSync(folder, { recursive: true, force: true });

const of = (way, pick) => median(all.filter((r) => r.way === way).map(pick));
const summary = { rig, seconds, rounds, ways: {} };
for (const way of ways)
  summary.ways[way] = {
    wake_us: Object.fromEntries(["p50", "p99", "max"].map((p) => [p, of(way, (r) => r.wake[`${p}_ns`]) / 1e3])),
    cycle_us: Object.fromEntries(["p50", "p99", "max"].map((p) => [p, of(way, (r) => r.cycle[`${p}_ns`]) / 1e3])),
    misses: of(way, (r) => r.misses),
    skipped: of(way, (r) => r.skipped),
    lost: of(way, (r) => r.lost),
    messages_per_s: of(way, (r) => r.messages) / seconds,
    megabytes_per_s: of(way, (r) => r.bytes) / seconds / 1e6,
  };
summary.ratio = {
  wake_p99: summary.ways.client.wake_us.p99 / summary.ways.without.wake_us.p99,
  cycle_p99: summary.ways.client.cycle_us.p99 / summary.ways.without.cycle_us.p99,
};
if (asJson) {
  process.stdout.write(`${JSON.stringify(summary)}\n`);
} else {
  const us = (v) => v.toFixed(1).padStart(9);
  process.stdout.write(`medians of ${rounds} runs of ${seconds} s each\n          wake-up error, us              cycle, us                      misses  lost  messages/s   MB/s\n              p50      p99      max       p50      p99      max\n`);
  for (const [way, w] of Object.entries(summary.ways))
    process.stdout.write(`${way.padEnd(8)} ${us(w.wake_us.p50)}${us(w.wake_us.p99)}${us(w.wake_us.max)} ${us(w.cycle_us.p50)}${us(w.cycle_us.p99)}${us(w.cycle_us.max)} ${String(w.misses).padStart(7)} ${String(w.lost).padStart(5)} ${w.messages_per_s.toFixed(0).padStart(10)} ${w.megabytes_per_s.toFixed(1).padStart(7)}\n`);
  process.stdout.write(`p99 with a client / without: wake-up ${summary.ratio.wake_p99.toFixed(2)}, cycle ${summary.ratio.cycle_p99.toFixed(2)}\n`);
}
