// A channel's numbers over time: what is plotted of each type of message, and in which unit.
import { element } from "./dom.js";
import { TimePlot } from "./plot.js";

const xyz = (v) => ({ x: v.x, y: v.y, z: v.z });
const yawOf = (q) => Math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z));
const EARTH_M = 6371008.8, MOST_PENDING = 500;

/// By schema: a maker of f(message) → [{title, unit, values: {name: number}}].
const PLOTTED = {
  "sensor_msgs/msg/Imu": () => (m) => [
    { title: "Specific force", unit: "m/s²", values: xyz(m.linear_acceleration) },
    { title: "Turn rate", unit: "rad/s", values: xyz(m.angular_velocity) },
  ],
  "nav_msgs/msg/Odometry": () => (m) => [
    { title: "Velocity", unit: "m/s", values: { ahead: m.twist.twist.linear.x, left: m.twist.twist.linear.y } },
    { title: "Turn rate", unit: "rad/s", values: { yaw: m.twist.twist.angular.z } },
    { title: "Position", unit: "m", values: { x: m.pose.pose.position.x, y: m.pose.pose.position.y } },
  ],
  "geometry_msgs/msg/PoseStamped": () => (m) => [
    { title: "Position", unit: "m", values: xyz(m.pose.position) },
    { title: "Heading", unit: "°", values: { yaw: (yawOf(m.pose.orientation) * 180) / Math.PI } },
  ],
  "sensor_msgs/msg/NavSatFix": () => {
    let first = null; // plotted against the first fix, on a sphere: good to some mm per km
    return (m) => {
      if (m.status.status < 0) return [{ title: "Off the first fix", unit: "m", values: { east: NaN, north: NaN, up: NaN } }];
      first ??= { latitude: m.latitude, longitude: m.longitude, altitude: m.altitude };
      const degree = (Math.PI / 180) * EARTH_M;
      return [
        {
          title: "Off the first fix",
          unit: "m",
          values: {
            east: (m.longitude - first.longitude) * degree * Math.cos((first.latitude * Math.PI) / 180),
            north: (m.latitude - first.latitude) * degree,
            up: m.altitude - first.altitude,
          },
        },
      ];
    };
  },
  "rigor_msgs/msg/RegisterBlock": () => (m) => {
    const groups = new Map();
    m.names.forEach((name, i) => {
      const unit = m.units[i] ?? "";
      if (!groups.has(unit)) groups.set(unit, { title: "", unit, values: {} });
      groups.get(unit).values[name] = m.values[i];
    });
    for (const group of groups.values()) group.title = group.unit ? Object.keys(group.values).join(", ") : "Values";
    return [...groups.values()];
  },
};
export const isPlotted = (schemaName) => schemaName in PLOTTED;

export class NumbersView {
  large = false;
  #plots = new Map();
  #pending = [];
  #ends = [];

  /// `topics`: by side; a channel that is no pair has one, with the name "main".
  constructor(session, channel, topics, label) {
    this.session = session;
    this.topics = topics;
    this.label = label;
    this.empty = element("p.empty", {}, "No values so far");
    this.node = element("div.view.numbers-view", {}, this.empty);
    this.read = new Map();
    this.show(); // numbers are few: they are kept while the tile is out of sight, so that their history has no holes
  }

  show() {
    if (this.#ends.length) return;
    for (const [side, topic] of Object.entries(this.topics))
      this.#ends.push(
        this.session.follow(topic, (m) => {
          if (this.#pending.push([side, topic, m]) >= MOST_PENDING) this.#takeAll();
        }),
      );
  }
  /// A page that nobody sees asks for nothing.
  hide() {
    if (document.hidden) this.#end();
  }
  #end() {
    for (const end of this.#ends) end();
    this.#ends = [];
  }

  draw() {
    this.#takeAll();
    for (const plot of this.#plots.values()) plot.draw();
  }

  #takeAll() {
    for (const [side, topic, message] of this.#pending) this.#take(side, topic, message);
    this.#pending.length = 0;
  }

  #take(side, topic, message) {
    if (!this.read.has(side)) {
      const make = PLOTTED[this.session.client.topics.get(topic)?.schemaName];
      if (!make) return;
      this.read.set(side, make());
    }
    const m = message.read(message.bytes);
    const t = this.session.seconds(m.header.stamp);
    this.empty.hidden = true;
    this.node.dataset.values = Number(this.node.dataset.values ?? 0) + 1;
    for (const { title, unit, values } of this.read.get(side)(m)) {
      const key = `${title} ${unit}`;
      if (!this.#plots.has(key)) {
        const plot = new TimePlot({ title: title || this.label, unit });
        this.#plots.set(key, plot);
        this.node.append(plot.node);
      }
      for (const [name, value] of Object.entries(values)) this.#plots.get(key).add(side === "main" ? name : `${name} ${side}`, t, value);
    }
  }

  resized() {}
  dispose() {
    this.#end();
  }
}
