// The live view as an independent client sees it: the reference's client of the protocol and its readers of messages. Each
// call runs `rigor run --live` of its own:
//
//   node live_client.mjs CASE RIGOR RIG.yaml
//
// Exit status 0: as expected; 1: what was expected and what came, on stderr.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { open } from "node:fs/promises";
import http from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import wsProtocol from "@foxglove/ws-protocol";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import WebSocket from "ws";

const { FoxgloveClient } = wsProtocol;
const [, , name, rigor, rig] = process.argv;
const PATIENCE_MS = 90_000; // a loaded machine is slow, not wrong
const folder = mkdtempSync(join(tmpdir(), "rigor-live-client-"));
const runs = [];

/// A run in virtual time, not faster than the clock on the wall: {url, process, over, said()}.
async function startRun(...more) {
  const words = ["run", rig, "--clock", "virtual", "--pace", "1", "--live", "0", "--report", join(folder, "report"), ...more];
  const child = spawn(rigor, words, { cwd: folder, env: { ...process.env, XDG_RUNTIME_DIR: folder }, stdio: ["ignore", "pipe", "pipe"] });
  let said = "";
  for (const stream of [child.stdout, child.stderr]) stream.on("data", (d) => (said += d));
  const over = new Promise((resolve) => child.on("exit", (code) => resolve(code)));
  const run = { process: child, over, said: () => said };
  runs.push(run);
  let found;
  await until("a page to be served", () => (found = /live\s+(http:\/\/\S+)/.exec(said)) || child.exitCode !== null);
  assert(found, `rigor run did not serve a page: ${said}`);
  run.url = found[1];
  return run;
}

