// The verdict on the run so far: what is wrong, the worst first, with what helps. As `rigor run` prints it at the end.
import { element, setText } from "./dom.js";

const TITLES = { good: "Good so far", warning: "Warnings", bad: "Bad" };

/// `like this` is shown as code.
function sentence(text) {
  return text.split("`").map((part, i) => (i % 2 ? element("code", {}, part) : part));
}

export class Verdict {
  #shown = "";

  constructor(session, node) {
    this.session = session;
    this.node = node;
    this.title = element("b");
    this.list = element("ul");
    node.append(this.title, this.list);
    session.addEventListener("live", () => this.update());
  }

  update() {
    const verdict = this.session.live.verdict;
    this.node.hidden = !verdict;
    if (!verdict) return;
    this.node.dataset.state = verdict.state;
    setText(this.title, verdict.state === "good" ? `${TITLES.good}: ${verdict.text}` : `${TITLES[verdict.state]}:`);
    const shown = JSON.stringify(verdict.findings);
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.list.replaceChildren(
      ...verdict.findings.map((f) => {
        const line = element("li", {}, ...sentence(f.cure ? `${f.text}; ${f.cure}` : f.text));
        line.dataset.severity = f.severity;
        return line;
      }),
    );
  }
}
