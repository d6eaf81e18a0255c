// Numbers over time, on a canvas: the last seconds, each series a line, the values under the pointer as text.
import { element, figure, fitCanvas, setText } from "./dom.js";
import { seriesColors, themeColor } from "./color.js";

const KEPT = 4096;

/// The last values of a series in a ring; times in seconds.
class Series {
  t = new Float64Array(KEPT);
  y = new Float64Array(KEPT);
  end = 0; // how many there ever were
  add(t, y) {
    this.t[this.end % KEPT] = t;
    this.y[this.end % KEPT] = y;
    this.end++;
  }
  get begin() {
    return Math.max(0, this.end - KEPT);
  }
  get last() {
    return this.end ? this.y[(this.end - 1) % KEPT] : NaN;
  }
  /// Index of the last value at or before t; -1: none.
  at(t) {
    let low = this.begin - 1, high = this.end - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.t[middle % KEPT] <= t) low = middle;
      else high = middle - 1;
    }
    return low >= this.begin ? low % KEPT : -1;
  }
}

/// 1, 2 or 5 times a power of ten: about `count` steps between the limits.
function niceStep(span, count) {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough));
  return power * ([1, 2, 5].find((k) => k * power >= rough) ?? 10);
}

export class TimePlot {
  #series = new Map();
  #hidden = new Set();
  #pointer = null;
  #latest = -Infinity;

  /// `unit` stands at the axis; `windowS` is how much of time is shown.
  constructor({ title, unit = "", windowS = 20 }) {
    this.unitNode = element("span.unit", {}, unit ? ` ${unit}` : "");
    this.windowS = windowS;
    this.canvas = element("canvas.plot", { role: "img", "aria-label": `${title} over time` });
    this.legend = element("div.legend");
    this.node = element("figure.time-plot", {}, element("figcaption", {}, element("span.plot-title", {}, title, this.unitNode), this.legend), this.canvas);
    this.canvas.addEventListener("pointermove", (e) => ((this.#pointer = e.offsetX), this.draw()));
    this.canvas.addEventListener("pointerleave", () => ((this.#pointer = null), this.draw()));
  }

  setUnit(unit) {
    setText(this.unitNode, unit ? ` ${unit}` : "");
  }

  add(name, t, value) {
    let s = this.#series.get(name);
    if (!s) {
      s = new Series();
      this.#series.set(name, s);
      this.#legendFor(name);
    }
    if (t < this.#latest - this.windowS) this.#forget(); // another run, or time was set back
    this.#latest = Math.max(this.#latest, t);
    if (!(t < s.t[(s.end + KEPT - 1) % KEPT]) || s.end === 0) s.add(t, value);
  }

  #forget() {
    for (const s of this.#series.values()) s.end = 0;
    this.#latest = -Infinity;
  }

  #legendFor(name) {
    const value = element("span.value", {}, "–");
    const button = element("button.series", { type: "button", "aria-pressed": "true", title: `Show or hide ${name}` }, element("i"), name, " ", value);
    button.onclick = () => {
      const shown = this.#hidden.delete(name);
      if (!shown) this.#hidden.add(name);
      button.setAttribute("aria-pressed", String(shown));
      this.draw();
    };
    button.style.setProperty("--index", this.#series.size - 1);
    this.#series.get(name).value = value;
    this.#series.get(name).key = button;
    this.legend.append(button);
  }

  draw() {
    fitCanvas(this.canvas);
    const { width, height } = this.canvas, ratio = window.devicePixelRatio || 1, c = this.canvas.getContext("2d");
    const colors = seriesColors(), faint = themeColor("--rule"), quiet = themeColor("--quiet");
    c.clearRect(0, 0, width, height);
    const left = 50 * ratio, right = width - 4 * ratio, top = 5 * ratio, bottom = height - 15 * ratio;
    const until = this.#latest, from = until - this.windowS;
    const x = (t) => left + ((t - from) / this.windowS) * (right - left);

    let low = Infinity, high = -Infinity;
    for (const [name, s] of this.#series) {
      if (this.#hidden.has(name)) continue;
      for (let i = Math.max(s.begin, 0); i < s.end; i++)
        if (s.t[i % KEPT] >= from && Number.isFinite(s.y[i % KEPT])) {
          low = Math.min(low, s.y[i % KEPT]);
          high = Math.max(high, s.y[i % KEPT]);
        }
    }
    c.font = `${10.5 * ratio}px ${getComputedStyle(document.body).fontFamily}`;
    if (low > high) {
      c.fillStyle = quiet;
      c.fillText("no values yet", left, (top + bottom) / 2);
      return;
    }
    const least = Math.max(1e-9, 1e-6 * Math.max(Math.abs(low), Math.abs(high)));
    if (high - low < least) { // flat: so many percent around it, and around 0 as far as 1
      const half = Math.max(0.05 * Math.abs(low), low === 0 ? 1 : 1e-9);
      [low, high] = [low - half, high + half];
    }
    const margin = 0.06 * (high - low);
    [low, high] = [low - margin, high + margin];
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);

    c.lineWidth = ratio;
    c.strokeStyle = faint;
    c.fillStyle = quiet;
    c.textAlign = "right";
    c.textBaseline = "middle";
    const step = niceStep(high - low, Math.max(2, (bottom - top) / (26 * ratio)));
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
    const tick = niceStep(this.windowS, Math.max(2, (right - left) / (64 * ratio)));
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
    let index = 0;
    for (const [name, s] of this.#series) {
      const color = colors[index++ % colors.length];
      s.key.style.setProperty("--color", color);
      if (this.#hidden.has(name)) continue;
      c.strokeStyle = color;
      c.lineWidth = 1.4 * ratio;
      c.beginPath();
      let pen = false;
      for (let i = Math.max(s.begin, 0); i < s.end; i++) {
        const t = s.t[i % KEPT], value = s.y[i % KEPT];
        if (t < from - 1) continue;
        if (!Number.isFinite(value)) pen = false;
        else if (pen) c.lineTo(x(t), y(value));
        else c.moveTo(x(t), y(value)), (pen = true);
      }
      c.stroke();
    }
    c.restore();

    const pointed = this.#pointer === null ? null : from + ((this.#pointer * ratio - left) / (right - left)) * this.windowS;
    if (pointed !== null && pointed >= from) {
      c.strokeStyle = quiet;
      c.lineWidth = ratio;
      c.beginPath();
      c.moveTo(x(pointed), top);
      c.lineTo(x(pointed), bottom);
      c.stroke();
    }
    for (const s of this.#series.values()) {
      const i = pointed === null ? -1 : s.at(pointed);
      setText(s.value, figure(i >= 0 ? s.y[i] : s.last, 3));
    }
  }
}
