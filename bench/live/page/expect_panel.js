// What the rig expects of its run, and how each of it stands: holds so far, violated since when, not decided yet.
import { element, setText } from "./dom.js";

const RANK = { violated: 0, undecided: 1, holds: 2 };

function stateText({ state, first_s }, ended) {
  if (state === "violated") return first_s === null ? "violated" : `violated at ${first_s.toFixed(3)} s`;
  if (state === "holds") return ended ? "holds" : "holds so far";
  return ended ? "not decided" : "not decided yet";
}

export class ExpectPanel {
  constructor(session, panel) {
    this.session = session;
    this.panel = panel;
    this.counts = element("span.expect-counts", { role: "status" });
    this.list = element("ul.expectations");
    panel.querySelector("summary").append(this.counts);
    panel.querySelector(".panel-body").append(this.list);
    session.addEventListener("live", () => this.update());
  }

  update() {
    const { live, ended } = this.session, all = live.expect ?? [];
    this.panel.hidden = all.length === 0;
    const count = (state) => all.filter((e) => e.state === state).length;
    const violated = count("violated"), hold = count("holds"), open = count("undecided");
    setText(this.counts, [violated > 0 ? `${violated} violated` : "", `${hold} of ${all.length} hold`, open > 0 ? `${open} open` : ""].filter(Boolean).join(" · "));
    this.counts.classList.toggle("bad", violated > 0);
    // What is wrong comes first, else they stand as in the rig.
    all.toSorted((a, b) => RANK[a.state] - RANK[b.state]).forEach((e, i) => {
      const line = this.list.children[i] ?? this.list.appendChild(element("li", {}, element("span"), element("span.expect-state"), element("small.outcome")));
      line.dataset.state = e.state;
      [`${e.of} ${e.quantity} ${e.bounds}`, stateText(e, ended), e.outcome].forEach((text, k) => setText(line.children[k], text));
    });
    while (this.list.children.length > all.length) this.list.lastChild.remove();
  }
}
