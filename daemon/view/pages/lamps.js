// One lamp for each part: a shape, a word, since when, what is wrong, what to do.

import { byId, make, makeSvg, setText } from "./dom.js";
import { number, size, timeOf } from "./format.js";
import { sentence, text } from "./words.js";

const PARTS = ["displacement", "can", "imu", "jy901", "estimator", "recorder", "loop"];
const SHAPES = {
  ok: [["circle", { class: "body", cx: 10, cy: 10, r: 9 }], ["path", { class: "mark", d: "M5.5 10.5 l3 3 l6 -7" }]],
  ill: [["path", { class: "body", d: "M10 1 L19.5 18.5 H0.5 Z" }], ["path", { class: "mark", d: "M10 7 v5 M10 15.4 v.2" }]],
  waiting: [["rect", { class: "body", x: 1, y: 1, width: 18, height: 18, rx: 3 }], ["path", { class: "mark", d: "M6 6 l8 8 M14 6 l-8 8" }]],
  off: [["circle", { class: "hollow", cx: 10, cy: 10, r: 8 }], ["path", { class: "hollow", d: "M6 10 h8" }]],
};

/** The word of a part: of the displacement sensor what the estimator makes of it, if it is more exact. */
export function partWord(model, part) {
  const { state } = model.status[part];
  const can = model.estimate?.can_state;
  return part === "displacement" && can && can !== "ok" && state !== "off" ? can : state;
}

export function showLamps(model) {
  const status = model.status;
  if (status === null) return;
  const list = byId("lamps");
  const wanted = PARTS.filter((part) => status[part] && (part !== "jy901" || status.jy901.state !== "off"));
  const signature = JSON.stringify([wanted.map((part) => face(model, part)), document.documentElement.lang]);
  if (list.dataset.signature !== signature) {
    list.dataset.signature = signature;
    list.replaceChildren(...wanted.map((part) => lamp(model, part)));
  }
  for (const part of wanted) setText(byId(`detail-${part}`), detail(part, status[part]));
  const looking = text("looking", { browsers: model.daemon?.browsers ?? 0, viewers: status.live.viewers });
  const lost = model.lost;
  setText(byId("looking"), lost ? `${looking} · ${text("lost", { count: lost })}` : looking);
}

function face(model, part) {
  const { state, since_s, what, advice } = model.status[part];
  return [part, state, partWord(model, part), Math.round(since_s), what, advice];
}

function lamp(model, part) {
  const { state, since_s, what, advice } = model.status[part];
  const word = text(partWord(model, part));
  const isWell = state === "ok" || state === "off";
  const icon = makeSvg("svg", { viewBox: "0 0 20 20", "aria-hidden": "true" }, ...SHAPES[state].map((shape) => makeSvg(...shape)));
  const head = make("div", { class: "head" },
    make("span", { class: "name" }, text(part)),
    make("span", { class: "state" }, isWell ? word : text("since", { word, time: timeOf(since_s) })),
    make("span", { class: "detail", id: `detail-${part}` }));
  const body = make("div", {}, head);
  for (const [name, words] of [["what", what], ["advice", advice]]) {
    if (words) body.append(make("div", { class: name }, sentence(words)));
  }
  return make("li", { class: "lamp", "data-state": state, "data-part": part }, icon, body);
}

/** One figure that says whether the part lives. */
function detail(part, row) {
  if (row.state !== "ok") return "";
  if (part === "displacement") return row.rate_hz ? text("rate", { rate: number(row.rate_hz, 0) }) : "";
  if (part === "imu" || part === "jy901") return row.samples ? text("samples", { count: row.samples }) : "";
  if (part === "recorder") return row.bytes ? text("moved", { size: size(row.bytes) }) : "";
  if (part === "loop") return text("lateMs", { ms: number(row.late_ms, 0) });
  return "";
}
