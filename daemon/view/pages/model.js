// What is known: the daemon's words, and whether they are fresh.

import { setClock } from "./format.js";

export const WINDOW_S = 60;
const KEPT_ESTIMATES = 660;
const KEPT_MOVES = 50;
const KEPT_EVENTS = 100;
const SILENT_MS = 3000;

export class Model {
  constructor() {
    this.hello = null;
    this.status = null;
    this.estimates = [];
    this.moves = [];
    this.events = [];
    this.daemon = null; // state of the server's link to the daemon
    this.server = "starting"; // our own link: starting, up, down, locked, full
    this.serverLost = null; // since when it is not up
    this.estimateCame = -Infinity; // on the browser's monotonic clock
    this.reports = {};
    this.dropped = { lines: 0, messages: 0 }; // on the way to the server, on the way from it
    this.undeterminedShare = 1;
  }

  get estimate() {
    return this.estimates.at(-1) ?? null;
  }

  setServer(state) {
    if (state !== "up" && (this.server === "up" || this.serverLost === null)) this.serverLost = new Date();
    if (state === "up") this.serverLost = null;
    this.server = state;
  }

  /** Returns what changed: the type of the message. */
  take(message) {
    const { type, ...content } = message;
    if (type === "snapshot") this.takeSnapshot(content);
    else if (type === "link") this.takeLink(content);
    else if (type === "status") this.status = content;
    else if (type === "estimate") this.takeEstimate(content);
    else if (type === "move") keep(this.moves, content, KEPT_MOVES);
    else if (type === "event") keep(this.events, content, KEPT_EVENTS);
    else if (type === "reports") this.takeReports(content);
    else if (type === "dropped") Object.assign(this.dropped, content);
    return type;
  }

  takeSnapshot(content) {
    this.hello = content.hello;
    this.status = content.status;
    this.estimates = content.estimates;
    this.moves = content.moves;
    this.events = content.events;
    this.undeterminedShare = content.undetermined_share;
    this.takeLink(content.link);
    this.takeReports(content.reports);
    const last = this.estimate;
    if (last) this.estimateCame = performance.now() - Math.max(0, content.link.now_s - last.t_s) * 1e3;
  }

  takeLink(content) {
    setClock(content.now_s);
    this.daemon = content;
  }

  takeEstimate(content) {
    const last = this.estimate;
    if (last && content.t_s < last.t_s) this.estimates.length = 0; // the computer was started anew
    keep(this.estimates, content, KEPT_ESTIMATES);
    this.estimateCame = performance.now();
  }

  takeReports(content) {
    this.reports = content.reports;
  }

  /** fresh, or why not: starting, server, locked, full, daemon, silent, estimate. */
  get freshness() {
    if (this.server !== "up") return { starting: "starting", down: "server" }[this.server] ?? this.server;
    if (this.daemon === null) return "starting";
    if (this.daemon.state === "down") return "daemon";
    if (this.daemon.state === "silent") return "silent";
    if (this.estimate && performance.now() - this.estimateCame > SILENT_MS) return "estimate";
    return "fresh";
  }

  /** Messages that did not reach this page, lines that the server could not read among them. */
  get lost() {
    return this.dropped.lines + this.dropped.messages + (this.daemon?.damaged ?? 0);
  }

  get undetermined() {
    return this.estimate !== null && !this.isDetermined(this.estimate);
  }

  isDetermined(estimate) {
    return this.hello === null || estimate.sigma_mm < this.undeterminedShare * this.hello.stroke_mm;
  }
}

function keep(list, item, most) {
  list.push(item);
  if (list.length > most) list.splice(0, list.length - most);
}
