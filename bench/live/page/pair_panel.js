// Pairs: how far the device and its simulated side are apart, over time, and what the watch makes of it: learning, watching, an alarm
// with the parameter that explains it, and how far each parameter's sum is on the way to its threshold.
import { element, figure, setText } from "./dom.js";
import { sideSwitch } from "./channels.js";
import { TimePlot } from "./plot.js";

const ASK_EVERY_MS = 3000;

class Pair {
  #rows = new Map();

  constructor(session, name) {
    this.session = session;
    this.name = name;
    this.switch = sideSwitch(session, name);
    this.state = element("span.watch-state");
    this.text = element("p.watch-text");
    this.acknowledge = element("button", { type: "button", hidden: true, title: "The alarm is known: watch on" }, "Acknowledge");
    this.acknowledge.onclick = () => this.#order("acknowledge", "alarm acknowledged");
    this.learn = element("button.small", { type: "button", title: "Take how the pair is now for its normal state" }, "Learn again");
    this.learn.onclick = () => this.#order("learn_again", "learning again");
    this.plot = new TimePlot({ title: "Real − simulated" });
    this.level = new TimePlot({ title: "Towards the alarm", limits: [{ at: 0.5, kind: "warn" }, { at: 1, kind: "bad" }] });
    this.level.node.hidden = true;
    this.figures = element("p.figures-line");
    this.rows = element("tbody");
    this.parameters = element(
      "details.parameters",
      { hidden: true },
      element("summary", {}, "What is watched"),
      element("table.messages", { "aria-label": `What is watched of ${name}` }, element("thead", {}, element("tr", {}, element("th", {}, "change of"), element("th.number", {}, "last window"), element("th", { title: "The sum's share of its alarm threshold" }, "towards the alarm"))), this.rows),
      this.learn,
    );
    this.node = element("section.pair", { "aria-label": `Pair ${name}` }, element("header", {}, element("h3", {}, name), this.state, element("span.gap"), this.switch.node), element("div.watch", { role: "status" }, this.text, this.acknowledge), this.plot.node, this.level.node, this.figures, this.parameters);
  }

  async #order(what, told) {
    try {
      await this.session.control({ command: "pair", channel: this.name, do: what });
      this.session.note("watch", told, this.name);
    } catch (error) {
      setText(this.text, error.message);
    }
  }

  /// Of /rigor/pairs.
  add(t, { bias, sigma, level }) {
    this.plot.add("bias", t, bias ?? NaN);
    this.plot.add("sigma", t, sigma ?? NaN);
    if (level === null) return;
    this.level.node.hidden = false;
    this.level.add("highest sum over its threshold", t, level);
  }
  draw() {
    this.plot.draw();
    if (!this.level.node.hidden) this.level.draw();
  }

  update(pair) {
    this.switch.show(pair.active);
    this.#watch(pair.watch ?? this.told);
    const missing = ["real", "simulated"].filter((s) => pair[s]?.missing > 0).map((s) => `${figure(pair[s].missing)} missing ${s}`);
    const unit = this.unit ? ` ${this.unit}` : "";
    setText(this.figures, [pair.compared > 0 ? `${figure(pair.compared)} compared` : "nothing compared", pair.unlike > 0 ? `${figure(pair.unlike)} not alike` : "", ...(pair.compared > 0 ? [`bias ${figure(pair.bias)}${unit}`, `sigma ${figure(pair.sigma)}${unit}`] : []), pair.switches === 1 ? "1 switch" : `${figure(pair.switches)} switches`, ...missing].filter(Boolean).join(" · "));
  }

  #watch(watch) {
    this.node.dataset.watch = watch?.state ?? "none";
    setText(this.state, watch?.state ?? "not watched");
    setText(this.text, watch?.text ?? "");
    this.acknowledge.hidden = watch?.state !== "alarm";
  }

  /// The bench's full account of the pair, as the command `pair` gives it.
  account(pair) {
    this.unit = pair.unit;
    this.plot.setUnit(pair.unit);
    const { watch } = pair;
    this.parameters.hidden = !watch;
    this.told = watch;
    if (!watch) return;
    this.#watch(watch);
    if (watch.state === "learning") setText(this.state, `learning, ${figure(watch.learned)} of ${figure(watch.baseline_windows)} windows`);
    for (const p of watch.parameters) {
      if (!this.#rows.has(p.name)) {
        const meter = element("meter", { min: 0, max: 1, low: 0.5, high: 0.9, optimum: 0, "aria-label": `${p.name}: share of its threshold` });
        const row = element("tr", {}, element("th", { scope: "row" }, p.name), element("td.number"), element("td", {}, meter));
        this.#rows.set(p.name, { row, meter });
        this.rows.append(row);
      }
      const { row, meter } = this.#rows.get(p.name);
      setText(row.children[1], p.value === null ? "–" : `${figure(p.value)} ± ${figure(p.sigma, 2)}${p.unit && p.unit !== "1" ? ` ${p.unit}` : ""}`);
      meter.value = p.watched ? Math.min(1, Math.abs(p.level ?? 0)) : 0;
      meter.hidden = !p.watched;
      row.title = p.unsettled ? "Its baseline is not settled: values of one window hang together with those of many later ones" : "";
    }
  }
}

export class PairPanel {
  #pairs = new Map();

  constructor(session, panel) {
    this.session = session;
    this.panel = panel;
    session.addEventListener("live", () => this.update());
    session.follow("/rigor/pairs", (m) => {
      const { t_s, pairs } = m.read(m.bytes);
      for (const pair of pairs) this.#pair(pair.channel).add(t_s, pair);
    });
    const ask = async () => {
      if (panel.open && !document.hidden && this.#pairs.size > 0 && session.client.state === "open" && !session.ended)
        try {
          for (const [name, pair] of Object.entries(await session.control({ command: "pair" }))) this.#pairs.get(name)?.account(pair);
        } catch {
          return; // this run has no such command: what /rigor/live says is shown
        }
      setTimeout(ask, ASK_EVERY_MS);
    };
    setTimeout(ask, 700);
  }

  draw() {
    if (this.panel.open) for (const pair of this.#pairs.values()) pair.draw();
  }

  #pair(name) {
    if (!this.#pairs.has(name)) {
      const pair = new Pair(this.session, name);
      this.#pairs.set(name, pair);
      this.panel.querySelector(".panel-body").append(pair.node);
    }
    return this.#pairs.get(name);
  }

  update() {
    const pairs = this.session.live.channels.filter((c) => c.pair);
    this.panel.hidden = pairs.length === 0;
    for (const c of pairs) this.#pair(c.name).update(c.pair);
  }
}
