// Joins the link to the daemon with what is shown.

import { announceChanges } from "./announcer.js";
import { showFreshness } from "./banner.js";
import { byId, make, setText } from "./dom.js";
import { mm } from "./format.js";
import { showLamps } from "./lamps.js";
import { Link } from "./link.js";
import { showEvents, showMoves } from "./lists.js";
import { Model } from "./model.js";
import { Plots } from "./plots.js";
import { Ram } from "./ram.js";
import { Recordings } from "./recordings.js";
import { showStroke } from "./stroke.js";
import { LANGUAGES, choose, current, text, translatePage } from "./words.js";

const LOOK_MS = 500; // how often it is asked whether all this is still fresh

const model = new Model();
const ram = new Ram();
const plots = new Plots(model);
const recordings = new Recordings(model);

function take(message) {
  const type = model.take(message);
  if (type === "snapshot") showAll();
  else if (type === "estimate") showEstimate();
  else if (type === "move") showMoves(model);
  else if (type === "event") showEvents(model);
  else if (type === "reports") recordings.takeReports(message.now_s);
  if (type === "status" || type === "link") showSlowly();
  if (type === "snapshot") {
    recordings.takeReports(message.reports.now_s);
    recordings.look();
  }
  look(type, message);
}

function showEstimate() {
  if (document.hidden) return;
  showStroke(model);
  ram.show(model);
  plots.ask();
}

function showSlowly() {
  showLamps(model);
  ram.showWords(model);
  if (model.hello) setText(byId("version"), text("version", { version: model.hello.version }));
  const known = model.freshness === "fresh" && model.estimate && !model.undetermined;
  document.title = known ? `${mm(model.estimate.displacement_mm)} mm – ramstroke` : "ramstroke";
}

function showAll() {
  showEstimate();
  showSlowly();
  showMoves(model);
  showEvents(model);
}

/** Freshness changes also when nothing comes. */
function look(type = "", message = {}) {
  showFreshness(model);
  showStroke(model);
  announceChanges(model, type, message);
}

function showLanguages() {
  byId("languages").replaceChildren(...Object.entries(LANGUAGES).map(([name, title]) => {
    const button = make("button", { type: "button", lang: name, "aria-pressed": String(name === current()) }, title);
    button.addEventListener("click", () => {
      choose(name);
      speak();
      byId("languages").querySelector(`[lang=${name}]`).focus();
    });
    return button;
  }));
}

function speak() {
  translatePage();
  showLanguages();
  plots.showWords();
  showAll();
  recordings.show();
  look();
}

/** An address with a token in it need not be seen or kept. */
function hideToken() {
  if (location.search) history.replaceState(null, "", location.pathname);
}

hideToken();
speak();
setInterval(look, LOOK_MS);
document.addEventListener("visibilitychange", () => showAll());
new Link(take, (state) => {
  model.setServer(state);
  look();
});
