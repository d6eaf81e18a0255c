// The page: makes its parts, and draws what is new once in each frame of the screen.
import { Channels } from "./channels.js";
import { EstimatePanel } from "./estimate_panel.js";
import { EventLog } from "./event_log.js";
import { ExpectPanel } from "./expect_panel.js";
import { FaultPanel } from "./fault_panel.js";
import { FramesView } from "./frames_view.js";
import { PairPanel } from "./pair_panel.js";
import { RunHeader, RunPanel } from "./run_panel.js";
import { Session } from "./session.js";
import { makeSplitter } from "./splitter.js";
import { TimelineBar, timeline } from "./timeline.js";
import { Verdict } from "./verdict.js";
import { WorldPanel } from "./world_panel.js";
import { element, setText } from "./dom.js";

const at = (id) => document.getElementById(id);
const body = (id) => at(id).querySelector(".panel-body");

const session = new Session();
new RunHeader(session, at("head"));
new Verdict(session, at("verdict"));
new ExpectPanel(session, at("expect"));
const channels = new Channels(session, at("channels"));
const world = new WorldPanel(session, at("world"));
const frames = new FramesView(session, at("frames"));
const run = new RunPanel(session, body("loop"));
const pairs = new PairPanel(session, at("pairs"));
const estimate = new EstimatePanel(session, at("estimate"));
makeSplitter(at("splitter"), document.querySelector("main"));
new FaultPanel(session, body("faults"));
const bar = new TimelineBar(at("timeline"));
new EventLog(session, body("events"));

const banner = at("banner"), said = element("span");
const word = element("input", { type: "text", name: "token", required: true, autocomplete: "off", "aria-label": "Token" });
const tokenForm = element("form", { hidden: true, method: "get", action: "/" }, word, element("button", { type: "submit" }, "Open"));
banner.append(said, tokenForm);
function tell() {
  const { client, ended, tokenRefused } = session;
  const what = session.live?.run.replay ? "replay" : "run";
  const text = ended
    ? client.state === "open"
      ? `The ${what} has ended. Its page stays: pause and move back over it.`
      : "The run has ended. What is shown is its last state."
    : session.gone && session.live
      ? "The run has ended, or its machine cannot be reached. What is shown is its last state."
      : client.state === "lost" || (client.state === "connecting" && session.live)
      ? "The connection to the run is lost. Trying again…"
      : tokenRefused
        ? "This run asks for a token: the address that the command printed ends in it, or --live-token gave it."
        : client.state === "refused"
          ? "No run answers here. Trying again…"
          : "";
  banner.hidden = text === "";
  banner.dataset.kind = ended ? "ended" : "lost";
  document.body.classList.toggle("frozen", text !== "");
  document.body.classList.toggle("ended", ended);
  tokenForm.hidden = ended || !tokenRefused;
  document.body.classList.toggle("unknown", !session.live);
  setText(said, text);
}
session.addEventListener("state", tell);
session.addEventListener("live", tell);
// What is replayed is as it was: nothing is to be made worse.
session.addEventListener("live", () => (at("faults").hidden = session.live.run.replay === true));
tell();
let last = "";
session.addEventListener("state", () => {
  const state = session.ended ? "run has ended" : { open: "connected", lost: "connection lost" }[session.client.state];
  if (state && state !== last) session.note("page", state);
  last = state ?? last;
});

function draw() {
  channels.draw();
  world.draw();
  frames.draw();
  pairs.draw();
  estimate.draw();
  bar.draw();
  requestAnimationFrame(draw);
}
requestAnimationFrame(draw);

// Colours of canvases follow the style.
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => (timeline.point(null), channels.resized(), world.map.resized(), run.histogram.draw()));
new ResizeObserver(() => run.histogram.draw()).observe(run.histogram.canvas);
