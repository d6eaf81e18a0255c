// The Foxglove WebSocket protocol, client's side: topics come and go, messages of those that are subscribed, services
// that are called. Connects again by itself; what is subscribed stays so by the topic's name.
//
// Events (as `detail`): "state" {state, reason}, "topics" (the map of topics), "status" {level, message}.
import { compile } from "./cdr.js";

const SUBPROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const OP_MESSAGE = 1, OP_TIME = 2, OP_CALL = 2, OP_ANSWER = 3;
const LONGEST_PAUSE_MS = 5000, ANSWER_WITHIN_MS = 15000;
const encoder = new TextEncoder(), decoder = new TextDecoder();

function readerOf(channel) {
  if (channel.encoding === "json") return (bytes) => JSON.parse(decoder.decode(bytes));
  if (channel.encoding === "cdr" && channel.schemaEncoding === "ros2msg") return compile(channel.schemaName, channel.schema);
  return null; // shown by nobody
}

export class FoxgloveClient extends EventTarget {
  state = "connecting"; // connecting, open, lost, ended, refused
  topics = new Map(); // by name: {id, topic, schemaName, read}
  services = new Map(); // by name: id
  serverInfo = null;
  bytes = 0;
  serverTime = 0;
  #socket = null;
  #wanted = new Map(); // topic: Set of handlers
  #subscriptions = new Map(); // our id: {topic, read}
  #idOfTopic = new Map();
  #calls = new Map(); // call id: {resolve, reject, timer}
  #next = 1;
  #pause = 250;
  #everOpen = false;

  constructor(url) {
    super();
    this.url = url;
    this.connect();
  }

  connect() {
    this.#tell("connecting");
    const socket = new WebSocket(this.url, SUBPROTOCOLS);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      this.#pause = 250;
      this.#everOpen = true;
      this.#tell("open");
    };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.#text(JSON.parse(data));
      else this.#binary(data);
    };
    socket.onclose = ({ code, reason }) => this.#closed(code, reason);
  }

  /// `handler(message, timeNs)` for each message of the topic, now and whenever the topic is there. Returns what ends it.
  subscribe(topic, handler) {
    if (!this.#wanted.has(topic)) this.#wanted.set(topic, new Set());
    this.#wanted.get(topic).add(handler);
    this.#ask(topic);
    return () => {
      const handlers = this.#wanted.get(topic);
      if (!handlers?.delete(handler) || handlers.size > 0) return;
      this.#wanted.delete(topic);
      const id = this.#idOfTopic.get(topic);
      if (id === undefined) return;
      this.#idOfTopic.delete(topic);
      this.#subscriptions.delete(id);
      this.#send({ op: "unsubscribe", subscriptionIds: [id] });
    };
  }

  /// The service's answer, or an Error with what it said.
  call(service, request) {
    const id = this.services.get(service);
    if (this.state !== "open") return Promise.reject(new Error("not connected to the run"));
    if (id === undefined) return Promise.reject(new Error(`this run does not offer ${service}`));
    const payload = encoder.encode(JSON.stringify(request));
    const frame = new Uint8Array(1 + 12 + 4 + payload.length);
    const view = new DataView(frame.buffer);
    const call = this.#next++;
    view.setUint8(0, OP_CALL);
    view.setUint32(1, id, true);
    view.setUint32(5, call, true);
    view.setUint32(9, 4, true);
    frame.set(encoder.encode("json"), 13);
    frame.set(payload, 17);
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => this.#answer(call, (c) => c.reject(new Error(`${service} did not answer`))), ANSWER_WITHIN_MS);
      this.#calls.set(call, { resolve, reject, timer });
      this.#socket.send(frame);
    });
  }

  #answer(call, how) {
    const waiting = this.#calls.get(call);
    if (!waiting) return;
    this.#calls.delete(call);
    clearTimeout(waiting.timer);
    how(waiting);
  }

  #tell(state, reason = "") {
    this.state = state;
    this.dispatchEvent(new CustomEvent("state", { detail: { state, reason } }));
  }

  #send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  #ask(topic) {
    const channel = this.topics.get(topic);
    if (!channel?.read || this.#idOfTopic.has(topic)) return;
    const id = this.#next++;
    this.#idOfTopic.set(topic, id);
    this.#subscriptions.set(id, channel);
    this.#send({ op: "subscribe", subscriptions: [{ id, channelId: channel.id }] });
  }

  #text(message) {
    if (message.op === "serverInfo") {
      this.serverInfo = message;
    } else if (message.op === "advertise") {
      for (const channel of message.channels) {
        let read = null;
        try {
          read = readerOf(channel);
        } catch (error) {
          console.warn(`${channel.topic}: ${error.message}`);
        }
        this.topics.set(channel.topic, { ...channel, read });
        if (this.#wanted.has(channel.topic)) this.#ask(channel.topic);
      }
      this.dispatchEvent(new CustomEvent("topics", { detail: this.topics }));
    } else if (message.op === "unadvertise") {
      for (const [topic, channel] of this.topics)
        if (message.channelIds.includes(channel.id)) {
          this.topics.delete(topic);
          this.#subscriptions.delete(this.#idOfTopic.get(topic));
          this.#idOfTopic.delete(topic);
        }
      this.dispatchEvent(new CustomEvent("topics", { detail: this.topics }));
    } else if (message.op === "advertiseServices") {
      for (const service of message.services) this.services.set(service.name, service.id);
      this.dispatchEvent(new CustomEvent("services", { detail: this.services }));
    } else if (message.op === "unadvertiseServices") {
      for (const [name, id] of this.services) if (message.serviceIds.includes(id)) this.services.delete(name);
    } else if (message.op === "serviceCallFailure") {
      this.#answer(message.callId, (c) => c.reject(new Error(message.message)));
    } else if (message.op === "status") {
      this.dispatchEvent(new CustomEvent("status", { detail: message }));
    }
  }

  #binary(buffer) {
    this.bytes += buffer.byteLength;
    const view = new DataView(buffer), op = view.getUint8(0);
    if (op === OP_MESSAGE) {
      const channel = this.#subscriptions.get(view.getUint32(1, true));
      if (!channel) return;
      const time = view.getBigUint64(5, true);
      const message = { bytes: new Uint8Array(buffer, 13), time, read: channel.read };
      for (const handler of this.#wanted.get(channel.topic) ?? []) handler(message);
    } else if (op === OP_TIME) {
      this.serverTime = view.getBigUint64(1, true);
    } else if (op === OP_ANSWER) {
      const encoding = view.getUint32(9, true);
      const payload = new Uint8Array(buffer, 13 + encoding);
      this.#answer(view.getUint32(5, true), (c) => {
        try {
          c.resolve(payload.length ? JSON.parse(decoder.decode(payload)) : {});
        } catch (error) {
          c.reject(error);
        }
      });
    }
  }

  #closed(code, reason) {
    this.topics.clear();
    this.services.clear();
    this.#subscriptions.clear();
    this.#idOfTopic.clear();
    for (const call of [...this.#calls.keys()]) this.#answer(call, (c) => c.reject(new Error("the connection was lost")));
    this.#tell(this.#everOpen ? "lost" : "refused", reason || (code === 1006 ? "" : `code ${code}`));
    setTimeout(() => this.connect(), this.#pause);
    this.#pause = Math.min(LONGEST_PAUSE_MS, this.#pause * 2);
  }
}
