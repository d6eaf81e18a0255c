// The frames of the run in 3D, as `/tf_static` and `/tf` tell them: axes (x red, y green, z blue), a line from each frame to
// its parent, and the clouds of the channels where they were measured. Nothing is subscribed while the panel is closed.
import * as THREE from "/three/build/three.module.js";
import { OrbitControls } from "/three/examples/jsm/controls/OrbitControls.js";
import { canDrawClouds, drawInto, pointsOf } from "./cloud.js";
import { element } from "./dom.js";
import { themeColor } from "./color.js";

const DEEPEST = 64; // of a tree; one that goes round in a circle ends there
const FIELD = "sensor_msgs/msg/PointCloud2";
const COLORS = [0x2a9d8f, 0xe76f51, 0x577590, 0xc9a227, 0x8e5ea2, 0x4f772d];

/// Half of the points are nearer.
function medianRange(positions, count) {
  const ranges = [], step = Math.max(1, Math.floor(count / 500));
  for (let i = 0; i < count; i += step) ranges.push(Math.hypot(positions[3 * i], positions[3 * i + 1]));
  return ranges.filter(Number.isFinite).sort((a, b) => a - b)[ranges.length >> 1] ?? 0;
}

export class FramesView {
  #ends = [];
  #changed = true;
  #turned = false; // by the user: the view then stays
  #framed = null; // the box that the view was made for
  #links = new Map(); // by child: {parent, matrix}
  #clouds = new Map(); // by topic: {frame, points}
  #nodes = new Map(); // by frame: AxesHelper

