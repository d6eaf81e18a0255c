// Channels as tiles: what each shows, how it is, and of a pair which side the application gets.
import { element, figure, setText } from "./dom.js";
import { PictureView } from "./picture_view.js";
import { PointsView } from "./cloud_view.js";
import { isPlotted, NumbersView } from "./plot_view.js";
import { TableView } from "./table_view.js";

const KINDS = { image: "camera", range_image: "range", point_cloud: "points", registers: "registers", can_frame: "CAN", pose: "pose", imu: "inertial", nav_fix: "satellites", odometry: "odometry", event: "events" };
const WORDS = { never: "nothing yet", fresh: "fresh", held: "held", overdue: "overdue", disconnected: "disconnected" };

/// real | simulated: for `pair`, the name of a pair's channel.
export function sideSwitch(session, pair, told) {
  const buttons = ["real", "simulated"].map((side) => {
    const button = element("button", { type: "button", role: "radio", "aria-checked": "false" }, side);
    button.dataset.side = side;
    button.onclick = async () => {
      try {
        await session.control({ command: "switch", channel: pair, active: side });
        session.note("switch", `${side} side asked for`, pair);
      } catch (error) {
        told?.(error.message);
        session.note("refused", error.message, pair);
      }
    };
    return button;
  });
  const node = element("div.side-switch", { role: "radiogroup", "aria-label": `Side of ${pair} that the application gets` }, ...buttons);
  node.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1 }[e.key];
    if (!step) return;
    e.preventDefault();
    const to = buttons[(buttons.indexOf(document.activeElement) + step + 2) % 2];
    to.focus();
    to.click();
  });
  return {
    node,
    show(handOn) {
      for (const b of buttons) {
        b.setAttribute("aria-checked", String(b.dataset.side === handOn));
        b.tabIndex = b.dataset.side === handOn ? 0 : -1;
      }
    },
  };
}

class Tile {
  #views = null;
  #visible = false;
  #key = "";

  constructor(session, channel) {
    this.session = session;
    this.name = channel.name;
    this.kind = channel.kind;
    this.status = element("span.status");
    this.rate = element("span.figure", { title: "Samples per second of bench time" });
    this.age = element("span.figure", { title: "From capture until visible to the application: half of the samples are at most this old (p50), 99 of 100 are at most that old (p99)" });
    this.samples = element("span.figure", { title: "Samples that became visible, of those that were due so far" });
    this.counts = element("span.counts", { title: "Samples that are missing, that arrived after their release, that were dropped on the way" });
    this.detail = element("span.detail");
    this.expand = element("button.icon", { type: "button", "aria-pressed": "false", "aria-label": `Show ${channel.name} large`, title: "Large, with the sensor's own pixels" }, "⤢");
    this.expand.onclick = () => this.#enlarge();
    this.body = element("div.tile-body");
    if (channel.pair) this.switch = sideSwitch(session, channel.name);
    this.node = element(
      "article.tile",
      { "aria-label": `Channel ${channel.name}` },
      element("header", {}, element("h3", {}, channel.name), element("span.kind", {}, KINDS[channel.kind] ?? channel.kind), this.status, element("span.gap"), this.switch?.node, this.expand),
      this.body,
      element("footer", {}, this.rate, this.samples, this.age, this.detail, element("span.gap"), this.counts),
    );
    this.node.dataset.channel = channel.name;
    this.node.dataset.kind = channel.kind;
  }

