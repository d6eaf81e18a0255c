// What the page knows of the run: its state as /rigor/live tells it, the services, and which node is selected.
//
// Events: "state" (connection), "live" (a new /rigor/live), "select" (another node), "note" {kind, text, channel}: what the
// log shows.
import { FoxgloveClient } from "./foxglove.js";

const HISTORY = "rigor/history";
const token = new URLSearchParams(location.search).get("token") ?? new URLSearchParams(location.hash.slice(1)).get("token");

export class Session extends EventTarget {
  live = null;
  ended = false;
  gone = false; // lost, and nobody answers
  selected = 0;

  constructor() {
    super();
    const url = new URL("/", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    if (token) url.searchParams.set("token", token);
    this.client = new FoxgloveClient(url.href);
    this.client.addEventListener("state", ({ detail }) => this.#connection(detail));
    this.client.addEventListener("status", ({ detail }) => this.note("server", detail.message));
    this.client.subscribe("/rigor/live", (m) => {
      const run = this.live?.run;
      this.live = m.read(m.bytes);
      this.ended = this.live.ended === true;
      // A bench that was started again on this port is another run.
      if (run && (run.pid !== this.live.run.pid || run.rig !== this.live.run.rig)) location.reload();
      this.dispatchEvent(new Event("live"));
    });
    this.follow("/rigor/events", (m) => {
      const event = m.read(m.bytes);
      this.note(event.kind, event.text, event.channel, this.seconds(event.header.stamp));
    });
  }

  /// Calls handler(message) for what the server has kept of the topic since the run began, then for each new message. What
  /// a lost connection missed comes when it is back. Returns what ends it.
  follow(topic, handler) {
    let newest = -1n, waiting = null;
    const take = (m) => {
      if (m.time > newest) newest = m.time;
      handler(m);
    };
    const fill = async () => {
      if (waiting || !this.client.topics.has(topic)) return;
      waiting = [];
      const past = await this.#past(topic), held = waiting;
      waiting = null;
      for (const m of past) if (m.time > newest) take(m);
      const last = newest; // what was kept and what came meanwhile overlap
      for (const m of held) if (m.time > last) take(m);
    };
    const end = this.client.subscribe(topic, (m) => (waiting ? waiting.push(m) : take(m)));
    this.client.addEventListener("services", fill);
    if (this.client.services.has(HISTORY)) fill();
    return () => {
      this.client.removeEventListener("services", fill);
      end();
    };
  }

  async #past(topic) {
    const { read } = this.client.topics.get(topic);
    try {
      const { messages } = await this.call(HISTORY, { topic });
      if (!this.live) await new Promise((done) => this.addEventListener("live", done, { once: true }));
      return messages.map(({ utc_ns, data }) => ({ bytes: Uint8Array.from(atob(data), (c) => c.charCodeAt(0)), time: BigInt(utc_ns), read }));
    } catch {
      return []; // what comes from now on is shown all the same
    }
  }

  async #connection({ state, reason }) {
    if (state === "lost" && /ended/.test(reason)) this.ended = true;
    // A browser that is slow may miss the goodbye: then nobody answers on the port any more.
    if (state === "lost" && !this.ended) {
      const silent = () => fetch("/token").then(() => false, () => true);
      if (await silent()) this.gone = this.client.state !== "open";
    } else if (state === "open") {
      this.gone = false;
    }
    // A browser does not say why an upgrade was refused: the server does, to who asks.
    if (state === "refused") {
      const answer = await fetch(`/token?${new URLSearchParams(token ? { token } : {})}`).catch(() => null);
      this.tokenRefused = answer?.status === 401;
    } else if (state === "open") {
      this.tokenRefused = false;
    }
    this.dispatchEvent(new Event("state"));
  }

  /// Seconds since the first cycle of an instant in UTC, {sec, nanosec} or nanoseconds.
  seconds(time) {
    const ns = typeof time === "bigint" ? time : BigInt(time.sec) * 1_000_000_000n + BigInt(time.nanosec);
    if (!this.live) return 0;
    return Number(ns - BigInt(this.live.utc_ns)) / 1e9 + this.live.t_s;
  }

  note(kind, text, channel = "", t = this.live?.t_s ?? 0) {
    this.dispatchEvent(new CustomEvent("note", { detail: { kind, text, channel, t } }));
  }

  async call(service, request) {
    const answer = await this.client.call(service, request);
    if (!answer.ok) throw new Error(answer.error?.message ?? `${service} failed`);
    return answer.result;
  }
  control(command) {
    return this.call("rigor/control", command);
  }

  select(id) {
    this.selected = id;
    this.dispatchEvent(new Event("select"));
  }

  channel(name) {
    return this.live?.channels.find((c) => c.name === name);
  }
}