  constructor(session, panel) {
    this.session = session;
    this.panel = panel;
    this.canvas = element("canvas.frames", { tabIndex: 0, role: "img", "aria-label": "The frames of the run in 3D; the pointer turns them" });
    this.empty = element("p.empty", {}, canDrawClouds() ? "No frames so far" : "This browser has no WebGL: frames are not shown");
    const home = element("button.small", { type: "button", title: "Back to the first view" }, "reset view");
    home.onclick = () => ((this.#turned = false), (this.#framed = null), (this.#changed = true));
    const labels = element("button.small", { type: "button", title: "Show the names of the frames, or not" }, "names");
    labels.setAttribute("aria-pressed", "true");
    labels.onclick = () => (labels.setAttribute("aria-pressed", String(!this.#labelled(labels))), (this.#changed = true));
    this.labels = labels;
    panel.querySelector(".panel-body").append(element("div.frame.frames-frame", {}, this.canvas, this.empty), element("div.view-tools", {}, labels, home));
    panel.addEventListener("toggle", () => this.#listen());
    session.client.addEventListener("topics", () => {
      panel.hidden = !session.client.topics.has("/tf_static") && !session.client.topics.has("/tf");
      this.#listen();
    });
    if (!canDrawClouds()) return;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.02, 5000);
    this.camera.up.set(0, 0, 1);
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
    this.lines.frustumCulled = false;
    this.ground = new THREE.GridHelper(20, 20);
    this.ground.rotation.x = Math.PI / 2; // the helper lies in x and z
    this.scene.add(this.lines, this.ground);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("start", () => (this.#turned = true));
    this.controls.addEventListener("change", () => (this.#changed = true));
    this.controls.enableZoom = false;
    this.canvas.addEventListener("focus", () => (this.controls.enableZoom = true));
    this.canvas.addEventListener("blur", () => (this.controls.enableZoom = false));
    new ResizeObserver(() => (this.#changed = true)).observe(this.canvas);
  }

  #labelled(button) {
    return button.getAttribute("aria-pressed") === "true";
  }

  #listen() {
    for (const end of this.#ends) end();
    this.#ends = [];
    if (!this.panel.open || this.panel.hidden || !this.scene) return;
    const { client } = this.session;
    const take = (m) => {
      for (const { header, child_frame_id, transform } of m.read(m.bytes).transforms) {
        const { translation: t, rotation: q } = transform;
        const matrix = new THREE.Matrix4().compose(new THREE.Vector3(t.x, t.y, t.z), new THREE.Quaternion(q.x, q.y, q.z, q.w), new THREE.Vector3(1, 1, 1));
        this.#links.set(child_frame_id, { parent: header.frame_id, matrix });
      }
      this.#changed = true;
    };
    for (const topic of ["/tf_static", "/tf"]) this.#ends.push(client.subscribe(topic, take));
    for (const [topic, { schemaName }] of client.topics)
      if (schemaName === FIELD && !topic.endsWith("/timing"))
        this.#ends.push(
          client.subscribe(topic, (m) => {
            const cloud = m.read(m.bytes);
            this.#cloud(topic, cloud.header.frame_id, pointsOf(cloud));
          }),
        );
  }

  #cloud(topic, frame, { count, positions }) {
    let entry = this.#clouds.get(topic);
    if (!entry) {
      const material = new THREE.PointsMaterial({ size: 1.5, sizeAttenuation: false, color: COLORS[this.#clouds.size % COLORS.length] });
      const points = new THREE.Points(new THREE.BufferGeometry(), material);
      points.frustumCulled = points.matrixAutoUpdate = false;
      this.scene.add(points);
      this.#clouds.set(topic, (entry = { points }));
    }
    entry.frame = frame;
    entry.reach = medianRange(positions, count);
    entry.points.geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    entry.points.geometry.setDrawRange(0, count);
    this.#changed = true;
  }

  /// T_root_frame; null: its tree has no root within reach.
  #place(frame) {
    const T = new THREE.Matrix4();
    let at = frame;
    for (let deep = 0; deep < DEEPEST; deep++) {
      const link = this.#links.get(at);
      if (!link) return T;
      T.premultiply(link.matrix);
      at = link.parent;
    }
    return null;
  }

  draw() {
    if (!this.scene || !this.panel.open || !this.#changed) return;
    this.#changed = false;
    const places = new Map();
    for (const [child, { parent }] of this.#links)
      for (const frame of [parent, child]) if (!places.has(frame)) places.set(frame, this.#place(frame));
    const position = (frame) => new THREE.Vector3().setFromMatrixPosition(places.get(frame));
    const corners = [];
    for (const [child, { parent }] of this.#links) if (places.get(child) && places.get(parent)) corners.push(position(parent), position(child));
    this.lines.geometry.setFromPoints(corners);
    const box = new THREE.Box3().setFromPoints(corners);
    const reach = corners.length ? Math.max(1, box.getSize(new THREE.Vector3()).length()) : 1;
    for (const [frame, T] of places) {
      if (!T) continue;
      if (!this.#nodes.has(frame)) {
        const axes = new THREE.AxesHelper(1);
        axes.matrixAutoUpdate = false;
        this.scene.add(axes);
        this.#nodes.set(frame, axes);
      }
      this.#nodes.get(frame).matrix.copy(T).scale(new THREE.Vector3(1, 1, 1).multiplyScalar(0.08 * reach));
    }
    for (const [frame, axes] of this.#nodes) axes.visible = places.has(frame) && places.get(frame) !== null;
    for (const { frame, points } of this.#clouds.values()) {
      const T = places.get(frame);
      points.visible = Boolean(T); // a cloud without a place is not drawn at a wrong one
      if (T) points.matrix.copy(T);
    }
    this.empty.hidden = places.size > 0;
    for (const { frame, points, reach } of this.#clouds.values()) if (points.visible && reach > 0) box.union(new THREE.Box3().setFromCenterAndSize(position(frame), new THREE.Vector3(2 * reach, 2 * reach, 0)));
    if (places.size > 0 && !this.#turned) this.#frame(box);
    this.lines.material.color.set(themeColor("--quiet"));
    this.ground.material.vertexColors = false;
    this.ground.material.color.set(themeColor("--rule-3d"));
    drawInto(this.canvas, this.scene, this.camera);
    if (this.#labelled(this.labels)) this.#write(places);
    this.canvas.dataset.frames = JSON.stringify(Object.fromEntries([...places].filter(([, T]) => T).map(([frame, T]) => [frame, T.elements])));
    this.canvas.dataset.clouds = String([...this.#clouds.values()].filter((c) => c.points.visible).length);
  }

  /// A view of all, which goes on when what is to be seen leaves it.
  #frame(box) {
    if (this.#framed?.containsBox(box)) return;
    this.#framed = box.clone().expandByScalar(0.25 * box.getSize(new THREE.Vector3()).length() + 0.5);
    const middle = box.getCenter(new THREE.Vector3()), reach = Math.max(1, box.getSize(new THREE.Vector3()).length());
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).add(new THREE.Vector3(-0.55, -0.55, 0.6).multiplyScalar(reach));
    this.ground.position.set(Math.round(middle.x), Math.round(middle.y), 0);
    this.controls.update();
  }

  #write(places) {
    const c = this.canvas.getContext("2d"), { width, height } = this.canvas, ratio = window.devicePixelRatio || 1;
    c.font = `${11 * ratio}px system-ui, sans-serif`;
    c.fillStyle = themeColor("--text");
    for (const [frame, T] of places) {
      if (!T) continue;
      const p = new THREE.Vector3().setFromMatrixPosition(T).project(this.camera);
      if (p.z < 1) c.fillText(frame, ((p.x + 1) / 2) * width + 4 * ratio, ((1 - p.y) / 2) * height - 4 * ratio);
    }
  }
}
