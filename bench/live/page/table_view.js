// What is no picture, cloud or curve: CAN frames by identifier, and of any other message its last values as text.
import { element, figure, setText } from "./dom.js";

const MOST_ROWS = 64;
const hex = (n, digits) => n.toString(16).toUpperCase().padStart(digits, "0");

function text(value, depth = 0) {
  if (typeof value === "bigint" || typeof value === "boolean" || typeof value === "string") return String(value);
  if (typeof value === "number") return figure(value, 5);
  if (ArrayBuffer.isView(value) || Array.isArray(value))
    return value.length > 12 ? `${value.length} values` : Array.from(value, (v) => text(v, depth + 1)).join(" ");
  if (depth > 2) return "…";
  return Object.entries(value).map(([k, v]) => `${k} ${text(v, depth + 1)}`).join(", ");
}

export class TableView {
  large = false;
  #rows = new Map();
  #pending = [];
  #ends = [];

  constructor(session, channel, topics, label) {
    this.session = session;
    this.topics = topics;
    this.empty = element("p.empty", {}, "No messages so far");
    this.body = element("tbody");
    this.table = element("table.messages", { hidden: true, "aria-label": `Last messages of ${label}` }, element("thead", {}, element("tr", {}, element("th", {}, "what"), element("th", {}, "last"), element("th.number", {}, "seen"))), this.body);
    this.node = element("div.view.table-view", {}, this.empty, this.table);
  }
  show() {
    if (this.#ends.length) return;
    for (const [side, topic] of Object.entries(this.topics))
      this.#ends.push(this.session.client.subscribe(topic, (m) => this.#pending.length < 500 && this.#pending.push([side, m])));
  }
  hide() {
    for (const end of this.#ends) end();
    this.#ends = [];
  }
  draw() {
    for (const [side, m] of this.#pending) this.#take(side, m.read(m.bytes));
    this.#pending.length = 0;
  }
  #take(side, message) {
    const { header, ...rest } = message;
    const prefix = side === "main" ? "" : `${side} `;
    if (message.dlc !== undefined || message.is_fd !== undefined) {
      const name = prefix + hex(message.id, message.is_extended ? 8 : 3);
      const data = Array.from(message.data.subarray(0, message.dlc ?? message.data.length), (b) => hex(b, 2)).join(" ");
      this.#row(name, message.is_rtr ? "remote request" : message.is_error ? "error" : data);
    } else {
      for (const [key, value] of Object.entries(rest)) this.#row(prefix + key, text(value));
    }
  }
  #row(name, last) {
    let row = this.#rows.get(name);
    if (!row) {
      if (this.#rows.size >= MOST_ROWS) return;
      row = { seen: 0, node: element("tr", {}, element("th", { scope: "row" }, name), element("td"), element("td.number")) };
      this.#rows.set(name, row);
      const after = [...this.#rows.keys()].sort();
      const next = after[after.indexOf(name) + 1];
      this.body.insertBefore(row.node, next ? this.#rows.get(next).node : null);
      this.empty.hidden = true;
      this.table.hidden = false;
    }
    row.seen++;
    setText(row.node.children[1], last);
    setText(row.node.children[2], figure(row.seen));
  }
  dispose() {
    this.hide();
  }
}
