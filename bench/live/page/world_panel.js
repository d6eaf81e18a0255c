// The world in its panel: the map, what is under the pointer, a search by name, the node that is selected.
import { element, figure, setText } from "./dom.js";
import { NodePanel } from "./node_panel.js";
import { WorldMap } from "./world_map.js";

const MOST_NAMES = 1500, RETRY_MS = 3000;

export class WorldPanel {
  #revision = null;
  #loading = false;

  constructor(session, panel) {
    this.session = session;
    this.panel = panel;
    const body = panel.querySelector(".panel-body");
    const canvas = element("canvas.map", { tabIndex: 0, role: "application", "aria-label": "The world from above. Arrows move it, plus and minus zoom, 0 shows all; find nodes by name below." });
    this.place = element("span.under-pointer");
    this.map = new WorldMap(canvas, (id, x, y) => this.#picked(id, x, y));
    this.map.hovered = (x, y, name) => setText(this.place, `${x.toFixed(2)}, ${y.toFixed(2)} m${name ? `  ${name}` : ""}`);
    const button = (label, text, f) => element("button.icon", { type: "button", title: label, "aria-label": label, onclick: f }, text);
    const tools = element("div.map-tools", {}, button("Nearer", "+", () => this.map.zoom(1.5)), button("Farther", "−", () => this.map.zoom(1 / 1.5)), button("Show all", "⌂", () => this.map.frame()), (this.enlarge = button("Enlarge the map", "⤢", () => this.#enlarge())));
    this.enlarge.setAttribute("aria-pressed", "false");
    panel.addEventListener("keydown", (e) => e.key === "Escape" && panel.classList.contains("enlarged") && this.#enlarge());
    this.names = element("datalist", { id: "node-names" });
    this.search = element("input", { type: "search", list: "node-names", placeholder: "Find a node by name or number", "aria-label": "Find a node by name or number" });
    this.search.addEventListener("change", () => this.#find());
    this.key = element("p.map-key", {}, element("span.truth", {}, "true"), element("span.estimate", { hidden: true }, "estimated"), element("span.sensors", {}, "sensors"));
    this.told = element("p.error", { role: "alert" });
    body.append(element("div.map-frame", {}, canvas, this.place, tools), this.key, this.told, this.search, this.names);
    this.nodePanel = new NodePanel(session, body);
    this.nodePanel.changed = () => this.#load();
    new ResizeObserver(() => this.map.resized()).observe(canvas);

    session.client.subscribe("/rigor/world", (m) => {
      const world = m.read(m.bytes);
      this.map.setMoving(world);
      if (world.revision !== this.#revision) this.#load(world.revision);
    });
    session.client.subscribe("/rigor/commands", (m) => this.#command(m.read(m.bytes)));
    session.client.addEventListener("services", () => {
      const offered = session.client.services.has("rigor/world/map");
      panel.hidden = this.search.hidden = this.key.children[0].hidden = this.key.children[2].hidden = !offered;
      if (offered) this.#load();
    });
    session.addEventListener("select", () => this.map.select(session.selected));
  }

  /// Over the whole page, and back.
  #enlarge() {
    const large = this.panel.classList.toggle("enlarged");
    this.enlarge.setAttribute("aria-pressed", String(large));
    document.body.classList.toggle("covered", large);
  }

  async #load(revision = this.#revision) {
    if (this.#loading || this.session.client.state !== "open") return;
    this.#loading = true;
    try {
      const map = await this.session.call("rigor/world/map", {});
      this.#revision = revision;
      this.map.setMap(map);
      setText(this.told, map.left_out > 0 ? `${figure(map.left_out)} more objects are not drawn` : "");
      this.#listNames(map.objects);
    } catch (error) {
      this.#revision = revision;
      setText(this.told, error.message);
      // Asked again when something changes; the first map, which a machine with much to do answers late, until it is there.
      if (!this.map.map) setTimeout(() => this.#load(), RETRY_MS);
    }
    this.#loading = false;
  }

  #listNames(objects) {
    const named = objects.filter((o) => o.name).slice(0, MOST_NAMES);
    this.names.replaceChildren(...named.map((o) => element("option", { value: o.name }, `${o.type} ${o.id}`)));
  }

  #find() {
    const wanted = this.search.value.trim();
    if (!wanted) return;
    const objects = [...(this.map.map?.objects ?? []), ...this.map.bodies];
    const found = objects.find((o) => o.name === wanted) ?? objects.find((o) => o.name?.toLowerCase().includes(wanted.toLowerCase()));
    const id = /^\d+$/.test(wanted) ? Number(wanted) : found?.id;
    if (id) this.session.select(id);
    setText(this.told, id ? "" : `no node here is called "${wanted}"`);
  }

  async #picked(id, x, y) {
    if (id) return this.session.select(id);
    if (!this.map.map) return;
    try {
      const found = await this.session.call("rigor/world/pick", { x_m: x, y_m: y });
      if (found.id) this.session.select(found.id);
    } catch (error) {
      setText(this.told, error.message);
    }
  }

  /// An application that says where it takes itself to be does so as commands with these names.
  #command(command) {
    const value = (name) => command.values[command.names.indexOf(name)];
    if (!["x", "y", "yaw"].every((n) => command.names.includes(n))) return;
    this.key.children[1].hidden = this.panel.hidden = false;
    this.map.setEstimate({ x_m: value("x"), y_m: value("y"), yaw_rad: value("yaw"), sigma_x_m: value("sigma_x"), sigma_y_m: value("sigma_y") });
  }

  draw() {
    this.map.draw();
  }
}
