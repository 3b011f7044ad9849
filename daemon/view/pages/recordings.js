// The recordings: to download, and to have a report of made.

import { say } from "./announcer.js";
import { byId, make, setHidden, setText } from "./dom.js";
import { clockTime, number, size } from "./format.js";
import { text } from "./words.js";

const LOOK_EVERY_MS = 15000;

export class Recordings {
  constructor(model) {
    this.model = model;
    this.rows = [];
    this.known = {};
    this.sinceMs = {}; // since when a report is being made, on our clock
    setInterval(() => this.look(), LOOK_EVERY_MS);
    setInterval(() => this.tick(), 1000);
  }

  async look() {
    if (document.hidden || this.model.server !== "up") return;
    try {
      const answer = await fetch("/recordings");
      if (!answer.ok) return;
      this.rows = (await answer.json()).recordings;
    } catch {
      return; // the banner tells
    }
    this.show();
  }

  takeReports(nowS) {
    for (const [name, { state, since_s }] of Object.entries(this.model.reports)) {
      this.sinceMs[name] = performance.now() - (nowS - since_s) * 1e3;
      if (state === "ready" && this.known[name] && this.known[name] !== "ready") say(text("reportDone", { name }));
      this.known[name] = state;
    }
    this.show();
  }

  show() {
    const focused = document.activeElement?.id;
    setHidden(byId("no-recordings"), this.rows.length > 0);
    setHidden(byId("recordings").querySelector(".scroll"), this.rows.length === 0);
    byId("recording-rows").replaceChildren(...this.rows.map((row) => this.row(row)));
    if (focused) byId(focused)?.focus();
    this.tick();
  }

  row({ name, bytes, changed_s, growing }) {
    const changed = growing ? make("span", { class: "growing" }, text("growing")) : clockTime(new Date(changed_s * 1e3));
    return make("tr", {},
      make("td", {}, make("a", { href: `/recordings/${name}`, download: name, id: `file-${name}` }, name)),
      make("td", {}, changed),
      make("td", { class: "number" }, size(bytes)),
      make("td", {}, ...this.report(name)));
  }

  report(name) {
    const { state, why } = this.model.reports[name] ?? {};
    if (state === "waiting") return [make("span", { class: "making" }, text("reportWaiting"))];
    if (state === "building") return [make("span", { class: "making", "data-making": name })];
    const button = make("button", { type: "button", id: `report-${name}`, "aria-label": text("makeReportOf", { name }) }, text("makeReport"));
    button.addEventListener("click", () => this.ask(name));
    if (state === "ready") return [this.openReport(name)];
    return state === "failed" ? [button, make("span", { class: "why" }, text("reportFailed", { why }))] : [button];
  }

  openReport(name) {
    const label = text("openReportOf", { name });
    return make("a", { href: `/recordings/${name}/report`, target: "_blank", rel: "noopener", id: `report-${name}`, "aria-label": label }, text("openReport"));
  }

  async ask(name) {
    try {
      await fetch(`/recordings/${name}/report`, { method: "POST" });
    } catch {
      // the banner tells
    }
  }

  tick() {
    for (const element of document.querySelectorAll("[data-making]")) {
      const seconds = (performance.now() - this.sinceMs[element.dataset.making]) / 1e3;
      setText(element, text("reportBuilding", { seconds: number(Math.max(0, seconds), 0) }));
    }
  }
}
