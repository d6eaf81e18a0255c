// How far the application's estimate of its pose is from the truth, over time, beside what it claims itself.
import { element, figure, setText } from "./dom.js";
import { TimePlot } from "./plot.js";

export class EstimatePanel {
  constructor(session, panel) {
    this.panel = panel;
    this.place = new TimePlot({ title: "Estimate − truth", unit: "mm" });
    this.turn = new TimePlot({ title: "Yaw, estimate − truth", unit: "°" });
    this.turn.node.hidden = true;
    this.figures = element("p.figures-line", { role: "status" });
    panel.querySelector(".panel-body").append(this.place.node, this.turn.node, this.figures);
    session.follow("/rigor/estimate", (m) => this.#add(m.read(m.bytes)));
  }

  #add({ t_s, distance_m, along_m, across_m, yaw_rad, sigma_m }) {
    this.panel.hidden = false;
    this.place.add("distance", t_s, distance_m * 1e3);
    this.place.add("ahead", t_s, along_m * 1e3);
    this.place.add("left", t_s, across_m * 1e3);
    if (sigma_m !== null) this.place.add("claimed 3 sigma", t_s, 3e3 * sigma_m, { dashed: true });
    if (yaw_rad !== null) {
      this.turn.node.hidden = false;
      this.turn.add("yaw", t_s, (yaw_rad * 180) / Math.PI);
    }
    const beyond = sigma_m > 0 && distance_m > 3 * sigma_m;
    this.figures.classList.toggle("bad", beyond);
    setText(this.figures, `${figure(distance_m * 1e3)} mm from the truth${sigma_m > 0 ? `, ${figure(distance_m / sigma_m, 2)} sigma as told` : ""}`);
  }

  draw() {
    if (!this.panel.open || this.panel.hidden) return;
    this.place.draw();
    if (!this.turn.node.hidden) this.turn.draw();
  }
}
