// Faults on demand: a form with the kinds that the chosen channel can have, and the list of injected faults.
import { element, figure, setText } from "./dom.js";
import { FAULT_KINDS, kindsOf } from "./fault_kinds.js";

const BYTE_VALUES = Array.from({ length: 8 }, (_, i) => ({ name: `byte_${i}`, unit: "" }));
const RETRY_MS = 3000;
let ids = 0;

/// A field with its label: {node, key, read()}.
function field(key, input, read, hint = "") {
  input.id = `fault-${++ids}`;
  input.name = key;
  return { key, input, read, node: element("div.field", {}, element("label", { for: input.id }, key), input, hint ? element("small", {}, hint) : null) };
}

export class FaultPanel {
  #places = [];
  #fields = [];
  #lines = new Map();

  constructor(session, node) {
    this.session = session;
    this.place = element("select", { id: "fault-channel" });
    this.kind = element("select", { id: "fault-kind" });
    this.says = element("p.says");
    this.keys = element("div.fields");
    this.inject = element("button.primary", { type: "submit" }, "Inject");
    this.clear = element("button", { type: "button", title: "End every live fault" }, "Clear all");
    this.error = element("p.error", { role: "alert" });
    this.form = element(
      "form.fault-form",
      { "aria-label": "Inject a fault" },
      element("div.fields", {}, element("div.field", {}, element("label", { for: "fault-channel" }, "at"), this.place), element("div.field", {}, element("label", { for: "fault-kind" }, "kind"), this.kind)),
      this.says,
      this.keys,
      element("div.actions", {}, this.inject, this.clear),
      this.error,
    );
    this.list = element("ul.faults", { "aria-label": "Faults of this run" });
    this.none = element("p.empty", {}, "No fault is injected.");
    node.append(this.form, this.none, this.list);
    this.place.onchange = () => this.#placeChanged();
    this.kind.onchange = () => this.#kindChanged();
    this.form.onsubmit = (e) => (e.preventDefault(), this.#submit());
    this.clear.onclick = () => this.#ask({ command: "clear" }, "faults cleared");
    session.client.addEventListener("services", () => this.#load());
    session.addEventListener("live", () => this.#update());
  }

  async #load() {
    const { session } = this;
    try {
      const { faults_at: places } = await this.session.control({ command: "channels" });
      this.#places = places ?? [];
    } catch (error) {
      // A machine that has much to do answers late.
      if (session.client.state === "open") setTimeout(() => this.#load(), RETRY_MS);
      return setText(this.none, error.message);
    }
    const chosen = this.place.value;
    this.place.replaceChildren(...this.#places.map((p) => element("option", { value: p.name }, `${p.name}${p.kind === "sink" ? " (sink)" : ""}`)));
    if (this.#places.some((p) => p.name === chosen)) this.place.value = chosen;
    this.form.hidden = this.#places.length === 0;
    this.none.textContent = this.#places.length ? "No fault is injected." : "This run takes no faults.";
    if (this.#places.length) this.#placeChanged();
  }

  get #at() {
    return this.#places.find((p) => p.name === this.place.value);
  }

  #placeChanged() {
    const chosen = this.kind.value;
    this.kind.replaceChildren(...kindsOf(this.#at).map((k) => element("option", { value: k }, k)));
    if ([...this.kind.options].some((o) => o.value === chosen)) this.kind.value = chosen;
    this.#kindChanged();
  }

  #kindChanged() {
    const spec = FAULT_KINDS[this.kind.value], at = this.#at;
    setText(this.says, spec.says);
    const values = at.kind === "can_frame" ? BYTE_VALUES : at.values;
    this.#fields = [];
    let unitOf = () => "";
    if (spec.at === "values") {
      const select = element("select", {}, ...values.map((v) => element("option", { value: v.name }, v.name)));
      unitOf = () => values.find((v) => v.name === select.value)?.unit ?? "";
      this.#fields.push(field("value", select, () => select.value));
      select.onchange = () => this.#relabel(unitOf());
    }
    for (const key of spec.keys) {
      if (key.source && at.kind === "sink") continue;
      if (key.kinds && !key.kinds.split(" ").includes(at.kind)) continue;
      this.#fields.push({ ...this.#input(key, unitOf()), spec: key });
    }
    const span = element("input", { type: "number", min: 0.001, step: "any", placeholder: "until cleared" });
    this.#fields.push(field("for_s", span, () => (span.value === "" ? undefined : Number(span.value))));
    this.keys.replaceChildren(...this.#fields.map((f) => f.node));
    const words = this.#fields.find((f) => f.spec?.words);
    if (words) words.input.onchange = () => this.#choose(words.input.value);
    if (words) this.#choose(words.input.value);
    setText(this.error, "");
  }

  #input(key, unit) {
    const named = key.key.replace("_UNIT", unit ? `_${unit}` : "");
    if (key.words) {
      const select = element("select", {}, ...key.words.map((w) => element("option", { value: w }, w)));
      return field(named, select, () => select.value);
    }
    if (key.flag) {
      const box = element("input", { type: "checkbox", checked: key.value === true });
      return field(named, box, () => box.checked);
    }
    const value = typeof key.value === "object" ? (key.value[unit] ?? 1) : key.value;
    const input = element("input", { type: "number", step: "any", min: key.least, max: key.most, value, required: true });
    return field(named, input, () => (input.value === "" ? null : Number(input.value)));
  }

  /// Another value has another unit: its keys are named anew.
  #relabel(unit) {
    for (const f of this.#fields) {
      if (!f.spec?.key.includes("UNIT")) continue;
      f.key = f.spec.key.replace("_UNIT", unit ? `_${unit}` : "");
      f.input.name = f.key;
      setText(f.node.firstChild, f.key);
    }
  }
  #choose(word) {
    for (const f of this.#fields) if (f.spec?.when) f.node.hidden = !f.spec.when.split(" ").includes(word);
  }

  async #submit() {
    const fault = { kind: this.kind.value };
    for (const f of this.#fields) {
      if (f.node.hidden) continue;
      const value = f.read();
      if (value !== undefined) fault[f.key] = value;
    }
    await this.#ask({ command: "fault", channel: this.place.value, fault }, `${fault.kind} asked for`, this.place.value);
  }

  async #ask(command, told, channel = "") {
    setText(this.error, "");
    try {
      await this.session.control(command);
      this.session.note("page", told, channel);
    } catch (error) {
      setText(this.error, error.message);
    }
  }

  #update() {
    const faults = (this.session.live.faults ?? []).slice().sort((a, b) => Number(b.on) - Number(a.on) || Number(a.over) - Number(b.over));
    this.none.hidden = faults.length > 0;
    const seen = new Set();
    for (const f of faults) {
      const key = `${f.channel} ${f.index}`;
      seen.add(key);
      if (!this.#lines.has(key)) {
        const end = f.live ? element("button.small", { type: "button", "aria-label": `Clear the live faults of ${f.channel}` }, "clear") : null;
        if (end) end.onclick = () => this.#ask({ command: "clear", channel: f.channel }, "faults cleared", f.channel);
        const line = element("li", {}, element("span.fault-state"), element("b", {}, f.channel), element("code", {}, f.text.replace(/^\{|\}$/g, "").replace(/^kind: /, "")), element("span.counts"), end);
        this.#lines.set(key, line);
      }
      const line = this.#lines.get(key), state = f.on ? "on" : f.over ? "over" : "waiting";
      line.dataset.state = state;
      setText(line.children[0], state);
      setText(line.children[3], ["seen", "dropped", "changed", "delayed"].filter((k) => f[k] > 0).map((k) => `${figure(f[k])} ${k}`).join(" · "));
      if (line.children[4]) line.children[4].hidden = f.over;
      this.list.append(line); // in the order of the list
    }
    for (const [key, line] of this.#lines)
      if (!seen.has(key)) {
        line.remove();
        this.#lines.delete(key);
      }
  }
}
