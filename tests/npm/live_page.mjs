// The live view's page in headless Chromium, against a `rigor run --live` or `rigor replay --live` of each case's own. The cases share the browser:
//
//   node live_page.mjs RIGOR RIG.yaml CASE...
//
// Says `passed CASE` or `failed CASE` on stdout when a case has ended; what was expected and what came goes to stderr. Exit status 1: one failed.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { chromium } from "playwright-core";

const [rigor, rig] = process.argv.slice(2, 4).map((path) => resolve(path));
const PATIENCE_MS = 120_000; // a loaded machine is slow, not wrong
// Without a window it is the smaller program, and starts in half the time.
const CHROMIUM = [process.env.CHROMIUM, "/usr/bin/chromium-headless-shell", "/usr/bin/chromium"].find((path) => path && existsSync(path));
// Points are drawn by WebGL, in software; all else by the processor without such a detour, which costs a third of that.
const CHROMIUM_ARGS = ["--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing", "--disable-gpu-rasterization"];
let folder; // of the case

async function freePort() {
  const server = createServer();
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address();
  await new Promise((resolve) => server.close(resolve));
  return port;
}

/// A run in virtual time, at most as fast as the clock: on a slow machine it takes longer, and nothing comes late. {url, process, said()}.
const startRun = (...more) => serve(["run", rig, "--clock", "virtual", ...more]);
/// By the wall clock, with the scanner's emulator in a process of its own, on a port of its own.
async function startWallClockRun() {
  const port = await freePort();
  return serve(["run", rig, "--clock", "wall", "--set", `channels.scanner.pair.real.port=${port}`, "--set", `emulators.scanner.port=${port}`]);
}
const runs = []; // of the case
async function serve(command) {
  const words = [...command, "--live", "0", "--report", join(folder, "report")];
  const process = spawn(rigor, words, { cwd: folder, env: { ...globalThis.process.env, XDG_RUNTIME_DIR: folder }, stdio: ["ignore", "pipe", "pipe"] });
  let said = "";
  for (const stream of [process.stdout, process.stderr]) stream.on("data", (d) => (said += d));
  const over = new Promise((resolve) => process.on("exit", resolve));
  const run = { process, over, said: () => said };
  runs.push(run); // ended with the case, however that ends
  const end = Date.now() + PATIENCE_MS;
  let found;
  while (!(found = /live\s+(http:\/\/\S+)/.exec(said))) {
    if (process.exitCode !== null || Date.now() > end) throw new Error(`rigor ${command[0]} did not serve a page: ${said}`);
    await new Promise((done) => setTimeout(done, 20));
  }
  run.url = found[1];
  return run;
}

async function openPage(browser, url, width = 1400) {
  const page = await browser.newPage({ viewport: { width, height: 900 } });
  page.setDefaultTimeout(PATIENCE_MS);
  page.trouble = [];
  page.on("pageerror", (e) => page.trouble.push(e.stack));
  page.on("console", (m) => m.type() === "error" && page.trouble.push(m.text()));
  await page.goto(url);
  return page;
}

const until = (page, what, check, argument) =>
  page.waitForFunction(check, argument, { timeout: PATIENCE_MS }).catch(async (e) => {
    const shown = await page.evaluate(() => document.body.innerText).catch(() => "nothing");
    throw new Error(`expected ${what}; ${e.message}\n${shown}\n${page.trouble.join("\n")}`);
  });

const pictures = (page, tile, count) =>
  until(page, `${count} pictures of ${tile}`, ([t, n]) => Number(document.querySelector(`[data-channel="${t}"] canvas`)?.dataset.pictures ?? 0) >= n, [tile, count]);

/// The pixels that the page shows of a camera, and how many pictures it has shown by then.
const pixels = (page, tile) =>
  page.evaluate((t) => {
    const canvas = document.querySelector(`[data-channel="${t}"] canvas`);
    return { count: Number(canvas.dataset.pictures), stamp: canvas.dataset.stamp, data: Array.from(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data) };
  }, tile);

function difference(a, b) {
  assert.equal(a.data.length, b.data.length);
  let sum = 0;
  for (let i = 0; i < a.data.length; i++) sum += Math.abs(a.data[i] - b.data[i]);
  return sum / a.data.length;
}

