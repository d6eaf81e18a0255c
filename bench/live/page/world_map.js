// The world from above, on a canvas: ground, objects, what moves, where sensors look, where the robot was and where it
// takes itself to be. x is east, right; y is north, up. Dragged, zoomed by the wheel
// (once clicked), by + and −, moved by the arrows.
import { fitCanvas } from "./dom.js";
import { themeColor } from "./color.js";

const TRAIL = 3000;

export class WorldMap {
  map = null;
  bodies = [];
  sensors = [];
  selected = 0;
  #center = [0, 0];
  #scale = 20; // CSS pixels per metre
  #framed = false;
  #trails = new Map(); // by body or estimate: [x, y, …]
  #estimate = null;
  #ground = null;
  #dirty = true;

  /// `picked(id, x, y)`: a click on an object, or with id 0 beside all.
  constructor(canvas, picked) {
    this.canvas = canvas;
    this.picked = picked;
    let drag = null;
    canvas.addEventListener("pointerdown", (e) => {
      drag = { x: e.clientX, y: e.clientY, center: [...this.#center], moved: false };
      canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointermove", (e) => {
      if (!drag) return this.#hover(e);
      const dx = e.clientX - drag.x, dy = e.clientY - drag.y;
      drag.moved ||= Math.hypot(dx, dy) > 4;
      if (drag.moved) this.#look([drag.center[0] - dx / this.#scale, drag.center[1] + dy / this.#scale]);
    });
    canvas.addEventListener("pointerup", (e) => {
      if (drag && !drag.moved) {
        const [x, y] = this.#worldAt(e.offsetX, e.offsetY);
        picked(this.#hit(x, y), x, y);
      }
      drag = null;
    });
    canvas.addEventListener("pointercancel", () => (drag = null));
    // The wheel scrolls the page until the map was clicked.
    const zoom = (e) => {
      if (document.activeElement !== canvas && !e.ctrlKey) return;
      e.preventDefault();
      this.zoom(2 ** (-e.deltaY / 300), this.#worldAt(e.offsetX, e.offsetY));
    };
    canvas.addEventListener("wheel", zoom, { passive: false });
    canvas.addEventListener("keydown", (e) => {
      const step = 60 / this.#scale, [x, y] = this.#center;
      const to = { ArrowLeft: [x - step, y], ArrowRight: [x + step, y], ArrowUp: [x, y + step], ArrowDown: [x, y - step] }[e.key];
      if (to) this.#look(to);
      else if (e.key === "+" || e.key === "=") this.zoom(1.4);
      else if (e.key === "-") this.zoom(1 / 1.4);
      else if (e.key === "0" || e.key === "Home") this.frame();
      else return;
      e.preventDefault();
    });
  }

  setMap(map) {
    this.map = map;
    // What is large lies below what is small.
    this.map.objects.sort((a, b) => this.#area(b) - this.#area(a));
    this.#ground = null;
    if (map.ground?.png) {
      const picture = new Image();
      picture.onload = () => ((this.#ground = picture), (this.#dirty = true));
      picture.src = `data:image/png;base64,${map.ground.png}`;
    }
    if (!this.#framed) this.frame();
    this.#dirty = true;
  }

  setMoving({ bodies, sensors }) {
    this.bodies = bodies ?? [];
    this.sensors = sensors ?? [];
    for (const b of this.bodies) this.#trail(`body ${b.id}`, b.x_m, b.y_m);
    this.#dirty = true;
  }

  /// Where the application takes itself to be; sigmas may be absent.
  setEstimate(estimate) {
    this.#estimate = estimate;
    this.#trail("estimate", estimate.x_m, estimate.y_m);
    if (!this.#framed) this.frame();
    this.#dirty = true;
  }

  select(id) {
    this.selected = id;
    this.#dirty = true;
  }
  resized() {
    this.#dirty = true;
    if (!this.#framed && this.map) this.frame();
  }

  #trail(key, x, y) {
    if (!this.#trails.has(key)) this.#trails.set(key, []);
    const t = this.#trails.get(key);
    if (t.length && Math.hypot(t[t.length - 2] - x, t[t.length - 1] - y) < 0.02) return;
    t.push(x, y);
    if (t.length > TRAIL * 2) t.splice(0, 2 * Math.floor(TRAIL / 10));
  }

  #area(o) {
    if (o.size_m?.[2] === 0) return 1e12; // the ground
    if (o.shape === "line") return 1e6;
    if (o.outline_m) {
      const span = (first) => o.outline_m.reduce(([low, high], v, i) => (i % 2 === first ? [Math.min(low, v), Math.max(high, v)] : [low, high]), [Infinity, -Infinity]);
      const [[x0, x1], [y0, y1]] = [span(0), span(1)];
      return (x1 - x0) * (y1 - y0);
    }
    if (o.size_m) return o.size_m[0] * o.size_m[1];
    return (o.radius_m ?? 0.1) ** 2;
  }

  /// Shows the whole world, or of a wide one what is around the things in it.
  frame() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || !(this.map || this.#estimate)) return;
    let { x_m: x, y_m: y } = this.map?.extent ?? { x_m: [-Infinity, Infinity], y_m: [-Infinity, Infinity] };
    const xs = [], ys = [];
    // A replay has no world: the way alone.
    if (!this.map) for (const [i, v] of this.#trails.get("estimate").entries()) (i % 2 ? ys : xs).push(v);
    for (const o of [...(this.map?.objects ?? []), ...this.bodies, ...this.sensors])
      if (Number.isFinite(o.x_m) && !o.outline_m) {
        xs.push(o.x_m);
        ys.push(o.y_m);
      }
    if (xs.length > 2 || !this.map) {
      const span = (v, [low, high]) => {
        v.sort((a, b) => a - b);
        const [from, to] = [v[Math.floor(0.01 * (v.length - 1))], v[Math.ceil(0.99 * (v.length - 1))]], margin = Math.max(1.5, 0.1 * (to - from));
        return [Math.max(low, from - margin), Math.min(high, to + margin)];
      };
      [x, y] = [span(xs, x), span(ys, y)];
    }
    this.#center = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2];
    this.#scale = Math.max(0.05, Math.min(400, 0.94 * Math.min(width / Math.max(0.5, x[1] - x[0]), height / Math.max(0.5, y[1] - y[0]))));
    this.#framed = Boolean(this.map);
    this.#dirty = true;
  }

  #look(center) {
    this.#framed = true;
    this.#center = center;
    this.#dirty = true;
  }
  zoom(factor, around = this.#center) {
    const scale = Math.max(0.05, Math.min(2000, this.#scale * factor)), k = this.#scale / scale;
    this.#center = [around[0] + (this.#center[0] - around[0]) * k, around[1] + (this.#center[1] - around[1]) * k];
    this.#scale = scale;
    this.#framed = true;
    this.#dirty = true;
  }
  #worldAt(px, py) {
    return [this.#center[0] + (px - this.canvas.clientWidth / 2) / this.#scale, this.#center[1] - (py - this.canvas.clientHeight / 2) / this.#scale];
  }
  /// CSS pixels of a place in the world.
  placeOf(x, y) {
    return [this.canvas.clientWidth / 2 + (x - this.#center[0]) * this.#scale, this.canvas.clientHeight / 2 - (y - this.#center[1]) * this.#scale];
  }

  /// The topmost object at a place; 0: none within 5 px.
  #hit(x, y) {
    const near = 5 / this.#scale;
    for (const b of this.bodies) if (Math.hypot(b.x_m - x, b.y_m - y) < Math.max(near, 0.3)) return b.id;
    for (let i = (this.map?.objects.length ?? 0) - 1; i >= 0; i--) {
      const o = this.map.objects[i], dx = x - o.x_m, dy = y - o.y_m;
      if (o.shape === "box" || o.shape === "cylinder") {
        const c = Math.cos(o.yaw_rad ?? 0), s = Math.sin(o.yaw_rad ?? 0);
        if (Math.abs(c * dx + s * dy) <= o.size_m[0] / 2 + near && Math.abs(-s * dx + c * dy) <= o.size_m[1] / 2 + near) return o.id;
      } else if (o.outline_m) {
        if (o.shape === "line" ? this.#onLine(o, x, y, near) : inside(o.outline_m, x, y)) return o.id;
      } else if (Math.hypot(dx, dy) <= Math.max(near, o.radius_m ?? 0)) {
        return o.id;
      }
    }
    return 0;
  }
  #onLine({ outline_m: p, width_m: width = 0.2 }, x, y, near) {
    for (let i = 0; i + 3 < p.length; i += 2) {
      const dx = p[i + 2] - p[i], dy = p[i + 3] - p[i + 1], t = Math.max(0, Math.min(1, ((x - p[i]) * dx + (y - p[i + 1]) * dy) / (dx * dx + dy * dy || 1)));
      if (Math.hypot(p[i] + t * dx - x, p[i + 1] + t * dy - y) <= width / 2 + near) return true;
    }
    return false;
  }
  #hover(e) {
    const [x, y] = this.#worldAt(e.offsetX, e.offsetY), id = this.#hit(x, y);
    const o = id && (this.map.objects.find((k) => k.id === id) ?? this.bodies.find((k) => k.id === id));
    this.canvas.style.cursor = id ? "pointer" : "grab";
    this.hovered?.(x, y, o ? o.name || o.species || o.type || "" : "");
  }

  draw() {
    if (fitCanvas(this.canvas)) this.#dirty = true;
    if (!this.#dirty) return;
    this.#dirty = false;
    const ratio = window.devicePixelRatio || 1, c = this.canvas.getContext("2d");
    const color = Object.fromEntries(["rule", "quiet", "text", "map-solid", "map-edge", "map-crown", "map-stem", "map-marked", "map-outline", "map-line", "map-body", "map-estimate", "accent", "map-sensor"].map((n) => [n, themeColor(`--${n}`)]));
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    this.#drawGround(c);
    this.#drawGrid(c, color);
    for (const o of this.map?.objects ?? []) this.#drawObject(c, o, color);
    for (const s of this.sensors) this.#drawSensor(c, s, color);
    for (const [key, trail] of this.#trails) this.#drawTrail(c, trail, key === "estimate" ? color["map-estimate"] : color["map-body"]);
    for (const b of this.bodies) this.#drawParts(c, b, color["map-body"]);
    for (const b of this.bodies) this.#drawHeading(c, b, color["map-body"], b.id === this.selected ? color.accent : null);
    if (this.#estimate) this.#drawEstimate(c, this.#estimate, color["map-estimate"]);
    this.#drawScale(c, color);
  }

  #drawGround(c) {
    const g = this.map?.ground;
    if (!g || !this.#ground) return;
    const [x0, y0] = this.placeOf(g.x_m[0], g.y_m[1]), [x1, y1] = this.placeOf(g.x_m[1], g.y_m[0]);
    c.globalAlpha = 0.75;
    c.drawImage(this.#ground, x0, y0, x1 - x0, y1 - y0);
    c.globalAlpha = 1;
  }

  #drawGrid(c, color) {
    const step = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((s) => s * this.#scale >= 48) ?? 5000;
    const [x0, y0] = this.#worldAt(0, this.canvas.clientHeight), [x1, y1] = this.#worldAt(this.canvas.clientWidth, 0);
    this.gridStep = step;
    c.strokeStyle = color.rule;
    c.lineWidth = 1;
    c.globalAlpha = this.#ground ? 0.35 : 0.8;
    c.beginPath();
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) c.moveTo(this.placeOf(x, 0)[0], 0), c.lineTo(this.placeOf(x, 0)[0], this.canvas.clientHeight);
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) c.moveTo(0, this.placeOf(0, y)[1]), c.lineTo(this.canvas.clientWidth, this.placeOf(0, y)[1]);
    c.stroke();
    c.globalAlpha = 1;
  }

  #drawScale(c, color) {
    const length = this.gridStep * this.#scale, h = this.canvas.clientHeight;
    c.strokeStyle = c.fillStyle = color.text;
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(8, h - 12);
    c.lineTo(8, h - 8);
    c.lineTo(8 + length, h - 8);
    c.lineTo(8 + length, h - 12);
    c.stroke();
    c.font = `11px ${getComputedStyle(document.body).fontFamily}`;
    c.fillText(`${this.gridStep} m`, 12, h - 12);
  }

  #drawObject(c, o, color) {
    const [px, py] = this.placeOf(o.x_m, o.y_m), chosen = o.id === this.selected;
    c.lineWidth = chosen ? 2.5 : 1;
    c.beginPath();
    if (o.shape === "box" || o.shape === "cylinder") {
      const [w, h] = [o.size_m[0] * this.#scale, o.size_m[1] * this.#scale], yaw = -(o.yaw_rad ?? 0);
      if (o.shape === "cylinder") c.ellipse(px, py, Math.max(1, w / 2), Math.max(1, h / 2), yaw, 0, 2 * Math.PI);
      else {
        const corner = (u, v) => [px + u * w * 0.5 * Math.cos(yaw) - v * h * 0.5 * Math.sin(yaw), py + u * w * 0.5 * Math.sin(yaw) + v * h * 0.5 * Math.cos(yaw)];
        c.moveTo(...corner(-1, -1));
        for (const [u, v] of [[1, -1], [1, 1], [-1, 1]]) c.lineTo(...corner(u, v));
        c.closePath();
      }
      c.fillStyle = color["map-solid"];
      c.strokeStyle = chosen ? color.accent : color["map-edge"];
      c.fill();
      c.stroke();
    } else if (o.outline_m) {
      for (let i = 0; i + 1 < o.outline_m.length; i += 2) c.lineTo(...this.placeOf(o.outline_m[i], o.outline_m[i + 1]));
      if (o.shape === "line") {
        c.lineWidth = Math.max(chosen ? 2.5 : 1, (o.width_m ?? 0) * this.#scale);
        c.strokeStyle = chosen ? color.accent : color["map-line"];
        c.globalAlpha = 0.6;
      } else {
        c.closePath();
        c.fillStyle = color["map-outline"];
        c.strokeStyle = chosen ? color.accent : color["map-edge"];
        c.globalAlpha = 0.7;
        c.fill();
      }
      c.stroke();
      c.globalAlpha = 1;
    } else if (o.shape === "tree") {
      const crown = (o.crown_radius_m ?? 0) * this.#scale;
      if (crown > 2) {
        c.arc(px, py, crown, 0, 2 * Math.PI);
        c.fillStyle = color["map-crown"];
        c.globalAlpha = 0.16;
        c.fill();
        c.globalAlpha = 1;
        c.beginPath();
      }
      c.arc(px, py, Math.max(1.6, (o.radius_m ?? 0.1) * this.#scale), 0, 2 * Math.PI);
      c.fillStyle = o.marked ? color["map-marked"] : color["map-stem"];
      c.fill();
      if (chosen || o.marked) {
        c.beginPath();
        c.arc(px, py, Math.max(5, (o.radius_m ?? 0.1) * this.#scale + 3), 0, 2 * Math.PI);
        c.strokeStyle = chosen ? color.accent : color["map-marked"];
        c.stroke();
      }
    } else {
      c.arc(px, py, 3, 0, 2 * Math.PI);
      c.fillStyle = chosen ? color.accent : color.quiet;
      c.fill();
    }
  }

  #drawSensor(c, s, color) {
    const [px, py] = this.placeOf(s.x_m, s.y_m), open = s.horizontal_fov_rad;
    c.strokeStyle = c.fillStyle = color["map-sensor"];
    if (open > 0) {
      const reach = 34, yaw = -s.yaw_rad;
      c.beginPath();
      c.moveTo(px, py);
      c.arc(px, py, reach, yaw - open / 2, yaw + open / 2);
      c.closePath();
      c.globalAlpha = 0.16;
      c.fill();
      c.globalAlpha = 0.9;
      c.lineWidth = 1;
      c.stroke();
      c.globalAlpha = 1;
    }
    c.beginPath();
    c.arc(px, py, 2.5, 0, 2 * Math.PI);
    c.fill();
  }

  #drawTrail(c, trail, color) {
    if (trail.length < 4) return;
    c.beginPath();
    for (let i = 0; i < trail.length; i += 2) c.lineTo(...this.placeOf(trail[i], trail[i + 1]));
    c.strokeStyle = color;
    c.globalAlpha = 0.6;
    c.lineWidth = 1.5;
    c.stroke();
    c.globalAlpha = 1;
  }

  /// Hull, wheels, crane: what is drawn last lies above.
  #drawParts(c, { parts_m = [] }, stroke) {
    c.fillStyle = c.strokeStyle = stroke;
    c.lineWidth = 1;
    for (const ring of parts_m) {
      c.beginPath();
      for (let i = 0; i + 1 < ring.length; i += 2) c.lineTo(...this.placeOf(ring[i], ring[i + 1]));
      c.closePath();
      c.globalAlpha = 0.18;
      c.fill();
      c.globalAlpha = 0.8;
      c.stroke();
    }
    c.globalAlpha = 1;
  }

  #drawHeading(c, { x_m, y_m, yaw_rad = 0 }, fill, ring) {
    const [px, py] = this.placeOf(x_m, y_m), size = Math.max(8, 0.45 * this.#scale);
    c.save();
    c.translate(px, py);
    c.rotate(-yaw_rad);
    c.beginPath();
    c.moveTo(size, 0);
    c.lineTo(-size * 0.7, size * 0.6);
    c.lineTo(-size * 0.4, 0);
    c.lineTo(-size * 0.7, -size * 0.6);
    c.closePath();
    c.fillStyle = fill;
    c.fill();
    if (ring) {
      c.strokeStyle = ring;
      c.lineWidth = 2.5;
      c.stroke();
    }
    c.restore();
  }

  #drawEstimate(c, e, color) {
    const [px, py] = this.placeOf(e.x_m, e.y_m);
    c.strokeStyle = color;
    c.lineWidth = 1.5;
    if (e.sigma_x_m > 0) {
      c.beginPath();
      c.ellipse(px, py, Math.max(2, 3 * e.sigma_x_m * this.#scale), Math.max(2, 3 * e.sigma_y_m * this.#scale), 0, 0, 2 * Math.PI);
      c.setLineDash([3, 3]);
      c.stroke();
      c.setLineDash([]);
    }
    c.beginPath();
    c.arc(px, py, 4.5, 0, 2 * Math.PI);
    c.moveTo(px, py);
    c.lineTo(px + 14 * Math.cos(-e.yaw_rad), py + 14 * Math.sin(-e.yaw_rad));
    c.stroke();
  }
}

function inside(p, x, y) {
  let odd = false;
  for (let i = 0, j = p.length - 2; i + 1 < p.length; j = i, i += 2)
    if (p[i + 1] > y !== p[j + 1] > y && x < ((p[j] - p[i]) * (y - p[i + 1])) / (p[j + 1] - p[i + 1]) + p[i]) odd = !odd;
  return odd;
}
