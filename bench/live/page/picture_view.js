// A channel's picture in its tile: small ones (JPEG) while the tile is small, the sensor's own pixels when it is large;
// range images in colours of range, with their scale. A click asks the world what is seen there.
import { element, figure, setText } from "./dom.js";
import { rampCss, SteadyLimits } from "./color.js";
import { Feed, showHeld } from "./message_keeper.js";
import { PictureDecoder } from "./picture.js";
import { timeline } from "./timeline.js";

export class PictureView {
  large = false;
  #decoder = new PictureDecoder();
  #limits = new SteadyLimits();
  #range = null;
  #ends = [];

  constructor(session, channel, topic, label) {
    this.session = session;
    this.feed = new Feed(session, timeline);
    this.name = channel.name;
    this.topic = topic;
    this.isRange = channel.kind === "range_image";
    this.canvas = element("canvas.picture", { width: 4, height: 3, role: "img", "aria-label": `Picture of ${label}` });
    this.canvas.dataset.topic = topic;
    this.empty = element("p.empty", {}, "No picture so far");
    this.scale = element("div.scale", { hidden: true }, element("span"), element("i"), element("span"));
    this.scale.children[1].style.background = rampCss;
    this.value = element("span.under-pointer");
    this.held = element("span.held", { hidden: true });
    this.node = element("div.view.picture-view", {}, element("div.frame", {}, this.canvas, this.empty, this.value, this.held), this.scale);
    if (this.isRange) {
      this.canvas.addEventListener("pointermove", (e) => this.#point(e));
      this.canvas.addEventListener("pointerleave", () => setText(this.value, ""));
    } else {
      this.canvas.classList.add("pickable");
      this.canvas.title = "Click: what is seen here?";
      this.canvas.addEventListener("click", (e) => this.#pick(e));
    }
  }

  /// Topics are subscribed only while the tile is seen.
  show() {
    const small = `${this.topic}/small`;
    const useSmall = !this.large && !this.isRange && this.session.client.topics.has(small);
    this.hide();
    this.#ends = [this.session.client.subscribe(useSmall ? small : this.topic, (m) => this.feed.came(m))];
    if (!this.isRange && !useSmall)
      this.#ends.push(this.session.client.subscribe(`${this.topic}/settings`, (m) => this.#decoder.settings(m.read(m.bytes).pixel_format)));
  }
  hide() {
    for (const end of this.#ends) end();
    this.#ends = [];
  }

  async draw() {
    if (this.busy) return;
    const message = this.feed.next();
    showHeld(this.held, this.feed);
    if (!message) return;
    this.busy = true;
    try {
      const image = message.read(message.bytes);
      if (image.format !== undefined) await this.#drawCompressed(image);
      else this.#drawRaw(image);
      this.canvas.dataset.encoding = image.encoding ?? image.format;
      this.canvas.dataset.stamp = `${image.header.stamp.sec}.${String(image.header.stamp.nanosec).padStart(9, "0")}`;
      this.canvas.dataset.pictures = Number(this.canvas.dataset.pictures ?? 0) + 1;
      this.empty.hidden = true;
    } catch (error) {
      this.empty.hidden = false;
      setText(this.empty, error.message);
    }
    this.busy = false;
  }

  #size(width, height) {
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    return this.canvas.getContext("2d");
  }
  async #drawCompressed(image) {
    const bitmap = await createImageBitmap(new Blob([image.data], { type: `image/${image.format}` }));
    this.#size(bitmap.width, bitmap.height).drawImage(bitmap, 0, 0);
    bitmap.close();
  }
  #drawRaw(image) {
    const picture = this.#decoder.decode(image, (l) => this.#limits.follow(l));
    this.#size(image.width, image.height).putImageData(picture.pixels, 0, 0);
    this.scale.hidden = !picture.range;
    if (!picture.range) return;
    this.#range = { values: picture.values, width: image.width, height: image.height };
    setText(this.scale.children[0], `${figure(picture.range[0])} m`);
    setText(this.scale.children[2], `${figure(picture.range[1])} m`);
  }

  /// Pixel of the canvas under a pointer.
  #pixel(event) {
    const box = this.canvas.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * this.canvas.width, ((event.clientY - box.top) / box.height) * this.canvas.height];
  }
  #point(event) {
    if (!this.#range) return;
    const [u, v] = this.#pixel(event).map(Math.floor);
    const range = this.#range.values[v * this.#range.width + u];
    setText(this.value, range === undefined ? "" : Number.isFinite(range) ? `${range.toFixed(3)} m` : "no return");
  }
  async #pick(event) {
    const channel = this.session.channel(this.name);
    const scale = (channel?.width_px ?? this.canvas.width) / this.canvas.width;
    const [u, v] = this.#pixel(event).map((p) => p * scale - 0.5); // the centre of the first pixel is 0
    try {
      const found = await this.session.call("rigor/world/pick", { channel: this.name, u_px: u, v_px: v });
      if (found.id) this.session.select(found.id);
      setText(this.value, found.id ? `${found.name || found.type}, ${figure(found.distance_m)} m` : "nothing there");
    } catch (error) {
      setText(this.value, error.message);
    }
    clearTimeout(this.told);
    this.told = setTimeout(() => setText(this.value, ""), 4000);
  }

  dispose() {
    this.hide();
  }
}
