// Numbers and times as people read them.

import { current } from "./words.js";

const NUMBERS = { millimetres: 1, speed: 1 };
const UNSTEADY_MS = 250; // less is the network's doing, and would make every time on the page tremble
let offsetMs = null; // the browser's clock minus the daemon's monotonic one

/** Learn the daemon's clock from a message that carries its present time. */
export function setClock(nowS) {
  const heard = Date.now() - nowS * 1e3;
  if (offsetMs === null || Math.abs(heard - offsetMs) > UNSTEADY_MS) offsetMs = heard;
}

export function clockKnown() {
  return offsetMs !== null;
}

/** A time of the daemon's clock as a moment of the browser's. */
export function moment(tS) {
  return new Date(tS * 1e3 + offsetMs);
}

/** A time of the daemon's clock at which the browser's shows a full minute. */
export function fullMinute() {
  return -(offsetMs / 1e3) % 60;
}

/** 12:04:31, with the date if it is not today's. */
export function clockTime(date) {
  const time = date.toLocaleTimeString("en-GB");
  return date.toDateString() === new Date().toDateString() ? time : `${day(date)} ${time}`;
}

export function timeOf(tS) {
  return offsetMs === null ? "–" : clockTime(moment(tS));
}

function day(date) {
  return date.toLocaleDateString(current() === "zh" ? "zh-CN" : "en-GB", { day: "numeric", month: "short" });
}

/** Always with a true minus sign. */
export function number(value, digits) {
  if (value === null || value === undefined) return "–";
  const words = value.toFixed(digits);
  return (Number(words) === 0 ? words.replace("-", "") : words).replace("-", "−");
}

export const mm = (value) => number(value, NUMBERS.millimetres);
export const speed = (value) => number(value, NUMBERS.speed);

export function size(bytes) {
  if (bytes < 1e6) return `${number(bytes / 1e3, 0)} kB`;
  return bytes < 1e9 ? `${number(bytes / 1e6, bytes < 1e7 ? 1 : 0)} MB` : `${number(bytes / 1e9, 2)} GB`;
}
