// The stroke in large, how sure it is, and what the ram does.

import { byId, setHidden, setText } from "./dom.js";
import { mm, timeOf } from "./format.js";
import { text } from "./words.js";

const STILL_MM_S = 1;
const BAND = 1.96;
const COARSE_MM = 20; // beyond, tenths of a millimetre say nothing

export function showStroke(model) {
  const estimate = model.estimate;
  const isNumber = estimate !== null && !model.undetermined;
  byId("stroke-number").parentElement.classList.toggle("word", !isNumber);
  setHidden(byId("stroke-unit"), !isNumber);
  setText(byId("stroke-number"), strokeWords(model));
  setText(byId("stroke-sigma"), sigmaWords(model));
  setText(byId("segment"), estimate ? doing(estimate) : "");
  const stale = model.freshness !== "fresh" && estimate !== null;
  setHidden(byId("stale-mark"), !stale);
  if (stale) setText(byId("stale-mark"), text("stale", { time: timeOf(estimate.t_s) }));
}

export function strokeWords(model) {
  if (model.estimate === null) return text("noEstimate");
  return model.undetermined ? text("undetermined") : mm(model.estimate.displacement_mm);
}

function sigmaWords(model) {
  const estimate = model.estimate;
  if (estimate === null) return "";
  if (model.undetermined) return text("undeterminedWhy", { sigma: estimate.sigma_mm.toFixed(0) });
  const digits = estimate.sigma_mm < COARSE_MM ? 1 : 0;
  return text("sigma", { sigma: estimate.sigma_mm.toFixed(digits), band: (BAND * estimate.sigma_mm).toFixed(digits) });
}

/** The segment in words: at rest, pushing at steady speed, retracting with changing speed. */
export function doing(estimate) {
  if (estimate.segment === "ZUPT") return text("atRest");
  const phase = estimate.segment === "CVS" ? "steady" : "changing";
  return `${text(direction(estimate))} · ${text(phase)}`;
}

/** Only if the velocity tells it. */
function direction({ velocity_mm_s: velocity, velocity_sigma_mm_s: sigma }) {
  if (Math.abs(velocity) < Math.max(STILL_MM_S, BAND * (sigma ?? 0))) return "moving";
  return velocity > 0 ? "pushing" : "retracting";
}
