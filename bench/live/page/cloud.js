// Point clouds and scans with three.js: one renderer draws them all, each into a canvas of its own, so that a browser's
// few WebGL contexts are enough for any number of channels.
import * as THREE from "/three/build/three.module.js";
import { OrbitControls } from "/three/examples/jsm/controls/OrbitControls.js";
import { limitsOf, RAMP, SteadyLimits, themeColor } from "./color.js";
import { fitCanvas } from "./dom.js";

let shared; // undefined: not tried yet; null: this browser cannot
function rendererOf() {
  if (shared !== undefined) return shared;
  try {
    shared = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    shared.setPixelRatio(1);
  } catch {
    shared = null;
  }
  return shared;
}
export const canDrawClouds = () => rendererOf() !== null;

/// Draws a scene into a canvas (2D) with the renderer that all share.
export function drawInto(canvas, scene, camera) {
  const renderer = rendererOf();
  if (!renderer) return;
  fitCanvas(canvas);
  const { width, height } = canvas, c = canvas.getContext("2d");
  camera.aspect = width / height;
  camera.updateProjectionMatrix();
  const size = renderer.getSize(new THREE.Vector2());
  if (size.x !== width || size.y !== height) renderer.setSize(width, height, false);
  renderer.render(scene, camera);
  c.clearRect(0, 0, width, height);
  c.drawImage(renderer.domElement, 0, 0);
}

const FLOATS = { 7: ["getFloat32", 4], 8: ["getFloat64", 8], 2: ["getUint8", 1], 4: ["getUint16", 2] };

/// Positions and remissions of a sensor_msgs/PointCloud2.
export function pointsOf(cloud) {
  const count = cloud.width * cloud.height, view = new DataView(cloud.data.buffer, cloud.data.byteOffset, cloud.data.byteLength);
  if (count * cloud.point_step > cloud.data.byteLength) throw new Error("a point cloud is longer than its data");
  const field = (name) => cloud.fields.find((f) => f.name === name && FLOATS[f.datatype]);
  const positions = new Float32Array(count * 3), remissions = new Float32Array(count);
  const fill = (f, out, offset, stride) => {
    if (!f) return;
    const [get] = FLOATS[f.datatype];
    for (let i = 0; i < count; i++) out[i * stride + offset] = view[get](i * cloud.point_step + f.offset, true);
  };
  ["x", "y", "z"].forEach((name, k) => fill(field(name), positions, k, 3));
  fill(field("intensity"), remissions, 0, 1);
  return { count, positions, remissions };
}

export class CloudView {
  #capacity = 0;
  #limits = { range: new SteadyLimits(), remission: new SteadyLimits() };
  #framed = false;
  #flat = false;
  #points;
  #grid = null;

  /// Draws into `canvas` (2D). `changed` is called when the view was turned.
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.05, 2000);
    this.camera.up.set(0, 0, 1);
    this.geometry = new THREE.BufferGeometry();
    this.material = new THREE.PointsMaterial({ size: 2, sizeAttenuation: false, vertexColors: THREE.VertexColors });
    this.#points = new THREE.Points(this.geometry, this.material);
    this.#points.frustumCulled = false;
    this.axes = new THREE.AxesHelper(0.6);
    this.scene.add(this.#points, this.axes);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", changed);
    // The wheel scrolls the page until this view was clicked.
    this.controls.enableZoom = false;
    canvas.addEventListener("focus", () => (this.controls.enableZoom = true));
    canvas.addEventListener("blur", () => (this.controls.enableZoom = false));
    this.home();
  }

  dispose() {
    this.controls.dispose();
    this.geometry.dispose();
    this.material.dispose();
  }

  /// Back to the first view: a scan of one plane from above, x up; a cloud from behind and above.
  home() {
    this.#framed = false;
    if (this.points) this.#frame();
  }

  #frame() {
    const { positions, count } = this.points;
    const distances = [];
    let flat = true;
    const step = Math.max(1, Math.floor(count / 2000));
    for (let i = 0; i < count; i += step) {
      const [x, y, z] = positions.subarray(i * 3, i * 3 + 3);
      if (!Number.isFinite(x)) continue;
      distances.push(Math.hypot(x, y));
      flat &&= Math.abs(z) < 0.05;
    }
    if (distances.length === 0) return;
    distances.sort((a, b) => a - b);
    const reach = Math.max(1, distances[Math.floor(distances.length * 0.9)]);
    this.#flat = flat;
    this.controls.target.set(flat ? reach * 0.25 : reach * 0.3, 0, 0);
    if (flat) this.camera.position.set(reach * 0.25 - 0.01, 0, reach * 2.3);
    else this.camera.position.set(-reach * 0.75, 0, reach * 0.75);
    this.controls.update();
    this.#rings(reach);
    this.#framed = true;
  }

  #rings(reach) {
    if (this.#grid) this.scene.remove(this.#grid);
    this.#grid = new THREE.Group();
    const step = [1, 2, 5, 10, 20, 50].find((s) => reach / s <= 5) ?? 100;
    this.ringStep = step;
    this.ringMaterial = new THREE.LineBasicMaterial();
    for (let r = step; r <= reach * 1.6; r += step) {
      const corners = [];
      for (let k = 0; k <= 96; k++) corners.push(new THREE.Vector3(r * Math.cos((k * Math.PI) / 48), r * Math.sin((k * Math.PI) / 48), 0));
      this.#grid.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(corners), this.ringMaterial));
    }
    this.scene.add(this.#grid);
  }

  /// Takes points as `pointsOf` gives them. `by`: "range" or "remission". Returns the limits of the colours.
  set(points, by) {
    this.points = points;
    const { count, positions, remissions } = points;
    if (count > this.#capacity) {
      this.#capacity = Math.ceil(count * 1.25);
      this.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(this.#capacity * 3), 3));
      this.geometry.setAttribute("color", new THREE.BufferAttribute(new Uint8Array(this.#capacity * 3), 3, true));
    }
    const value = by === "range" ? new Float32Array(count) : remissions;
    if (by === "range") for (let i = 0; i < count; i++) value[i] = Math.hypot(positions[i * 3], positions[i * 3 + 1], positions[i * 3 + 2]);
    const limits = this.#limits[by].follow(limitsOf(value)) ?? [0, 1];
    if (this.#capacity > 0) {
      const place = this.geometry.attributes.position, color = this.geometry.attributes.color;
      place.array.set(positions);
      const scale = 255 / (limits[1] - limits[0]);
      for (let i = 0; i < count; i++) {
        const step = Math.max(0, Math.min(255, Math.round((value[i] - limits[0]) * scale))) * 3;
        color.array[i * 3] = RAMP[step];
        color.array[i * 3 + 1] = RAMP[step + 1];
        color.array[i * 3 + 2] = RAMP[step + 2];
      }
      place.needsUpdate = color.needsUpdate = true;
    }
    this.geometry.setDrawRange(0, count);
    if (!this.#framed && count > 0) this.#frame();
    return limits;
  }

  draw() {
    this.material.size = (this.#flat ? 3 : 2) * (window.devicePixelRatio || 1);
    if (this.ringMaterial) this.ringMaterial.color.set(themeColor("--rule-3d"));
    drawInto(this.canvas, this.scene, this.camera);
  }
}
