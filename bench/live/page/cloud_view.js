// A channel's points in its tile: turned with the pointer, coloured by range or remission.
import { element, figure, setText } from "./dom.js";
import { rampCss } from "./color.js";
import { canDrawClouds, CloudView, pointsOf } from "./cloud.js";
import { Feed, showHeld } from "./message_keeper.js";
import { timeline } from "./timeline.js";

export class PointsView {
  large = false;
  #end = null;
  #by = "range";
  #turned = false;

  constructor(session, channel, topic, label) {
    this.session = session;
    this.feed = new Feed(session, timeline);
    this.topic = topic;
    this.canvas = element("canvas.cloud", { tabIndex: 0, role: "img", "aria-label": `Points of ${label}; the pointer turns them, arrows move them` });
    this.canvas.dataset.topic = topic;
    this.empty = element("p.empty", {}, canDrawClouds() ? "No points so far" : "This browser has no WebGL: points are not shown");
    this.by = element("button.small", { type: "button", title: "Colour by range or by remission" }, "range");
    this.by.onclick = () => {
      this.#by = this.#by === "range" ? "remission" : "range";
      setText(this.by, this.#by);
      if (this.points) this.#take(this.points);
    };
    const home = element("button.small", { type: "button", title: "Back to the first view" }, "reset view");
    home.onclick = () => (this.cloud?.home(), (this.#turned = true));
    this.scale = element("div.scale", { hidden: true }, element("span"), element("i"), element("span"));
    this.scale.children[1].style.background = rampCss;
    this.rings = element("span.under-pointer");
    this.held = element("span.held", { hidden: true });
    this.node = element("div.view.cloud-view", {}, element("div.frame", {}, this.canvas, this.empty, this.rings, this.held), element("div.view-tools", {}, this.scale, this.by, home));
    if (canDrawClouds()) this.cloud = new CloudView(this.canvas, () => (this.#turned = true));
  }

  show() {
    this.#end ??= this.session.client.subscribe(this.topic, (m) => this.feed.came(m));
  }
  hide() {
    this.#end?.();
    this.#end = null;
  }

  #take(points) {
    this.points = points;
    const [from, to] = this.cloud.set(points, this.#by);
    const unit = this.#by === "range" ? " m" : "";
    this.scale.hidden = false;
    setText(this.scale.children[0], figure(from) + unit);
    setText(this.scale.children[2], figure(to) + unit);
    setText(this.rings, this.cloud.ringStep ? `${figure(points.count)} points · rings every ${this.cloud.ringStep} m` : "");
    this.#turned = true;
  }

  draw() {
    if (!this.cloud) return;
    const message = this.feed.next();
    showHeld(this.held, this.feed);
    if (message) {
      try {
        this.#take(pointsOf(message.read(message.bytes)));
        this.canvas.dataset.pictures = Number(this.canvas.dataset.pictures ?? 0) + 1;
        this.empty.hidden = true;
      } catch (error) {
        this.empty.hidden = false;
        setText(this.empty, error.message);
      }
    }
    if (!this.#turned) return;
    this.#turned = false;
    this.cloud.draw();
  }

  /// The canvas has another size.
  resized() {
    this.#turned = true;
  }
  dispose() {
    this.hide();
    this.cloud?.dispose();
  }
}
