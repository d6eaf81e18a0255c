// The time axis that all plots share: what range they show, whether they follow the run, and the cursor. Its bar at the foot
// of the page pauses, and scrubs over the history while the run goes on.
import { element, setText } from "./dom.js";

const WINDOWS_S = [5, 20, 60, 300];

export class Timeline extends EventTarget {
  first = Infinity; // of the history
  newest = -Infinity;
  windowS = 20; // Infinity: from the start
  paused = false;
  cursor = null; // an instant, under the pointer in any plot
  revision = 0; // changes whenever plots have to be drawn again
  #until = 0; // while paused

  get until() {
    return this.paused ? this.#until : this.newest;
  }
  get from() {
    return Number.isFinite(this.windowS) ? this.until - this.windowS : Math.min(this.first, this.until - 1e-3);
  }

  /// Another value came, of instant t.
  advance(t) {
    this.first = Math.min(this.first, t);
    if (t <= this.newest) return;
    this.newest = t;
    this.revision++;
  }
  /// Another run begins, or time was set back.
  forget() {
    Object.assign(this, { first: Infinity, newest: -Infinity, paused: false, cursor: null });
    this.#changed();
  }
  pause() {
    this.scrub(this.newest);
  }
  follow() {
    this.paused = false;
    this.#changed();
  }
  scrub(until) {
    if (!Number.isFinite(this.newest)) return;
    this.#until = Math.max(this.first, Math.min(this.newest, until));
    this.paused = true;
    this.#changed();
  }
  show(windowS) {
    this.windowS = windowS;
    this.#changed();
  }
  point(t) {
    this.cursor = t;
    this.revision++;
  }
  #changed() {
    this.revision++;
    this.dispatchEvent(new Event("change"));
  }
}
export const timeline = new Timeline();

export class TimelineBar {
  #revision = -1;

  constructor(node) {
    this.node = node;
    this.pause = element("button", { type: "button", "aria-pressed": "false", title: "Hold the plots where they are; the run goes on" }, "Pause");
    this.pause.onclick = () => (timeline.paused ? timeline.follow() : timeline.pause());
    this.slider = element("input", { type: "range", min: 0, max: 1, step: "any", "aria-label": "End of the time that the plots show" });
    this.slider.oninput = () => timeline.scrub(Number(this.slider.value));
    this.said = element("output");
    this.windows = element("select", { "aria-label": "How much time the plots show" }, ...WINDOWS_S.map((s) => element("option", { value: s, selected: s === timeline.windowS }, s < 60 ? `${s} s` : `${s / 60} min`)), element("option", { value: "Infinity" }, "from the start"));
    this.windows.onchange = () => timeline.show(Number(this.windows.value));
    node.append(this.pause, this.slider, this.said, this.windows);
  }

  draw() {
    if (timeline.revision === this.#revision) return;
    this.#revision = timeline.revision;
    const known = Number.isFinite(timeline.newest);
    this.node.hidden = !known;
    if (!known) return;
    this.node.dataset.paused = timeline.paused;
    this.pause.setAttribute("aria-pressed", String(timeline.paused));
    setText(this.pause, timeline.paused ? "Follow" : "Pause");
    this.slider.min = timeline.first;
    this.slider.max = timeline.newest;
    this.slider.value = timeline.until;
    const at = timeline.cursor === null ? "" : `cursor ${timeline.cursor.toFixed(2)} s · `;
    setText(this.said, `${at}${timeline.until.toFixed(1)} of ${timeline.newest.toFixed(1)} s`);
  }
}
