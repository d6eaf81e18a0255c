// Pictures and points of the time that is over, for who pauses and moves back: as many as the memory takes, over the whole
// time since the page was opened. Where room ends, every other one goes.
import { setText } from "./dom.js";

const MOST = 600, MOST_BYTES = 16 << 20;

export class MessageKeeper {
  #kept = []; // [t, message], rising in t
  #bytes = 0;
  #gap = 0;

  add(t, message) {
    const last = this.#kept.at(-1);
    if (last && t < last[0] - 1) {
      this.#kept = []; // another run
      this.#bytes = this.#gap = 0;
    } else if (last && t < last[0] + this.#gap) return;
    this.#kept.push([t, message]);
    this.#bytes += message.bytes.length;
    if (this.#kept.length <= MOST && this.#bytes <= MOST_BYTES) return;
    const span = t - this.#kept[0][0];
    this.#kept = this.#kept.filter((_, i) => i % 2 === 0);
    this.#bytes = this.#kept.reduce((sum, [, m]) => sum + m.bytes.length, 0);
    this.#gap = span / Math.max(1, this.#kept.length - 1);
  }

  get length() {
    return this.#kept.length;
  }

  /// [t, message] of the last one at or before t; before the first: that one. null: there is none.
  at(t) {
    let low = 0, high = this.#kept.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.#kept[middle][0] <= t) low = middle;
      else high = middle - 1;
    }
    return this.#kept[low] ?? null;
  }
}

/// What a view shows now: the newest message once, or while the timeline is held the one of the instant that it points at.
/// Used as: feed.came(message) whenever one comes, feed.next() before each frame → a message to be drawn, or null.
export class Feed {
  #keeper = new MessageKeeper();
  #message = null;
  #shown = null;

  constructor(session, timeline) {
    this.session = session;
    this.timeline = timeline;
    this.heldAt = null; // seconds of the message that is shown while the timeline is held
  }
  came(message) {
    this.#message = message;
    if (!this.session.live) return;
    const t = this.session.seconds(message.time);
    this.#keeper.add(t, message);
    this.timeline.advance(t);
  }
  next() {
    const { timeline } = this;
    let message = this.#message;
    if (timeline.paused) {
      const held = this.#keeper.at(timeline.cursor ?? timeline.until);
      this.heldAt = held?.[0] ?? null;
      message = held?.[1] ?? null;
    } else if (this.heldAt !== null) {
      this.heldAt = null;
      this.#shown = null;
    }
    if (!message || message === this.#shown) return null;
    this.#shown = message;
    return message;
  }
}

/// Says of what instant a picture is that is not the newest.
export function showHeld(node, feed) {
  node.hidden = feed.heldAt === null;
  if (!node.hidden) setText(node, `at ${feed.heldAt.toFixed(2)} s`);
}
