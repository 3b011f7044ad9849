// For those who listen: changes of the state, never the numbers that run.

import { byId } from "./dom.js";
import { mm } from "./format.js";
import { partWord } from "./lamps.js";
import { text } from "./words.js";

let known = null; // state of each part when it was last spoken of
let wasFresh = null;
const waiting = [];
let timer = null;

export function announceChanges(model, type, message) {
  const fresh = model.freshness === "fresh";
  if (fresh && wasFresh === false) say(text("liveAgain")); // the banner tells the opposite
  if (model.freshness !== "starting") wasFresh = fresh;
  if (type === "move") say(text("moveDone", { kind: text(message.kind), end: mm(message.end_mm) }));
  if (model.status === null) return;
  const now = Object.fromEntries(PARTS.map((part) => [part, partWord(model, part)]));
  for (const part of known ? PARTS : []) {
    if (known[part] !== now[part]) say(text("told", { name: text(part), word: text(now[part]) }));
  }
  known = now;
}

const PARTS = ["imu", "can", "displacement", "estimator", "recorder"];

export function say(words) {
  waiting.push(words);
  timer ??= setTimeout(() => {
    timer = null;
    byId("announcement").textContent = waiting.splice(0).join(" ");
  }, 500);
}
