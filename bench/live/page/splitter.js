// The border between the channels and the panels: dragged, or moved by the arrows; where it was is remembered.
const KEY = "rigor-panels-px", LEAST = 260, STEP = 24;

export function makeSplitter(node, main) {
  const most = () => Math.max(LEAST, main.clientWidth - LEAST - 40);
  const width = () => main.querySelector("aside").getBoundingClientRect().width;
  const set = (px) => {
    const to = Math.round(Math.min(most(), Math.max(LEAST, px)));
    main.style.setProperty("--panels", `${to}px`);
    node.setAttribute("aria-valuenow", to);
    try {
      localStorage.setItem(KEY, to);
    } catch {
      // a browser that remembers nothing
    }
  };
  let kept = null;
  try {
    kept = localStorage.getItem(KEY);
  } catch {
    // as above
  }
  if (kept > 0) set(Number(kept));
  node.addEventListener("pointerdown", (down) => {
    const from = width();
    node.setPointerCapture(down.pointerId);
    node.onpointermove = (e) => set(from + down.clientX - e.clientX);
    node.onpointerup = node.onpointercancel = () => (node.onpointermove = null);
  });
  node.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: STEP, ArrowRight: -STEP }[e.key];
    if (!step) return;
    e.preventDefault();
    set(width() + step);
  });
}
