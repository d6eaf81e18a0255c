// Numbers over time, on a canvas: each series a line over the range of the timeline, the values at the cursor as text.
import { element, figure, fitCanvas, setText } from "./dom.js";
import { seriesColors, themeColor } from "./color.js";
import { History } from "./history.js";
import { timeline } from "./timeline.js";

const LEFT = 50, RIGHT = 4; // of the canvas, in CSS pixels
const BACK_S = 1; // sides of a pair may come in any order; more is another run

/// 1, 2 or 5 times a power of ten: at most `count` steps between the limits, or as many as give two ticks.
function niceStep(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const steps = [10, 5, 2, 1, 0.5, 0.2, 0.1].map((k) => k * power);
  const ticks = (step) => Math.floor(high / step) - Math.ceil(low / step) + 1;
  return steps.findLast((step) => step >= rough && ticks(step) >= 2) ?? steps.find((step) => ticks(step) >= 2) ?? rough;
}

export class TimePlot {
  #series = new Map();
  #hidden = new Set();
  #drawn = -1;

  #limits;

  /// `unit` stands at the axis. `limits`: [{at, kind}], kind "warn" or "bad": what lies above is on ground of that colour.
  constructor({ title, unit = "", limits = [] }) {
    this.#limits = limits;
    this.unitNode = element("span.unit", {}, unit ? ` ${unit}` : "");
    this.canvas = element("canvas.plot", { role: "img", "aria-label": `${title} over time` });
    this.legend = element("div.legend");
    this.node = element("figure.time-plot", {}, element("figcaption", {}, element("span.plot-title", {}, title, this.unitNode), this.legend), element("div.plot-frame", {}, this.canvas));
    this.canvas.addEventListener("pointermove", (e) => timeline.point(this.#timeAt(e.offsetX)));
    this.canvas.addEventListener("pointerleave", () => timeline.point(null));
  }

  setUnit(unit) {
    setText(this.unitNode, unit ? ` ${unit}` : "");
  }

  #timeAt(x) {
    return timeline.from + (timeline.until - timeline.from) * Math.max(0, Math.min(1, (x - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT)));
  }

  /// `dashed`: a limit that changes, rather than a value.
  add(name, t, value, { dashed = false } = {}) {
    if (!this.#series.has(name)) {
      this.#series.set(name, { history: new History(), dashed });
      this.#legendFor(name);
    }
    const s = this.#series.get(name);
    if (t < s.history.lastTime - BACK_S) {
      timeline.forget();
      for (const other of this.#series.values()) other.history = new History();
    }
    if (t >= s.history.lastTime) s.history.add(t, value);
    timeline.advance(t);
    this.#drawn = -1;
  }

  #legendFor(name) {
    const value = element("span.value", {}, "–");
    const button = element("button.series", { type: "button", "aria-pressed": "true", title: `Show or hide ${name}` }, element("i"), name, " ", value);
    button.onclick = () => {
      const shown = this.#hidden.delete(name);
      if (!shown) this.#hidden.add(name);
      button.setAttribute("aria-pressed", String(shown));
      this.#drawn = -1;
      this.draw();
    };
    button.style.setProperty("--index", this.#series.size - 1);
    this.#series.get(name).value = value;
    this.#series.get(name).key = button;
    this.legend.append(button);
  }

  /// Where something changed since: values, the timeline, its size.
  draw() {
    if (!fitCanvas(this.canvas) && this.#drawn === timeline.revision) return;
    this.#drawn = timeline.revision;
    const { width, height } = this.canvas, ratio = window.devicePixelRatio || 1, c = this.canvas.getContext("2d");
    const colors = seriesColors(), faint = themeColor("--rule"), quiet = themeColor("--quiet");
    c.clearRect(0, 0, width, height);
    const left = LEFT * ratio, right = width - RIGHT * ratio, top = 5 * ratio, bottom = height - 15 * ratio;
    const { from, until } = timeline, span = until - from;
    const x = (t) => left + ((t - from) / span) * (right - left);

    const range = (wanted) => {
      let low = Infinity, high = -Infinity;
      for (const [name, s] of this.#series) {
        if (this.#hidden.has(name) || s.dashed !== wanted) continue;
        s.history.each(from, until, (t, least, greatest) => {
          if (!(t >= from && t <= until) || !Number.isFinite(least + greatest)) return;
          low = Math.min(low, least);
          high = Math.max(high, greatest);
        });
      }
      return [low, high];
    };
    let [low, high] = range(false);
    const [lowLimit, highLimit] = range(true);
    if (low > high) [low, high] = [lowLimit, highLimit];
    else { // a limit far beyond the values does not make them a flat line
      const room = 2 * Math.max(high - low, Math.abs(low), Math.abs(high));
      low = Math.min(low, Math.max(lowLimit, low - room));
      high = Math.max(high, Math.min(highLimit, high + room));
    }
    c.font = `${10.5 * ratio}px ${getComputedStyle(document.body).fontFamily}`;
    if (low > high) {
      c.fillStyle = quiet;
      c.fillText("no values in this time", left, (top + bottom) / 2);
      return;
    }
    const least = Math.max(1e-9, 1e-6 * Math.max(Math.abs(low), Math.abs(high)));
    if (high - low < least) { // flat: so many percent around it, and around 0 as far as 1
      const half = Math.max(0.05 * Math.abs(low), low === 0 ? 1 : 1e-9);
      [low, high] = [low - half, high + half];
    }
    // A limit is shown as soon as the values come near it.
    for (const { at } of this.#limits) if (high > 0.4 * at) high = Math.max(high, 1.1 * at);
    const margin = 0.06 * (high - low);
    [low, high] = [low - margin, high + margin];
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);

    c.lineWidth = ratio;
    c.strokeStyle = faint;
    c.fillStyle = quiet;
    c.textAlign = "right";
    c.textBaseline = "middle";
    const step = niceStep(low, high, Math.max(2, (bottom - top) / (26 * ratio)));
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
      c.beginPath();
      c.moveTo(left, y(v));
      c.lineTo(right, y(v));
      c.stroke();
      const label = Math.abs(v) < step / 1e3 ? "0" : digits > 4 || Math.abs(v) >= 1e6 ? v.toExponential(1) : v.toFixed(digits);
      c.fillText(label.replaceAll("-", "−"), left - 5 * ratio, y(v));
    }
    c.textBaseline = "alphabetic";
    const tick = niceStep(Math.max(0, from), until, Math.max(2, (right - left) / (64 * ratio)));
    for (let t = Math.ceil(Math.max(0, from) / tick) * tick; t <= until; t += tick) {
      c.beginPath();
      c.moveTo(x(t), bottom);
      c.lineTo(x(t), bottom + 3 * ratio);
      c.stroke();
      c.textAlign = x(t) > right - 14 * ratio ? "right" : "center";
      if (x(t) > left + 8 * ratio) c.fillText(`${Math.round(t * 10) / 10} s`, x(t), height - 3 * ratio);
    }

    c.save();
    c.beginPath();
    c.rect(left, 0, right - left, height);
    c.clip();
    for (const { at, kind } of this.#limits) {
      if (at > high) continue;
      c.fillStyle = c.strokeStyle = themeColor(`--${kind}`);
      c.globalAlpha = 0.12;
      c.fillRect(left, 0, right - left, Math.max(0, y(at)));
      c.globalAlpha = 1;
      c.setLineDash([5 * ratio, 3 * ratio]);
      c.beginPath();
      c.moveTo(left, y(at));
      c.lineTo(right, y(at));
      c.stroke();
      c.setLineDash([]);
    }
    let index = 0;
    for (const [name, s] of this.#series) {
      const color = colors[index++ % colors.length];
      s.key.style.setProperty("--color", color);
      if (this.#hidden.has(name)) continue;
      c.strokeStyle = color;
      c.lineWidth = 1.4 * ratio;
      c.setLineDash(s.dashed ? [4 * ratio, 3 * ratio] : []);
      c.beginPath();
      let pen = false, last = 0;
      s.history.each(from, until, (t, least, greatest) => {
        if (!Number.isFinite(least + greatest)) return (pen = false);
        const [near, far] = Math.abs(greatest - last) < Math.abs(least - last) ? [greatest, least] : [least, greatest];
        if (pen) c.lineTo(x(t), y(near));
        else c.moveTo(x(t), y(near)), (pen = true);
        if (far !== near) c.lineTo(x(t), y(far)); // as far as its values went
        last = far;
      });
      c.stroke();
    }
    c.restore();
    this.canvas.dataset.high = high;

    const { cursor } = timeline, pointed = cursor !== null && cursor >= from && cursor <= until;
    if (pointed) {
      c.strokeStyle = quiet;
      c.lineWidth = ratio;
      c.beginPath();
      c.moveTo(x(cursor), top);
      c.lineTo(x(cursor), bottom);
      c.stroke();
    }
    this.canvas.dataset.from = from;
    this.canvas.dataset.until = until;
    this.canvas.dataset.cursor = pointed ? cursor : "";
    for (const s of this.#series.values()) {
      setText(s.value, figure(s.history.at(pointed ? cursor : until), 3));
    }
  }
}