async function until(what, check) {
  const end = Date.now() + PATIENCE_MS;
  let value;
  while (!(value = await check())) {
    if (Date.now() > end) throw new Error(`expected ${what}, waited ${PATIENCE_MS} ms`);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  return value;
}

/// The reference's client, and all that it was told.
async function connect(url, { protocol = FoxgloveClient.SUPPORTED_SUBPROTOCOL, path = "" } = {}) {
  const socket = new WebSocket(url.replace("http", "ws") + path, [protocol]);
  const client = new FoxgloveClient({ ws: socket });
  const c = { client, socket, channels: new Map(), services: new Map(), status: [], failures: [], times: 0, closed: null, counts: new Map(), last: new Map() };
  const answers = new Map();
  let calls = 0;
  client.on("serverInfo", (info) => (c.info = info));
  client.on("advertise", (list) => list.forEach((ch) => c.channels.set(ch.topic, ch)));
  client.on("advertiseServices", (list) => list.forEach((s) => c.services.set(s.name, s)));
  client.on("status", (s) => c.status.push(s));
  client.on("time", () => c.times++);
  client.on("error", (e) => (c.error = e));
  client.on("serviceCallFailure", (f) => c.failures.push(f));
  client.on("parameterValues", (p) => (c.parameters = p));
  client.on("close", (e) => (c.closed = { code: e.code, reason: e.reason }));
  client.on("serviceCallResponse", (r) => answers.get(r.callId)?.(JSON.parse(new TextDecoder().decode(r.data))));
  const topics = new Map();
  client.on("message", ({ subscriptionId, timestamp, data }) => {
    const topic = topics.get(subscriptionId);
    c.counts.set(topic, (c.counts.get(topic) ?? 0) + 1);
    c.last.set(topic, { timestamp, data });
  });
  c.subscribe = (topic) => topics.set(client.subscribe(c.channels.get(topic).id), topic);
  c.call = (service, request) =>
    new Promise((resolve) => {
      const callId = ++calls;
      answers.set(callId, resolve);
      client.sendServiceCallRequest({ serviceId: c.services.get(service).id, callId, encoding: "json", data: new TextEncoder().encode(JSON.stringify(request)) });
    });
  c.good = async (service, request) => {
    const answer = await c.call(service, request);
    assert.equal(answer.ok, true, JSON.stringify(answer));
    return answer.result;
  };
  c.bad = async (service, request, words) => {
    const answer = await c.call(service, request);
    assert.equal(answer.ok, false, `${service} took ${JSON.stringify(request)}`);
    assert.match(answer.error.message, words);
  };
  c.json = async (topic) => {
    const before = c.counts.get(topic) ?? 0;
    await until(`a message of ${topic}`, () => (c.counts.get(topic) ?? 0) > before);
    return JSON.parse(new TextDecoder().decode(c.last.get(topic).data));
  };
  await until("an answer to the connection", () => c.error || c.closed || c.services.has("rigor/world/set"));
  return c;
}

/// The HTTP status of asking for a WebSocket with these headers.
const upgrade = (url, headers = {}, path = "/") =>
  new Promise((resolve, reject) => {
    const u = new URL(url);
    const request = http.get({ host: u.hostname, port: u.port, path, headers: { Host: u.host, Connection: "Upgrade", Upgrade: "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "foxglove.websocket.v1", ...headers } });
    request.on("upgrade", (response, socket) => (socket.destroy(), resolve(101)));
    request.on("response", (response) => (response.resume(), resolve(response.statusCode)));
    request.on("error", reject);
  });
const get = (url, path, headers = {}) =>
  new Promise((resolve, reject) => {
    const u = new URL(url);
    http
      .get({ host: u.hostname, port: u.port, path, headers }, (response) => {
        let body = "";
        response.on("data", (d) => (body += d)).on("end", () => resolve({ status: response.statusCode, type: response.headers["content-type"], body }));
      })
      .on("error", reject);
  });

const cases = {
  /// Every topic of a recording, with its schema, readable by the reference; what the bench tells of itself.
  async topics() {
    const recording = join(folder, "run.mcap");
    const run = await startRun("--record", recording);
    // Nobody gave a token: one was made, and who does not have it is refused.
    assert.match(run.url, /\?token=[0-9a-f]{32}$/);
    assert.equal(await upgrade(run.url), 401);
    const c = await connect(run.url, { protocol: "foxglove.sdk.v1" });
    assert.equal(c.socket.protocol, "foxglove.sdk.v1");
    assert.deepEqual(c.info.capabilities, ["time", "services", "parameters"]);
    for (const topic of c.channels.keys()) c.subscribe(topic);
    const wanted = ["/camera/image", "/camera/image/small", "/camera/image/settings", "/camera/image/stamp", "/camera/camera_info", "/scanner/real/points", "/scanner/simulated/points", "/odometry/odometry", "/odometry/odometry/wheels", "/imu/imu", "/rigor/commands", "/rigor/live", "/rigor/world"];
    await until(`messages of ${wanted}`, () => wanted.every((t) => (c.counts.get(t) ?? 0) >= 2));
    const readers = new Map();
    const read = (topic) => {
      const channel = c.channels.get(topic);
      assert.equal(channel.encoding, "cdr");
      assert.equal(channel.schemaEncoding, "ros2msg");
      if (!readers.has(topic)) readers.set(topic, new MessageReader(parse(channel.schema, { ros2: true })));
      return readers.get(topic).readMessage(c.last.get(topic).data);
    };
    const image = read("/camera/image");
    assert.deepEqual([image.width, image.height, image.encoding, image.data.length], [160, 120, "rgb8", 160 * 120 * 3]);
    const small = read("/camera/image/small");
    assert.equal(small.format, "jpeg");
    assert.deepEqual([small.data[0], small.data[1]], [0xff, 0xd8]);
    assert.deepEqual(read("/camera/camera_info").k[0], 150);
    const scan = read("/scanner/simulated/points");
    assert.equal(scan.fields[0].name, "x");
    assert(scan.width > 100);
    assert(["drive", "estimate"].includes(read("/rigor/commands").channel));
    assert(Math.abs(Math.hypot(...Object.values(read("/imu/imu").linear_acceleration)) - 9.8) < 2);
    const stamp = c.last.get("/camera/image").timestamp;
    assert(stamp >= 1577836800n * 1000000000n, `virtual time begins in 2020, got ${stamp}`);
    const live = await c.json("/rigor/live");
    assert.equal(live.run.clock, "virtual");
    assert.equal(live.server.clients, 1);
    assert.deepEqual(live.channels.map((ch) => ch.name), ["camera", "scanner", "odometry", "imu", "dark", "truth"]);
    assert.equal(live.channels[1].pair.active, "real");
    assert.deepEqual(live.channels[1].topics, { real: "/scanner/real/points", simulated: "/scanner/simulated/points" });
    assert(live.cycles > 0 && live.t_s > 0 && live.channels[2].samples > 0);
    assert.deepEqual(live.faults.map((f) => [f.channel, f.kind, f.on]), [["dark", "drop", true]]);
    const world = await c.json("/rigor/world");
    assert.equal(world.bodies[0].name, "robot");
    assert(c.times > 0);

    // What nobody subscribes is not sent any more.
    c.client.unsubscribe(0);
    run.process.kill("SIGINT");
    await until("the server to take leave", () => c.closed);
    assert.deepEqual(c.closed, { code: 1001, reason: "run has ended" });
    assert.equal(JSON.parse(new TextDecoder().decode(c.last.get("/rigor/live").data)).ended, true);
    await run.over;
    const file = await open(recording);
    const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers: await loadDecompressHandlers() });
    for (const channel of reader.channelsById.values()) {
      if (channel.topic === "/rigor/visibility" || channel.topic === "/diagnostics") continue; // of recordings alone
      const offered = c.channels.get(channel.topic);
      assert(offered, `${channel.topic} is recorded and not offered`);
      const schema = reader.schemasById.get(channel.schemaId);
      assert.deepEqual([offered.schemaName, offered.schema], [schema.name, new TextDecoder().decode(schema.data)]);
    }
    await file.close();
  },

  /// Frames for whoever comes, whenever; and no more of samples than a client asks for.
  async frames() {
    const run = await startRun();
    const reads = (c, topic) => new MessageReader(parse(c.channels.get(topic).schema, { ros2: true })).readMessage(c.last.get(topic).data);
    const all = await connect(run.url);
    for (const topic of ["/rigor/live", "/tf_static", "/tf", "/clock", "/imu/imu"]) all.subscribe(topic);
    await until("frames and the clock", () => ["/tf_static", "/tf", "/clock"].every((t) => all.counts.get(t) > 0));
    const place = new Map();
    const take = () => [...reads(all, "/tf_static").transforms, ...reads(all, "/tf").transforms].forEach((t) => place.set(t.child_frame_id, t));
    take();
    for (const [frame, parent] of Object.entries({ robot: "world", imu: "robot", camera: "world", camera_optical: "camera", scanner: "world", odom: "world" })) assert.equal(place.get(frame)?.header.frame_id, parent, frame);
    assert(Math.abs(place.get("imu").transform.translation.z - 0.4) < 1e-12);
    const first = reads(all, "/clock").clock, count = all.counts.get("/clock");
    await until("the clock to go on", () => all.counts.get("/clock") > count + 5);
    const now = reads(all, "/clock").clock;
    assert(now.sec > first.sec || now.nanosec > first.nanosec);

    // One that comes later has the frames at once; the topic's 25 a second are 2 for it.
    const few = await connect(run.url, { path: "&max_rate_hz=2" });
    for (const topic of ["/tf_static", "/imu/imu"]) few.subscribe(topic);
    await until("the frames", () => few.counts.get("/tf_static") === 1);
    const utc = (c) => Number(c.last.get("/imu/imu").timestamp) / 1e9;
    await until("a message", () => few.counts.get("/imu/imu") > 0);
    const [t, had, others] = [utc(few), few.counts.get("/imu/imu"), all.counts.get("/imu/imu")];
    await until("messages of 3 s", () => utc(few) >= t + 3);
    const rate = (few.counts.get("/imu/imu") - had) / (utc(few) - t);
    // The newest of each half second, at its own time.
    assert(rate > 1 && rate <= 2.4, `${rate} Hz where 2 were asked for`);
    assert(all.counts.get("/imu/imu") - others > 2 * (few.counts.get("/imu/imu") - had), "the other client gets more");
    const live = await all.json("/rigor/live");
    assert(live.server.frames_thinned > 0);
    assert.equal(await upgrade(run.url, {}, `/?${new URL(run.url).searchParams}&max_rate_hz=fast`), 400);
  },

  /// What the rig expects: not decided, holding, violated since when; and the verdict with it.
  async expects() {
    const run = await startRun("--set", "expect=[{of: odometry, missing: {max: 0}}, {of: imu, missing: {max: 0}}, {of: drive, safe_after_ms: {max: 300}, when: {fault: imu}}, {of: imu.force_z_mps2, value: {max: 0}, from_s: 0.5}, {of: loop, wake_p99_us: {max: 1}}]");
    const c = await connect(run.url);
    c.subscribe("/rigor/live");
    const states = (live) => live.expect.map((e) => e.state).join(" ");
    const come = (wanted) => until(wanted, async () => { const live = await c.json("/rigor/live"); return states(live) === wanted && live; });
    let live = await come("holds holds undecided violated undecided");
    assert.deepEqual(live.expect.map((e) => e.holds), [true, true, null, false, null]);
    const [, , reaction, force, wake] = live.expect;
    assert.equal(reaction.of, "drive");
    assert.equal(reaction.bounds, "of at most 300 after a fault of imu");
    assert.equal(reaction.outcome, "no such fault so far");
    assert.equal(wake.outcome, "known when the run has ended");
    assert(force.first_s > 0.5 && force.first_s < 0.6, `first at ${force.first_s}`);
    assert.equal(live.verdict.state, "bad");
    assert(live.verdict.findings.some((f) => f.text.includes("imu.force_z_mps2: expected value of at most 0 from 0.5 s, got 9.")), JSON.stringify(live.verdict));

    // The robot turns on while the inertial unit is silent.
    await c.good("rigor/control", { command: "fault", channel: "imu", fault: { kind: "drop", for_s: 1 } });
    live = await come("holds violated violated violated undecided");
    assert.match(live.expect[2].text, /^drive: expected safe_after_ms of at most 300 after a fault of imu, got \d+(\.\d+)?, first at [\d.]+ s \(it began at [\d.]+ s; not safe (yet|before it ended)\)$/);
    run.process.kill("SIGINT");
    await until("the server to take leave", () => c.closed);
    live = JSON.parse(new TextDecoder().decode(c.last.get("/rigor/live").data));
    assert.equal(live.ended, true);
    assert.equal(states(live), "holds violated violated violated undecided");
    assert.equal(await run.over, 1);
    for (const e of live.expect.slice(1, 4)) assert(run.said().includes(`not as expected: ${e.of}: expected ${e.quantity}`), run.said());
  },

  /// Control, map, pick, node, set; mistakes in words; the edit in the recording.
  async services() {
    const recording = join(folder, "run.mcap");
    const run = await startRun("--record", recording);
    const c = await connect(run.url);
    c.subscribe("/rigor/live");
    c.subscribe("/rigor/events");
    c.subscribe("/rigor/faults");
    await c.json("/rigor/live");

    assert.equal((await c.good("rigor/control", { command: "run" })).rig, "live-page");
    await c.bad("rigor/control", { command: "flt" }, /expected one of .*fault/);
    await c.good("rigor/control", { command: "switch", channel: "scanner", active: "simulated" });
    await until("the other side", async () => (await c.json("/rigor/live")).channels[1].pair.active === "simulated");
    c.client.setParameters([{ name: "/scanner/active", value: "real" }], "a");
    await until("the first side again", async () => (await c.json("/rigor/live")).channels[1].pair.active === "real");
    c.client.getParameters([], "b");
    await until("parameters", () => c.parameters?.id === "b");
    assert.deepEqual(c.parameters.parameters, [{ name: "/scanner/active", value: "real" }]);

    const map = await c.good("rigor/world/map", {});
    const box = map.objects.find((o) => o.shape === "box" && o.size_m[2] > 0);
    assert(box, `expected a box among ${JSON.stringify(map.objects.slice(0, 5))}`);
    assert(!map.objects.some((o) => o.name.startsWith("robot.")), "parts of platforms are bodies, not objects");
    assert.equal((await c.good("rigor/world/map", { area: { x_m: [900, 901], y_m: [900, 901] } })).objects.length, 0);
    await c.bad("rigor/world/map", { area: { x_m: [1, 0], y_m: [0, 1] } }, /area: expected/);

    const above = await c.good("rigor/world/pick", { x_m: box.x_m, y_m: box.y_m });
    assert(above.id > 0);
    const seen = await c.good("rigor/world/pick", { channel: "camera", u_px: 80, v_px: 60 });
    assert(seen.id > 0 && seen.distance_m > 0.5 && seen.distance_m < 20, JSON.stringify(seen));
    await c.bad("rigor/world/pick", { channel: "camra", u_px: 1, v_px: 1 }, /did you mean camera/);
    await c.bad("rigor/world/pick", { channel: "camera", u_px: "x", v_px: 1 }, /u_px: expected a number/);

    const node = await c.good("rigor/world/node", { id: box.id });
    assert.deepEqual(node.types, ["Body", "Frame", "Object"]);
    const size = node.attributes.find((a) => a.name === "size_m");
    assert.deepEqual([size.kind, size.unit, size.writable, size.of], ["vector3", "m", true, "Body"]);
    await c.bad("rigor/world/node", { id: 123456789 }, /no node 123456789/);
    await c.bad("rigor/world/node", { id: "7" }, /expected the number of a node/);
    const wider = size.value.map((v) => v * 1.5);
    const set = await c.good("rigor/world/set", { id: box.id, attribute: "size_m", value: wider });
    assert.deepEqual(set.value, wider);
    assert.deepEqual((await c.good("rigor/world/node", { id: box.id })).attributes.find((a) => a.name === "size_m").value, wider);
    await c.bad("rigor/world/set", { id: box.id, attribute: "size_m", value: [1, 2] }, /size_m: expected a list of three numbers/);
    await c.bad("rigor/world/set", { id: box.id, attribute: "size_m", value: [-1, 2, 2] }, /expected .* got -1/);
    await c.bad("rigor/world/set", { id: box.id, attribute: "sise_m", value: wider }, /did you mean size_m/);
    await c.bad("rigor/world/set", { id: box.id, attribute: "shape", value: "ball" }, /expected one of box, cylinder/);
    assert.deepEqual((await c.good("rigor/world/node", { id: box.id })).attributes.find((a) => a.name === "size_m").value, wider);

    await c.good("rigor/control", { command: "fault", channel: "imu", fault: { kind: "drop" } });
    await until("the fault", async () => (await c.json("/rigor/live")).faults.some((f) => f.channel === "imu" && f.on));
    c.client.sendServiceCallRequest({ serviceId: 99, callId: 7000, encoding: "json", data: new TextEncoder().encode("{}") });
    c.client.sendServiceCallRequest({ serviceId: c.services.get("rigor/control").id, callId: 7001, encoding: "cdr", data: new TextEncoder().encode("{}") });
    c.client.sendServiceCallRequest({ serviceId: c.services.get("rigor/control").id, callId: 7002, encoding: "json", data: new TextEncoder().encode("{") });
    await until("refusals", () => c.failures.length === 3);
    assert.deepEqual(c.failures.map((f) => f.callId), [7000, 7001, 7002]);

    run.process.kill("SIGINT");
    await run.over;
    const file = await open(recording);
    const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers: await loadDecompressHandlers() });
    const events = [];
    for await (const m of reader.readMessages({ topics: ["/rigor/events"] })) {
      const channel = reader.channelsById.get(m.channelId);
      events.push(new MessageReader(parse(new TextDecoder().decode(reader.schemasById.get(channel.schemaId).data), { ros2: true })).readMessage(m.data));
    }
    await file.close();
    const edits = events.filter((e) => e.kind === "world_edit");
    assert.equal(edits.length, 1, JSON.stringify(events));
    assert.equal(edits[0].value, box.id);
    assert.match(edits[0].text, /size_m = /);
    assert(events.some((e) => e.kind === "pair_switch") && events.some((e) => e.kind === "fault_begin"));
    assert(c.counts.get("/rigor/events") >= 4); // two switches, an edit, a fault
    assert(c.counts.get("/rigor/faults") >= 1);
  },

  /// Who may connect, and what happens to those who do not behave.
  async access() {
    const run = await startRun("--live-open");
    const c = await connect(run.url);
    c.subscribe("/rigor/live");
    const u = new URL(run.url);
    assert.equal(await upgrade(run.url), 101);
    assert.equal(await upgrade(run.url, { Origin: run.url.slice(0, -1) }), 101);
    assert.equal(await upgrade(run.url, { Origin: "http://evil.example" }), 403);
    assert.equal(await upgrade(run.url, { Origin: "null" }), 403);
    assert.equal(await upgrade(run.url, { Host: `evil.example:${u.port}`, Origin: `http://evil.example:${u.port}` }), 403);
    assert.equal(await upgrade(run.url, { "Sec-WebSocket-Protocol": "chat" }), 400);
    assert.equal((await get(run.url, "/", { Host: "evil.example" })).status, 403);
    assert.equal((await get(run.url, "/../../etc/passwd")).status, 404);
    assert.equal((await get(run.url, "/%2e%2e/secret")).status, 404);
    assert.equal((await get(run.url, "/nothing.js")).status, 404);
    const script = await get(run.url, "/foxglove.js");
    assert.deepEqual([script.status, script.type], [200, "text/javascript; charset=utf-8"]);
    assert.equal((await get(run.url, "/token")).status, 204);

    // The port is taken: refused before anything is touched, with exit status 2.
    const second = spawnSync(rigor, ["run", rig, "--clock", "virtual", "--live", u.port, "--record", join(folder, "no.mcap")], { encoding: "utf8" });
    assert.equal(second.status, 2, second.stderr);
    assert.match(second.stderr, new RegExp(`127.0.0.1:${u.port}.*in use`));

    const big = await connect(run.url);
    big.socket.send("x".repeat(300_000));
    await until("a client that says too much to be let go", () => big.closed);
    assert.equal(big.closed.code, 1009);
    const odd = await connect(run.url);
    odd.socket.send("{");
    odd.socket.send(Buffer.from([2, 1]));
    odd.socket.send(JSON.stringify({ op: "subscribe", subscriptions: [{ id: 1, channelId: 9999 }] }));
    odd.socket.send(JSON.stringify({ op: "fetchAsset", uri: "package://x", requestId: 1 }));
    await until("four complaints", () => odd.status.length === 4);
    assert(odd.status.every((s) => s.level === 2));
    assert.equal(odd.closed, null);
    odd.socket.terminate(); // without a word

    const many = [];
    for (let i = 0; i < 7; i++) many.push(await connect(run.url));
    await until("eight clients", async () => (await c.json("/rigor/live")).server.clients === 8);
    assert.equal(await upgrade(run.url), 503);
    many.forEach((m) => m.socket.close());
    await until("one client", async () => (await c.json("/rigor/live")).server.clients === 1);
    assert.equal(await upgrade(run.url), 101);
    assert.equal(run.process.exitCode, null);
  },

  /// A client that does not read loses messages; another one and the bench lose nothing.
  async slow() {
    const run = await startRun("--set", "channels.camera.rate_hz=10");
    const c = await connect(run.url);
    c.subscribe("/rigor/live");
    const slow = await connect(run.url);
    slow.socket._socket.pause();
    for (const topic of slow.channels.keys()) slow.subscribe(topic);
    const live = await until("messages dropped", async () => {
      const l = await c.json("/rigor/live");
      return l.server.frames_dropped > 0 && l;
    });
    // Soon, and not when buffers are full: what it asks for then is not answered behind megabytes.
    assert.ok(live.server.bytes_sent < 1_500_000, `${live.server.bytes_sent} bytes were sent before one was dropped`);
    assert.equal(live.skipped, 0);
    assert.equal(live.server.events_lost, 0);
    assert.equal(live.channels.reduce((n, ch) => n + ch.dropped, 0), 0);
    const before = live.cycles;
    await until("the loop to go on", async () => (await c.json("/rigor/live")).cycles > before);
    slow.socket._socket.resume();
    await until("what was dropped to be told", () => slow.status.some((s) => s.level === 1 && /does not read as fast/.test(s.message)));
  },

  async token() {
    const run = await startRun("--live-token", "open-sesame");
    assert.equal(await upgrade(run.url), 401);
    assert.equal(await upgrade(run.url, {}, "/?token=open-sesam"), 401);
    assert.equal(await upgrade(run.url, {}, "/?token=open-sesame"), 101);
    assert.equal(await upgrade(run.url, { Authorization: "Bearer open-sesame", Origin: "http://other.example" }), 101);
    assert.equal(await upgrade(run.url, { Authorization: "Bearer open-sesame", Host: "evil.example" }), 403);
    assert.equal((await get(run.url, "/token?token=open-sesame")).status, 204);
    assert.equal((await get(run.url, "/token")).status, 401);
    const c = await connect(run.url, { path: "?token=open-sesame" });
    assert(c.info);
  },
};

let status = 0;
try {
  await cases[name]();
} catch (e) {
  process.stderr.write(`${e.stack}\n${runs.map((r) => r.said().slice(-2000)).join("\n")}\n`);
  status = 1;
}
for (const run of runs) {
  run.process.kill("SIGKILL");
  await run.over;
}
rmSync(folder, { recursive: true, force: true });
process.exit(status);