async function nextPicture(page, tile) {
  const before = await pixels(page, tile);
  await pictures(page, tile, before.count + 1);
  return pixels(page, tile);
}

/// What `/rigor/live` says next, asked for by a client that shares nothing with the page but the browser.
const liveState = (page) =>
  page.evaluate(
    () =>
      new Promise((resolve, reject) => {
        const url = new URL("/", location.href);
        url.search = location.search;
        url.protocol = "ws:";
        const socket = new WebSocket(url.href, ["foxglove.websocket.v1"]);
        socket.binaryType = "arraybuffer";
        socket.onerror = () => reject(new Error("no connection"));
        socket.onmessage = ({ data }) => {
          if (typeof data !== "string") {
            if (new Uint8Array(data)[0] !== 1) return; // the server's clock
            socket.close();
            return resolve(JSON.parse(new TextDecoder().decode(new Uint8Array(data, 13))));
          }
          const message = JSON.parse(data);
          const live = message.op === "advertise" && message.channels.find((c) => c.topic === "/rigor/live");
          if (live) socket.send(JSON.stringify({ op: "subscribe", subscriptions: [{ id: 7, channelId: live.id }] }));
        };
      }),
  );

/// What the run answers to a command of the socket (docs/faults.md), asked for over the page's port.
const command = (page, request) =>
  page.evaluate(
    (asked) =>
      new Promise((resolve, reject) => {
        const socket = new WebSocket(`ws://${location.host}/${location.search}`, ["foxglove.websocket.v1"]);
        socket.binaryType = "arraybuffer";
        socket.onerror = () => reject(new Error("no connection"));
        socket.onmessage = ({ data }) => {
          if (typeof data === "string") {
            const message = JSON.parse(data);
            const service = message.op === "advertiseServices" && message.services.find((s) => s.name === "rigor/control");
            if (!service) return;
            const encoding = new TextEncoder().encode("json"), payload = new TextEncoder().encode(asked);
            const bytes = new Uint8Array(13 + encoding.length + payload.length), view = new DataView(bytes.buffer);
            view.setUint8(0, 2); // a call of a service
            view.setUint32(1, service.id, true);
            view.setUint32(5, 1, true);
            view.setUint32(9, encoding.length, true);
            bytes.set(encoding, 13);
            bytes.set(payload, 13 + encoding.length);
            return socket.send(bytes);
          }
          const view = new DataView(data);
          if (view.getUint8(0) !== 3) return; // an answer
          socket.close();
          resolve(JSON.parse(new TextDecoder().decode(new Uint8Array(data, 13 + view.getUint32(9, true)))));
        };
      }),
    JSON.stringify(request),
  );

const tile = (channel) => `[data-channel="${channel}"]`;
const status = (page, channel, word) => until(page, `${channel} to be ${word}`, ([c, w]) => document.querySelector(`[data-channel="${c}"]`)?.dataset.status === w, [channel, word]);
const logged = (page, text) => until(page, `"${text}" in the log`, (t) => document.querySelector("#events").innerText.includes(t), text);

