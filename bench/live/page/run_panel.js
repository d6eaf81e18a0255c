// How the loop fares: its wake-ups and misses, its sinks, and what the server had to leave out.
import { bytesPerSecond, duration, element, figure, microseconds, setText } from "./dom.js";
import { Histogram } from "./histogram.js";

const row = (name, title) => {
  const value = element("dd");
  return [value, element("div", { title }, element("dt", {}, name), value)];
};

export class RunPanel {
  #last = null;

  constructor(session, node) {
    this.session = session;
    this.histogram = new Histogram("Wake-ups by lateness");
    const rows = {
      wake: row("wake-up p50 / p99 / max", "How long after its instant the loop was woken"),
      cycle: row("cycle p50 / p99 / max", "How long the loop worked in a cycle"),
      cycles: row("cycles", "Cycles that were run"),
      misses: row("misses", "Wake-ups that came too late for their cycle"),
      skipped: row("skipped", "Cycles that were left out because an earlier one took too long"),
      overruns: row("overruns", "Cycles that took longer than a period"),
      server: row("to browsers", "What this page's server sends, and frames that it left out because a browser was slow"),
    };
    this.values = Object.fromEntries(Object.entries(rows).map(([k, [value]]) => [k, value]));
    this.sinks = element("tbody");
    this.sinkTable = element("table.messages", { hidden: true, "aria-label": "Sinks" }, element("thead", {}, element("tr", {}, element("th", {}, "sink"), ...["applied", "late", "failed", "made safe"].map((h) => element("th.number", {}, h)))), this.sinks);
    node.append(this.histogram.node, element("dl.figures", {}, ...Object.values(rows).map(([, line]) => line)), this.sinkTable);
    session.addEventListener("live", () => this.update());
  }

  update() {
    const { live } = this.session, three = (h) => (h ? `${microseconds(h.p50_us)} / ${microseconds(h.p99_us)} / ${microseconds(h.max_us)}` : "–");
    setText(this.values.wake, three(live.wake));
    setText(this.values.cycle, three(live.cycle_time));
    for (const key of ["cycles", "misses", "skipped", "overruns"]) {
      setText(this.values[key], figure(live[key] ?? 0));
      if (key !== "cycles") this.values[key].classList.toggle("bad", live[key] > 0);
    }
    const now = performance.now(), sent = live.server?.bytes_sent ?? 0;
    if (this.#last && now > this.#last.now + 900) {
      this.speed = ((sent - this.#last.sent) * 1000) / (now - this.#last.now);
      this.#last = { now, sent };
    }
    this.#last ??= { now, sent };
    const s = live.server;
    if (s) setText(this.values.server, `${figure(s.clients)} connected, ${bytesPerSecond(Math.max(0, this.speed ?? 0))}, ${figure(s.frames_dropped)} frames left out`);
    if (live.wake?.bins) this.histogram.show(live.wake.bins.map((b) => [b.from_us, b.to_us, b.count]), [{ at: live.wake.p50_us, text: "p50" }, { at: live.wake.p99_us, text: "p99" }]);
    this.sinkTable.hidden = !live.sinks?.length;
    (live.sinks ?? []).forEach((sink, i) => {
      const line = this.sinks.children[i] ?? this.sinks.appendChild(element("tr", {}, element("th", { scope: "row" }), ...Array.from({ length: 4 }, () => element("td.number"))));
      [sink.name, figure(sink.applied), figure(sink.late), figure(sink.failed), figure(sink.made_safe)].forEach((text, k) => setText(line.children[k], text));
    });
  }
}

/// The line at the top of the page.
export class RunHeader {
  constructor(session, node) {
    this.session = session;
    const part = (name, title, more = "") => {
      const value = element("b");
      this[name] = value;
      return element(`span.head-figure${more}`, { title }, element("small", {}, name), value);
    };
    this.rig = element("h1");
    this.clock = element("span.head-detail");
    this.progress = element("progress", { max: 1, value: 0, "aria-label": "Share of the run's duration" });
    this.connection = element("span.connection", { role: "status" });
    node.append(
      element("img", { src: "icon.svg", alt: "", width: 18, height: 18 }),
      this.rig,
      this.clock,
      element("span.gap"),
      part("time", "Bench time since the first cycle"),
      this.progress,
      part("cycles", "Cycles that were run", ".head-optional"),
      part("misses", "Wake-ups that came too late"),
      part("p99", "99 % of wake-ups came within this time"),
      part("drops", "Frames that the server left out because a browser was slow", ".head-optional"),
      this.connection,
    );
    session.addEventListener("live", () => this.update());
    session.addEventListener("state", () => this.connected());
    this.connected();
  }

  connected() {
    const { client, ended, live } = this.session;
    const words = { connecting: "connecting…", open: "connected", lost: ended ? "run has ended" : "connection lost", refused: "not connected" };
    const state = ended ? "ended" : client.state === "connecting" && live ? "lost" : client.state;
    this.connection.dataset.state = state;
    setText(this.connection, ended ? "run has ended" : words[state]);
  }

  update() {
    const { live } = this.session;
    const { run } = live;
    document.title = `${run.rig} · Rigor`;
    setText(this.rig, run.rig);
    setText(this.clock, [run.clock === "virtual" && !run.replay ? "virtual time, dated 2020" : `${run.clock} clock`, `seed ${run.seed}`, run.replay ? "replay" : ""].filter(Boolean).join(" · "));
    const whole = run.duration_s > 0 ? ` / ${duration(run.duration_s)}` : "";
    setText(this.time, duration(live.t_s) + whole);
    this.progress.hidden = !(run.duration_s > 0);
    this.progress.value = run.duration_s > 0 ? Math.min(1, live.t_s / run.duration_s) : 0;
    setText(this.cycles, figure(live.cycles));
    setText(this.misses, figure(live.misses));
    this.misses.classList.toggle("bad", live.misses > 0);
    setText(this.p99, microseconds(live.wake?.p99_us));
    setText(this.drops, figure(live.server?.frames_dropped ?? 0));
    this.connected();
  }
}
