// What happened: events of the run, what the server says, what was asked for from here. The newest is on top.
import { element } from "./dom.js";

const MOST = 300;

export class EventLog {
  constructor(session, node) {
    this.list = element("ol.events", { role: "log", "aria-label": "Events of this run" });
    node.append(this.list);
    session.addEventListener("note", ({ detail }) => this.add(detail));
  }
  add({ kind, text, channel, t }) {
    const line = element("li", {}, element("time", {}, t > -1e6 ? t.toFixed(2) : "–"), element("b", {}, kind.replaceAll("_", " ")), element("span", {}, channel && !text.includes(channel) ? `${channel}: ${text}` : text));
    line.dataset.kind = kind;
    this.list.prepend(line);
    while (this.list.childElementCount > MOST) this.list.lastChild.remove();
  }
}
