// Bars over a logarithmic axis: how late the loop was woken.
import { element, figure, fitCanvas, microseconds, setText } from "./dom.js";
import { themeColor } from "./color.js";

export class Histogram {
  #bars = [];
  #bins = []; // [[from_us, to_us, count], …]
  constructor(title) {
    this.canvas = element("canvas.histogram", { role: "img", "aria-label": title });
    this.value = element("span.under-pointer");
    this.node = element("div.frame", {}, this.canvas, this.value);
    this.canvas.addEventListener("pointermove", (e) => this.#point(e.offsetX * (window.devicePixelRatio || 1)));
    this.canvas.addEventListener("pointerleave", () => setText(this.value, ""));
  }

  /// `bins`: [from, to, count] in µs, rising. `marks`: [{at, text}].
  show(bins, marks = []) {
    this.#bins = bins;
    this.marks = marks;
    this.canvas.setAttribute("aria-label", `Wake-ups by lateness: ${marks.map((m) => `${m.text} ${microseconds(m.at)}`).join(", ")}`);
    this.draw();
  }

  /// Says what the bar at this pixel stands for.
  #point(at) {
    const bar = this.#bars?.find(({ from, to }) => at >= from && at <= to);
    setText(this.value, bar ? `${figure(bar.bin[2])} between ${microseconds(bar.bin[0])} and ${microseconds(bar.bin[1])}` : "");
  }

  draw() {
    fitCanvas(this.canvas);
    const { width, height } = this.canvas, ratio = window.devicePixelRatio || 1, c = this.canvas.getContext("2d");
    c.clearRect(0, 0, width, height);
    const bins = this.#bins.filter(([, , n]) => n > 0);
    if (bins.length === 0) return;
    const left = 4 * ratio, right = width - 4 * ratio, top = 14 * ratio, bottom = height - 15 * ratio;
    const lowest = Math.max(0.1, Math.min(...bins.map(([f, t]) => f || t / 2))), highest = Math.max(...bins.map(([, t]) => t), lowest * 10);
    const a = Math.log10(lowest), b = Math.ceil(Math.log10(highest));
    const x = (us) => left + ((Math.log10(Math.max(us, lowest)) - a) / (b - a)) * (right - left);
    // Counts span six decades: the height is the logarithm, so that the single late one is seen.
    const most = Math.log10(Math.max(...bins.map(([, , n]) => n)) + 1);
    const y = (n) => bottom - (Math.log10(n + 1) / most) * (bottom - top);
    c.font = `${10.5 * ratio}px ${getComputedStyle(document.body).fontFamily}`;
    c.strokeStyle = themeColor("--rule");
    c.fillStyle = themeColor("--quiet");
    c.lineWidth = ratio;
    for (let k = Math.ceil(a); k <= b; k++) {
      c.beginPath();
      c.moveTo(x(10 ** k), top);
      c.lineTo(x(10 ** k), bottom);
      c.stroke();
      c.textAlign = x(10 ** k) < left + 16 * ratio ? "left" : k === b ? "right" : "center";
      c.fillText(microseconds(10 ** k).replace("1.0 ", "1 "), x(10 ** k), height - 3 * ratio);
    }
    c.fillStyle = themeColor("--series-1");
    this.#bars = bins.map((bin) => ({ bin, from: x(bin[0]), to: x(bin[1]) }));
    for (const [from, to, n] of bins) c.fillRect(x(from), y(n), Math.max(ratio, x(to) - x(from) - ratio * 0.5), bottom - y(n));
    c.fillStyle = themeColor("--text");
    c.strokeStyle = themeColor("--text");
    for (const { at, text } of this.marks ?? []) {
      if (!(at > 0)) continue;
      c.beginPath();
      c.setLineDash([3 * ratio, 2 * ratio]);
      c.moveTo(x(at), top - 2 * ratio);
      c.lineTo(x(at), bottom);
      c.stroke();
      c.setLineDash([]);
      c.textAlign = x(at) > right - 30 * ratio ? "right" : "left";
      c.fillText(text, x(at) + (c.textAlign === "left" ? 3 : -3) * ratio, top - 4 * ratio);
    }
  }
}
