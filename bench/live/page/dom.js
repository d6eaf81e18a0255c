// Elements without a framework.

/// element("button.small", {type: "button", onclick: f}, "text", child, …): a tag with classes, its properties (those with
/// a dash, and role, as attributes), and what is inside.
export function element(what, properties = {}, ...inside) {
  const [tag, ...classes] = what.split(".");
  const node = document.createElement(tag);
  if (classes.length) node.className = classes.join(" ");
  for (const [key, value] of Object.entries(properties)) {
    if (value === undefined || value === null) continue;
    if (key.includes("-") || key === "role" || key === "for" || key === "list") node.setAttribute(key, value);
    else node[key] = value;
  }
  node.append(...inside.filter((i) => i !== null && i !== undefined));
  return node;
}

/// Sets text only where it changed: layout and screen readers are left alone otherwise.
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/// A number with so many significant digits and a narrow space between thousands.
export function figure(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return value.toString().replace(/\B(?=(\d{3})+$)/g, "\u202f").replace("-", "−");
  const size = Math.abs(value);
  const text = size >= 1e6 || size < 1e-4 ? value.toExponential(Math.max(0, digits - 1)) : value.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(size))));
  return text.replace("-", "−");
}

/// A count of microseconds in the unit that reads best.
export function microseconds(us) {
  if (us === null || us === undefined) return "–";
  if (Math.abs(us) >= 1e6) return `${figure(us / 1e6)} s`;
  return Math.abs(us) >= 1e3 ? `${figure(us / 1e3)} ms` : `${figure(us, us < 10 ? 2 : 3)} µs`;
}

export function duration(seconds) {
  if (!(seconds >= 0)) return "–";
  const s = Math.floor(seconds), pad = (n) => String(n).padStart(2, "0");
  return `${Math.floor(s / 3600)}:${pad(Math.floor(s / 60) % 60)}:${pad(s % 60)}`;
}

export function bytesPerSecond(rate) {
  return rate >= 1e6 ? `${(rate / 1e6).toFixed(1)} MB/s` : `${Math.round(rate / 1e3)} kB/s`;
}

/// Makes a canvas as sharp as its place in the page. True where its size changed.
export function fitCanvas(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width === width && canvas.height === height) return false;
  canvas.width = width;
  canvas.height = height;
  return true;
}
