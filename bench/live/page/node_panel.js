// One node of the world: what it is, its attributes with units, and fields to change them. A value that the world
// refuses is shown with the world's own words, and the old one is kept.
import { element, figure, setText } from "./dom.js";

const DEGREE = Math.PI / 180;

/// Roll, pitch and yaw in degrees, R = Rz(yaw) Ry(pitch) Rx(roll).
export function anglesOf([w, x, y, z]) {
  const sine = Math.max(-1, Math.min(1, 2 * (w * y - z * x)));
  return [Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), Math.asin(sine), Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))].map((a) => a / DEGREE);
}
export function quaternionOf(angles) {
  const [[cr, sr], [cp, sp], [cy, sy]] = angles.map((a) => [Math.cos((a * DEGREE) / 2), Math.sin((a * DEGREE) / 2)]);
  return [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy];
}

const plain = (v) => (v === null || v === undefined ? "" : String(Math.round(v * 1e9) / 1e9));
/// A text that is no number is sent as it is: the world says what it expects.
function numberOf(text) {
  if (text.trim() === "") return null;
  const value = Number(text);
  return Number.isNaN(value) ? text : value;
}

function numberInputs(count, labels) {
  return Array.from({ length: count }, (_, i) => element("input", { type: "text", inputMode: "decimal", autocomplete: "off", spellcheck: false, "aria-label": labels[i] }));
}

/// {nodes, show(value), read()} for a kind of value.
function editorOf(attribute) {
  const { kind, name, unit, choices } = attribute;
  if (kind === "flag") {
    const box = element("input", { type: "checkbox", "aria-label": name });
    return { nodes: [box], show: (v) => (box.checked = v === true), read: () => box.checked };
  }
  if (kind === "text") {
    const input = choices?.length ? element("select", { "aria-label": name }, ...choices.map((c) => element("option", { value: c }, c))) : element("input", { type: "text", "aria-label": name });
    return { nodes: [input], show: (v) => (input.value = v ?? ""), read: () => input.value };
  }
  if (kind === "number" || kind === "integer") {
    const [input] = numberInputs(1, [`${name}${unit ? ` in ${unit}` : ""}`]);
    return { nodes: [input], show: (v) => (input.value = plain(v)), read: () => numberOf(input.value) };
  }
  if (kind === "vector3") {
    const inputs = numberInputs(3, ["x", "y", "z"].map((a) => `${name} ${a}`));
    return { nodes: inputs, show: (v) => inputs.forEach((n, i) => (n.value = plain(v?.[i]))), read: () => inputs.map((n) => numberOf(n.value)) };
  }
  if (kind === "pose") {
    const places = numberInputs(3, ["x in m", "y in m", "z in m"].map((a) => `${name} ${a}`)), angles = numberInputs(3, ["roll in °", "pitch in °", "yaw in °"].map((a) => `${name} ${a}`));
    let shown = null, untouched = "";
    return {
      nodes: [element("span.row", {}, ...places, element("small", {}, "m")), element("span.row", {}, ...angles, element("small", {}, "° rpy"))],
      show: (v) => {
        shown = v;
        places.forEach((n, i) => (n.value = plain(v.position_m[i])));
        const rpy = anglesOf(v.quaternion_wxyz);
        angles.forEach((n, i) => (n.value = plain(Math.round(rpy[i] * 1e4) / 1e4)));
        untouched = angles.map((n) => n.value).join();
      },
      read: () => ({
        position_m: places.map((n) => numberOf(n.value)),
        // Angles that nobody touched go back as they came, to the last bit.
        quaternion_wxyz: angles.map((n) => n.value).join() === untouched ? shown.quaternion_wxyz : quaternionOf(angles.map((n) => Number(n.value))),
      }),
    };
  }
  if (kind === "numbers") {
    const area = element("textarea", { rows: 2, spellcheck: false, "aria-label": `${name}, separated by commas` });
    return { nodes: [area], show: (v) => (area.value = (v ?? []).map(plain).join(", ")), read: () => area.value.split(/[\s,;]+/).filter(Boolean).map(numberOf) };
  }
  return null;
}

export class NodePanel {
  #asked = 0;