const CASES = {
  /// Every kind of channel shows what it has, what has nothing says so, and nothing goes wrong on the way.
  async ShowsEveryKindOfChannelWithoutTrouble(browser) {
    const run = await startRun();
    const page = await openPage(browser, run.url);
    await pictures(page, "camera", 3);
    assert.equal(await page.title(), "live-page · Rigor");
    const first = await pixels(page, "camera"), second = await nextPicture(page, "camera");
    assert.notEqual(first.stamp, second.stamp);
    assert.ok(difference(first, second) > 0, "two pictures of a noisy camera are the same");
    assert.ok(new Set(second.data).size > 20, "a picture of few grey levels");

    for (const side of ["real", "simulated"])
      await until(page, `points of the ${side} side`, (topic) => {
        const canvas = document.querySelector(`canvas[data-topic="${topic}"]`);
        if (!(canvas?.dataset.pictures > 0)) return false;
        const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        let drawn = 0;
        for (let i = 3; i < data.length; i += 4) if (data[i] > 0 && Math.max(data[i - 1], data[i - 2], data[i - 3]) - Math.min(data[i - 1], data[i - 2], data[i - 3]) > 60) drawn++;
        return drawn > 100; // rings and ground are grey
      }, `/scanner/${side}/points`);
    for (const channel of ["odometry", "imu"]) await until(page, `values of ${channel}`, (c) => document.querySelector(`[data-channel="${c}"] .numbers-view`)?.dataset.values > 5, channel);
    await until(page, "the turn rate of the robot, 0.5 rad/s or what slip leaves of it", () => {
      const value = [...document.querySelectorAll('[data-channel="odometry"] .series')].find((s) => s.textContent.startsWith("yaw"))?.querySelector(".value").textContent;
      return Number(value) > 0.1 && Number(value) < 1;
    });
    await until(page, "a tile that says that nothing came", () => /no picture so far|nothing has come/i.test(document.querySelector('[data-channel="dark"]').innerText));
    await until(page, "a map with the robot", () => document.querySelector("#world .map") && !document.querySelector("#world").hidden);

    // Large: the sensor's own pixels in place of the small JPEG.
    const before = await pixels(page, "camera");
    await page.click(`${tile("camera")} button.icon`);
    await until(page, "pixels as the sensor gave them", () => document.querySelector('[data-channel="camera"] canvas').dataset.encoding === "rgb8");
    await pictures(page, "camera", before.count + 2);

    // One time axis and one cursor for all plots; held and moved back while the run goes on.
    // Plots beyond the window are drawn when they come into it.
    const shown = '[data-channel="odometry"] canvas.plot[data-until]';
    const plot = () => page.evaluate((at) => ({ ...document.querySelector(at).dataset }), shown);
    const same = (key) => until(page, `one ${key} of all plots`, (k) => {
      const all = [...document.querySelectorAll("canvas.plot")].filter((c) => {
        const { top, bottom, height } = c.getBoundingClientRect();
        return c.dataset.until && height > 0 && top < innerHeight && bottom > 0;
      }).map((c) => c.dataset[k]);
      return all.length > 1 && all[0] !== "" && all.every((v) => v === all[0]);
    }, key);
    await page.locator('[data-channel="odometry"] canvas.plot').first().scrollIntoViewIfNeeded();
    await page.click("#timeline button");
    await same("until");
    await page.locator('[data-channel="odometry"] canvas.plot').first().hover({ position: { x: 150, y: 30 } });
    await same("cursor");
    const held = (await plot()).until;
    await until(page, "the run to go on", (t) => Number(document.querySelector("#timeline input").max) > Number(t) + 1, held);
    assert.equal((await plot()).until, held, "a page that is paused moves on");
    const beginning = Number(await page.getAttribute("#timeline input", "min"));
    await page.locator("#timeline input").evaluate((slider) => ((slider.value = Number(slider.min) + 0.2), slider.dispatchEvent(new Event("input"))));
    await until(page, "plots of the run's beginning", ([at, t]) => Math.abs(Number(document.querySelector(at).dataset.until) - t) < 0.21, [shown, beginning]);
    // The picture is that of the instant, too.
    await page.locator(`${tile("camera")} canvas`).scrollIntoViewIfNeeded();
    await until(page, "the picture of the run's beginning", (stamp) => {
      const tile = document.querySelector('[data-channel="camera"]');
      return !tile.querySelector(".held").hidden && tile.querySelector("canvas").dataset.stamp <= stamp;
    }, first.stamp);
    await page.locator('[data-channel="odometry"] canvas.plot').first().scrollIntoViewIfNeeded();
    await page.selectOption("#timeline select", "Infinity");
    await page.click("#timeline button");
    await until(page, "plots that follow again, from the start", ([at, h, t]) => {
      const { from, until } = document.querySelector(at).dataset;
      return Number(until) > Number(h) && Math.abs(Number(from) - t) < 0.5;
    }, [shown, held, beginning]);

    // The estimate is 0.1 m off and claims 1 cm.
    await until(page, "the estimate's error", () => {
      const said = document.querySelector("#estimate .figures-line");
      return /^\d+ mm from the truth, \d+ sigma/.test(said.textContent) && Number(said.textContent.split(" ")[0]) > 50 && said.classList.contains("bad");
    });
    assert.ok(await page.locator("#estimate").isVisible());

    // Who comes late sees the run from its start.
    const late = await openPage(browser, run.url);
    await until(late, "plots from before the page was opened", (t) => {
      const bar = document.querySelector("#timeline input");
      return bar && Number(bar.max) > 0 && Number(bar.min) < t + 0.5;
    }, beginning);
    assert.deepEqual(late.trouble, []);
    await late.close();

    // The border of the panels can be moved.
    const wide = () => page.evaluate(() => document.querySelector("aside").clientWidth);
    const before_px = await wide();
    await page.locator("#splitter").focus();
    await page.keyboard.press("ArrowRight");
    assert.ok((await wide()) < before_px - 10, "the panels are as wide as before");

    // The map over the whole page, and back.
    await page.click('[aria-label="Enlarge the map"]');
    await until(page, "a large map", () => document.querySelector("#world .map").clientWidth > 0.9 * innerWidth && document.querySelector("#world .map").clientHeight > 0.5 * innerHeight);
    await page.keyboard.press("Escape");
    await until(page, "a small map", () => document.querySelector("#world .map").clientWidth < 0.7 * innerWidth);

    // Dark: text stays legible (WCAG AA).
    await page.emulateMedia({ colorScheme: "dark" });
    const contrast = await page.evaluate(() => {
      const light = (css) => css.match(/[\d.]+/g).slice(0, 3).map((v) => ((v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((s, v, i) => s + v * [0.2126, 0.7152, 0.0722][i], 0);
      const [a, b] = [light(getComputedStyle(document.querySelector(".tile h3")).color), light(getComputedStyle(document.querySelector(".tile")).backgroundColor)].sort((x, y) => y - x);
      return (a + 0.05) / (b + 0.05);
    });
    assert.ok(contrast > 4.5, `contrast ${contrast}`);
    await page.emulateMedia({ colorScheme: "light" });

    // Narrow: nothing sticks out.
    await page.setViewportSize({ width: 360, height: 700 });
    const [inner, outer] = await page.evaluate(() => [document.documentElement.scrollWidth, window.innerWidth]);
    assert.ok(inner <= outer, `the page is ${inner} px wide in a window of ${outer} px`);
    assert.deepEqual(page.trouble, []);
  },

  /// A click hands on the other side: in the tile, in the pair's panel, in what every client gets, in the recording's events.
  async SwitchesAPair(browser) {
    const run = await startRun();
    const page = await openPage(browser, run.url);
    const chosen = (side) =>
      until(page, `the ${side} side to be handed on`, (s) => {
        const all = [...document.querySelectorAll(`.side-switch [data-side="${s}"]`)];
        return all.length === 2 && all.every((b) => b.getAttribute("aria-checked") === "true");
      }, side);
    const handedOn = async (side) => {
      let state;
      for (let i = 0; i < 50; i++) {
        state = (await liveState(page)).channels.find((c) => c.name === "scanner").pair.active;
        if (state === side) return;
      }
      assert.equal(state, side);
    };
    await chosen("real");
    await handedOn("real");
    await page.click(`${tile("scanner")} [data-side="simulated"]`);
    await chosen("simulated");
    await handedOn("simulated");
    await logged(page, "pair switch");
    await page.click('#pairs [data-side="real"]'); // and back, from the panel
    await chosen("real");
    await handedOn("real");
    assert.deepEqual(page.trouble, []);
  },

  /// A fault from the form is refused in the bench's words or takes hold: status, list, log; and it ends.
  async InjectsAFaultAndShowsIt(browser) {
    const run = await startRun();
    const page = await openPage(browser, run.url);
    await pictures(page, "camera", 1);
    await page.selectOption("#fault-channel", "camera");
    await page.selectOption("#fault-kind", "delay");
    await page.fill('.fault-form [name="delay_ms"]', "0");
    await page.click(".fault-form button.primary");
    await until(page, "a refusal that names the key", () => document.querySelector(".fault-form .error").textContent.includes("delay_ms"));
    assert.equal((await liveState(page)).faults.filter((f) => f.live).length, 0);

    await page.selectOption("#fault-kind", "disconnect");
    await page.click(".fault-form button.primary");
    await status(page, "camera", "disconnected");
    await until(page, "the fault in the list", () => [...document.querySelectorAll('#faults li[data-state="on"]')].some((l) => l.textContent.includes("disconnect")));
    await logged(page, "fault begin");
    assert.ok((await liveState(page)).faults.some((f) => f.live && f.on && f.kind === "disconnect"), "the bench knows of no such fault");

    const before = await pixels(page, "camera");
    await page.click('#faults li[data-state="on"] button >> nth=0');
    await pictures(page, "camera", before.count + 2);
    await logged(page, "fault end");
    await page.reload(); // what happened before a page was opened is in its log
    await logged(page, "fault begin");
    await until(page, "the fault to be over", () => [...document.querySelectorAll('#faults li[data-state="over"]')].some((l) => l.textContent.includes("disconnect")));
    assert.deepEqual(page.trouble, []);
  },

  /// A node is picked in a picture, its size changed: the next picture shows it. What the schema forbids is refused.
  async AnEditIsSeenInTheNextPictureAndABadOneIsRefused(browser) {
    const run = await startRun();
    const page = await openPage(browser, run.url);
    await pictures(page, "camera", 2);
    const box = await page.locator(`${tile("camera")} canvas`).boundingBox();
    await page.locator(`${tile("camera")} canvas`).click({ position: { x: (137 / 160) * box.width, y: (68 / 120) * box.height } }); // the crate
    await until(page, "the crate to be selected", () => document.querySelector(".node-panel h3").textContent.startsWith("crate"));

    // Two pictures of an unchanged world, so that noise is known; then the next ones after the edit.
    const one = await pixels(page, "camera"), two = await nextPicture(page, "camera");
    const noise = difference(one, two);
    const field = page.locator('[data-attribute="size_m"] input').first();
    assert.equal(await field.inputValue(), "0.8");
    await field.fill("2.4");
    await field.press("Enter");
    await until(page, "an answer to the edit", () => ["done", "refused"].includes(document.querySelector('[data-attribute="size_m"]').dataset.state));
    assert.equal(await page.innerText('[data-attribute="size_m"] .error'), "", "the edit was refused");
    let edited = 0;
    for (let i = 0; i < 20 && !(edited > 1.3 * noise); i++) edited = difference(two, await nextPicture(page, "camera"));
    if (process.env.RIGOR_LIVE_PAGE_SAY) console.error({ noise, edited });
    assert.ok(edited > 1.3 * noise, `a crate of three times the width changed the picture by ${edited}, noise by ${noise}`);
    await logged(page, "crate: size_m");

    await field.fill("-1");
    await field.press("Enter");
    await until(page, "the schema's refusal", () => /size_m|-1|expected/.test(document.querySelector('[data-attribute="size_m"] .error').textContent));
    assert.equal(await field.getAttribute("aria-invalid"), "true");
    await field.fill("wide");
    await field.press("Enter");
    await until(page, "a refusal of what is no number", () => /number|vector3/.test(document.querySelector('[data-attribute="size_m"] .error').textContent));
    await page.click('[aria-label="Close the node"]');
    await page.fill("#world input[type=search]", "crate");
    await page.press("#world input[type=search]", "Enter");
    await until(page, "the node's last good value", () => !document.querySelector(".node-panel").hidden && document.querySelector('[data-attribute="size_m"] input')?.value === "2.4");
    assert.deepEqual(page.trouble, []);
  },

  /// Without the token there is nothing to see but the reason; with it all.
  async AsksForTheToken(browser) {
    const run = await startRun("--live-token", "open-sesame");
    const stranger = await openPage(browser, run.url);
    await until(stranger, "the reason", () => /asks for a token/.test(document.getElementById("banner").innerText));
    assert.equal(await stranger.locator(".tile").count(), 0);
    const wrong = await openPage(browser, `${run.url}?token=open-barley`);
    await until(wrong, "the reason", () => /asks for a token/.test(document.getElementById("banner").innerText));
    const friend = await openPage(browser, `${run.url}?token=open-sesame`);
    await pictures(friend, "camera", 1);
    assert.deepEqual(friend.trouble, []);
  },

  /// A replay shows what the run's channels had; what there is no more, a world and faults, is not offered.
  async ShowsAReplayAsARun(browser) {
    const recording = join(folder, "run.mcap");
    const made = spawnSync(rigor, ["run", rig, "--clock", "virtual", "--duration", "4", "--record", recording, "--report", join(folder, "made")], { encoding: "utf8" });
    assert.equal(made.status, 0, made.stderr);
    const run = await serve(["replay", recording, "--pace", "0.2"]); // 20 s
    const page = await openPage(browser, run.url);
    await pictures(page, "camera", 3);
    const first = await pixels(page, "camera"), second = await nextPicture(page, "camera");
    assert.notEqual(first.stamp, second.stamp);
    assert.ok(difference(first, second) > 0, "two pictures of a noisy camera are the same");
    await until(page, "points of what was handed on", () => document.querySelector('canvas[data-topic="/scanner/points"]')?.dataset.pictures > 0);
    for (const channel of ["odometry", "imu"]) await until(page, `values of ${channel}`, (c) => document.querySelector(`[data-channel="${c}"] .numbers-view`)?.dataset.values > 5, channel);
    for (const channel of ["camera", "scanner", "odometry", "imu"]) await until(page, `${channel} to be as it was`, (c) => ["fresh", "held", "ended"].includes(document.querySelector(`[data-channel="${c}"]`).dataset.status), channel);
    await until(page, "a tile that says that nothing came", () => /no picture so far|nothing has come/i.test(document.querySelector('[data-channel="dark"]').innerText));
    const live = await liveState(page);
    assert.equal(live.run.replay, true);
    assert.ok(live.cycles > 0 && live.t_s > 0 && live.channels.find((c) => c.name === "camera").samples > 0);
    assert.match(await page.locator("#head").innerText(), /replay/);
    for (const panel of ["faults", "pairs"]) assert.equal(await page.locator(`#${panel}`).isVisible(), false, `a replay has a panel ${panel}`);
    assert.equal(await page.locator("#world input[type=search]").isVisible(), false, "a replay has a world to be searched");

    // Its page stays after its end, also for those who open it then, until somebody ends it.
    await until(page, "the end of the replay", () => /the replay has ended/i.test(document.getElementById("banner").innerText));
    await page.reload();
    await until(page, "the replay from its start, after its end", () => {
      const bar = document.querySelector("#timeline input");
      return /the replay has ended/i.test(document.getElementById("banner").innerText) && Number(bar.min) < 0.5 && Number(bar.max) > 3.5;
    });
    assert.match(run.said(), /stays until Ctrl-C/);
    const answer = await command(page, { command: "status" });
    assert.equal(answer.ok, false);
    assert.match(answer.error.message, /the run has ended/);
    assert.equal(run.process.exitCode, null);
    run.process.kill("SIGINT");
    assert.equal(await run.over, 0);
    assert.deepEqual(page.trouble, []);
  },

  /// Each expectation of the rig with how it stands, and their sum; a rig without shows none.
  async ShowsHowExpectationsStand(browser) {
    const run = await startRun("--set", "expect=[{of: odometry.yaw_deg, value: {min: -10000}}, {of: imu, late: {max: 1000000}, age_ms: {max: 1000000}}, {of: drive, safe_after_ms: {max: 300}, when: {fault: imu}}, {of: imu.force_z_mps2, value: {max: 0}}]");
    const page = await openPage(browser, run.url);
    const states = (wanted) => until(page, `expectations that are ${wanted}`, (w) => [...document.querySelectorAll("#expect li")].map((li) => li.dataset.state).join(" ") === w, wanted);
    const text = (i) => page.evaluate((k) => [...document.querySelectorAll("#expect li")[k].children].map((part) => part.textContent), i);
    await states("violated undecided holds holds holds");
    assert.deepEqual(await text(1), ["drive safe_after_ms of at most 300 after a fault of imu", "not decided yet", "no such fault so far"]);
    assert.equal((await text(2))[1], "holds so far");
    const [what, state] = await text(0);
    assert.equal(what, "imu.force_z_mps2 value of at most 0");
    assert.match(state, /^violated at 0\.\d{3} s$/);
    assert.equal(await page.innerText("#expect .expect-counts"), "1 violated · 3 of 5 hold · 1 open");
    await until(page, "the verdict to say so", () => /imu\.force_z_mps2: expected value/.test(document.getElementById("verdict").innerText));
    await command(page, { command: "fault", channel: "imu", fault: { kind: "drop" } });
    await states("violated violated holds holds holds");
    assert.match((await text(0))[1], /^violated at \d+\.\d{3} s$/);
    await page.setViewportSize({ width: 360, height: 700 });
    const [inner, outer] = await page.evaluate(() => [document.documentElement.scrollWidth, window.innerWidth]);
    assert.ok(inner <= outer, `the page is ${inner} px wide in a window of ${outer} px`);
    run.process.kill("SIGINT");
    await until(page, "words of a run that has ended", () => document.querySelector("#expect li:last-child .expect-state").textContent === "holds");
    assert.deepEqual(page.trouble, []);
    await run.over;

    const without = await startRun();
    const other = await openPage(browser, without.url);
    await pictures(other, "camera", 1);
    assert.ok(!(await other.locator("#expect").isVisible()), "a panel of nothing");
  },

  /// The frames in 3D: the tree of the rig, and its clouds at the places that it says.
  async ShowsFramesAndCloudsInTheirPlaces(browser) {
    const run = await startRun();
    const page = await openPage(browser, run.url);
    await until(page, "a panel of frames", () => document.querySelector("#frames:not([hidden])"));
    assert.equal(await page.evaluate(() => document.querySelector("canvas.frames").dataset.frames), undefined, "it is closed, and asks for nothing");
    await page.click("#frames summary");
    await page.locator("canvas.frames").scrollIntoViewIfNeeded();
    await until(page, "frames and two clouds", () => {
      const { frames, clouds } = document.querySelector("canvas.frames").dataset;
      return Number(clouds) === 2 && ["world", "robot", "imu", "camera", "camera_optical", "scanner", "odom"].every((f) => f in JSON.parse(frames));
    });
    const at = await page.evaluate(() => JSON.parse(document.querySelector("canvas.frames").dataset.frames));
    // Column by column: the scanner stands at (0, -3, 0.4) and looks along y.
    [[0, 0], [1, 1], [12, 0], [13, -3], [14, 0.4]].forEach(([i, v]) => assert.ok(Math.abs(at.scanner[i] - v) < 1e-6, `element ${i} of the scanner: ${at.scanner[i]}`));
    // The camera's body and its optical frame look the same way: x of the one, z of the other.
    [0, 1, 2].forEach((i) => assert.ok(Math.abs(at.camera[i] - at.camera_optical[8 + i]) < 1e-6));
    assert.ok(Math.abs(at.imu[14] - at.robot[14] - 0.4) < 1e-6);
    const drawn = await page.evaluate(() => {
      const canvas = document.querySelector("canvas.frames"), data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      let n = 0;
      for (let i = 3; i < data.length; i += 4) if (data[i] > 0) n++;
      return n;
    });
    assert.ok(drawn > 1000, `${drawn} pixels`);
    assert.deepEqual(page.trouble, []);
  },

  /// The end of a run is told, and what it showed last stays. A run of nothing but a sink shows that, too.
  async SaysThatTheRunHasEnded(browser) {
    const run = await startWallClockRun();
    const page = await openPage(browser, run.url);
    await pictures(page, "camera", 2);
    run.process.kill("SIGINT");
    await until(page, "the page to say that the run has ended", () => /the run has ended/i.test(document.getElementById("banner").innerText));
    assert.ok((await pixels(page, "camera")).count >= 2);
    await run.over;
  },
};

async function runCase(browser, name) {
  folder = mkdtempSync(join(tmpdir(), "rigor-live-page-"));
  const context = await browser.newContext();
  try {
    await CASES[name](context);
    return true;
  } catch (error) {
    console.error(`${name}: ${error.stack ?? error}`);
    for (const run of runs) console.error(run.said().slice(-3000));
    return false;
  } finally {
    await context.close();
    for (const run of runs.splice(0)) {
      if (run.process.exitCode === null) run.process.kill("SIGINT");
      await run.over;
    }
    rmSync(folder, { recursive: true, force: true });
  }
}

let failed = 0;
const browser = await chromium.launch({ executablePath: CHROMIUM, args: CHROMIUM_ARGS });
for (const name of process.argv.slice(4)) {
  const passed = await runCase(browser, name);
  failed += !passed;
  console.log(`${passed ? "passed" : "failed"} ${name}`);
}
await browser.close();
process.exit(failed ? 1 : 0);
