// Says at once when what is shown is old, and since when.

import { byId, make } from "./dom.js";
import { clockTime, timeOf } from "./format.js";
import { text } from "./words.js";

let shown = "";

export function showFreshness(model) {
  const freshness = model.freshness;
  document.body.dataset.freshness = freshness;
  document.body.classList.toggle("stale", freshness !== "fresh");
  byId("link-word").textContent = text(freshness === "fresh" ? "live" : freshness === "starting" ? "starting" : "notLive");
  const [what, advice] = words(model, freshness);
  if (shown === what + advice) return;
  shown = what + advice;
  byId("banner").replaceChildren(...(what ? [make("p", {}, make("strong", {}, what), advice)] : []));
}

function words(model, freshness) {
  if (freshness === "server") return [text("serverGone", { time: clockTime(model.serverLost) }), text("tryingAgain")];
  if (freshness === "locked") return [text("locked"), ""];
  if (freshness === "full") return [text("full"), ""];
  if (freshness === "daemon") {
    const daemon = model.daemon;
    if (daemon.why === "starting") return ["", ""];
    return [text(model.hello ? "daemonGone" : "daemonNever", { time: timeOf(daemon.since_s) }), text(`why_${daemon.why}`)];
  }
  if (freshness === "silent") return [text("daemonSilent", { time: timeOf(model.daemon.since_s) }), text("why_silent")];
  if (freshness === "estimate") return [text("estimateSilent", { time: timeOf(model.estimate.t_s) }), ""];
  return ["", ""];
}