  constructor(session, parent) {
    this.session = session;
    this.title = element("h3");
    this.meaning = element("p.says");
    this.close = element("button.icon", { type: "button", "aria-label": "Close the node", title: "Close" }, "×");
    this.close.onclick = () => session.select(0);
    this.body = element("div.attributes");
    this.relations = element("div.relations");
    this.node = element("section.node-panel", { hidden: true, "aria-label": "The selected node", tabIndex: -1 }, element("header", {}, this.title, element("span.gap"), this.close), this.meaning, this.body, this.relations);
    parent.append(this.node);
    session.addEventListener("select", () => this.load());
  }

  async load() {
    const id = this.session.selected, asked = ++this.#asked;
    this.node.hidden = !id;
    if (!id) return;
    try {
      const node = await this.session.call("rigor/world/node", { id });
      if (asked === this.#asked) this.show(node);
    } catch (error) {
      if (asked !== this.#asked) return;
      setText(this.title, `Node ${id}`);
      this.meaning.textContent = error.message;
      this.body.replaceChildren();
      this.relations.replaceChildren();
    }
  }

  show(node) {
    this.node.dataset.node = node.id;
    this.title.replaceChildren(node.name || node.type, " ", element("small", {}, `${node.name ? `${node.type} ` : ""}${node.id}`));
    setText(this.meaning, node.meaning ?? "");
    this.body.replaceChildren(...node.attributes.map((a) => this.#attribute(node, a)));
    this.relations.replaceChildren(
      ...(node.relations ?? []).map((r) => {
        const other = r.to ?? r.from;
        return element("button.small.relation", { type: "button", title: `Select node ${other}`, onclick: () => this.session.select(other) }, element("small", {}, r.to !== undefined ? `${r.edge} → ` : `${r.edge} ← `), r.name || r.type || `node ${other}`);
      }),
    );
  }

  #attribute(node, attribute) {
    const { name, unit, value, writable, meaning } = attribute;
    const told = element("p.error", { role: "alert" });
    const limits = [attribute.min !== null && attribute.min !== undefined ? `at least ${figure(attribute.min)}` : "", attribute.max !== null && attribute.max !== undefined ? `at most ${figure(attribute.max)}` : ""].filter(Boolean).join(", ");
    const label = element("span.attribute-name", { title: [meaning, limits].filter(Boolean).join(" ") }, name);
    const saysUnits = ["pose", "motion"].includes(attribute.kind); // metres and degrees, each beside its numbers
    const unitNode = unit && !saysUnits && !name.endsWith(`_${unit}`) ? element("small", {}, unit) : null;
    const editor = writable ? editorOf(attribute) : null;
    if (!editor) {
      const text = typeof value === "string" ? value : JSON.stringify(value);
      return element("div.attribute.fixed", {}, label, element("span.value", { title: text }, text.length > 60 ? `${text.slice(0, 60)}…` : text, unitNode ? " " : "", unitNode), told);
    }
    editor.show(value);
    let before = JSON.stringify(editor.read());
    const inputs = editor.nodes.flatMap((n) => (n.matches("input, select, textarea") ? [n] : [...n.querySelectorAll("input")]));
    const line = element("div.attribute", {}, label, element("span.inputs", {}, ...editor.nodes, unitNode), told);
    line.dataset.attribute = name;
    const send = async () => {
      const wanted = editor.read();
      if (JSON.stringify(wanted) === before) return;
      line.dataset.state = "asked";
      try {
        const answer = await this.session.call("rigor/world/set", { id: node.id, attribute: name, value: wanted });
        editor.show(answer.value ?? wanted);
        before = JSON.stringify(editor.read());
        setText(told, "");
        line.dataset.state = "done";
        for (const i of inputs) i.removeAttribute("aria-invalid");
        this.session.note("edit", `${node.name || `node ${node.id}`}: ${name} is ${JSON.stringify(answer.value ?? wanted)}`);
        this.changed?.();
      } catch (error) {
        line.dataset.state = "refused";
        setText(told, error.message);
        for (const i of inputs) i.setAttribute("aria-invalid", "true");
      }
    };
    for (const input of inputs) {
      input.addEventListener("change", send);
      input.addEventListener("keydown", (e) => {
        if (e.key !== "Escape") return;
        editor.show(value);
        setText(told, "");
        line.dataset.state = "";
        for (const i of inputs) i.removeAttribute("aria-invalid");
      });
    }
    return line;
  }
}