  /// Views need to know the topics' types: they are made once the server has told them.
  #makeViews(channel) {
    const known = Object.entries(channel.topics ?? {}).filter(([, topic]) => this.session.client.topics.has(topic));
    const key = known.map(([side]) => side).join();
    if (!key || key === this.#key) return;
    this.#key = key;
    for (const v of this.#views ?? []) v.dispose();
    this.body.replaceChildren();
    const topics = Object.fromEntries(known), schema = this.session.client.topics.get(known[0][1]).schemaName;
    const perSide = (View) => known.map(([side, topic]) => {
      const view = new View(this.session, channel, topic, side === "main" ? this.name : `${this.name}, ${side}`);
      if (side !== "main") {
        view.caption = element("span.side", {}, side);
        view.node.prepend(view.caption);
        view.side = side;
      }
      return view;
    });
    if (this.kind === "image" || this.kind === "range_image") this.#views = perSide(PictureView);
    else if (this.kind === "point_cloud") this.#views = perSide(PointsView);
    else this.#views = [new (isPlotted(schema) ? NumbersView : TableView)(this.session, channel, topics, this.name)];
    for (const v of this.#views) {
      v.large = this.large;
      this.body.append(v.node);
      if (this.#visible) v.show();
    }
    this.body.classList.toggle("sides", this.#views.length > 1);
  }

  #enlarge() {
    this.large = !this.large;
    this.node.classList.toggle("large", this.large);
    this.expand.setAttribute("aria-pressed", String(this.large));
    for (const v of this.#views ?? []) {
      v.large = this.large;
      if (this.#visible) v.show();
    }
    requestAnimationFrame(() => this.resized());
  }

  visible(yes) {
    this.#visible = yes;
    for (const v of this.#views ?? []) yes ? v.show() : v.hide();
  }

  update(channel) {
    this.#makeViews(channel);
    const ended = this.session.ended;
    this.node.dataset.status = ended ? "ended" : channel.status;
    setText(this.status, ended ? "ended" : !channel.connected && channel.status !== "never" ? `${WORDS[channel.status] ?? channel.status}, not connected` : (WORDS[channel.status] ?? channel.status));
    setText(this.rate, channel.rate_hz === null || channel.rate_hz === undefined ? "– Hz" : `${figure(channel.rate_hz)} Hz`);
    setText(this.age, channel.age_ms ? `age p50 ${figure(channel.age_ms.p50)} ms, p99 ${figure(channel.age_ms.p99)} ms` : "age –");
    const size = channel.width_px ? `${channel.width_px}×${channel.height_px}` : "";
    setText(this.detail, [size, channel.format].filter(Boolean).join(" "));
    const due = Number.isInteger(channel.due);
    setText(this.samples, due ? `${figure(channel.samples)} of ${figure(channel.due)}` : figure(channel.samples ?? 0));
    const counts = ["lost", "late", "dropped"].filter((k) => channel[k] > 0).map((k) => `${figure(channel[k])} ${k}`);
    if (typeof channel.silent_since_s === "number" && !ended) counts.unshift(channel.samples > 0 ? `silent since ${figure(channel.silent_since_s)} s` : "silent");
    setText(this.counts, counts.join(" · "));
    if (channel.pair) {
      this.switch?.show(channel.pair.active);
      for (const v of this.#views ?? []) if (v.side) v.node.classList.toggle("handed-on", v.side === channel.pair.active);
    }
    if (!this.#views) {
      this.body.replaceChildren(element("p.empty", {}, channel.status === "never" ? "Nothing has come so far" : "Its messages are not offered here"));
    }
  }

  draw() {
    if (this.#visible) for (const v of this.#views ?? []) v.draw();
  }
  resized() {
    for (const v of this.#views ?? []) v.resized?.();
  }
  dispose() {
    for (const v of this.#views ?? []) v.dispose();
    this.node.remove();
  }
}

export class Channels {
  #tiles = new Map();
  #watch;
  #sizes;

  constructor(session, node) {
    this.session = session;
    this.node = node;
    this.empty = element("p.empty.none", { hidden: true }, "This rig has no channels.");
    node.append(this.empty);
    const tileOf = (entry) => this.#tiles.get(entry.target.dataset.channel);
    this.#watch = new IntersectionObserver((entries) => entries.forEach((e) => tileOf(e)?.visible(e.isIntersecting && !document.hidden)), { rootMargin: "80px" });
    this.#sizes = new ResizeObserver((entries) => entries.forEach((e) => tileOf(e)?.resized()));
    // A page that nobody sees asks for nothing.
    document.addEventListener("visibilitychange", () => {
      for (const tile of this.#tiles.values()) {
        this.#watch.unobserve(tile.node);
        if (document.hidden) tile.visible(false);
        else this.#watch.observe(tile.node);
      }
    });
    session.addEventListener("live", () => this.update());
    session.client.addEventListener("topics", () => session.live && this.update());
  }

  update() {
    const channels = this.session.live.channels;
    this.empty.hidden = channels.length > 0;
    for (const [name, tile] of this.#tiles)
      if (!channels.some((c) => c.name === name)) {
        tile.dispose();
        this.#tiles.delete(name);
      }
    for (const channel of channels) {
      if (!this.#tiles.has(channel.name)) {
        const tile = new Tile(this.session, channel);
        this.#tiles.set(channel.name, tile);
        this.node.append(tile.node);
        this.#watch.observe(tile.node);
        this.#sizes.observe(tile.node);
      }
      this.#tiles.get(channel.name).update(channel);
    }
  }

  draw() {
    for (const tile of this.#tiles.values()) tile.draw();
  }
  resized() {
    for (const tile of this.#tiles.values()) tile.resized();
  }
}
