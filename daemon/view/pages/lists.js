// Moves and events, the newest first.

import { byId, make, setHidden } from "./dom.js";
import { mm, number, speed, timeOf } from "./format.js";
import { sentence, text } from "./words.js";

export function showMoves(model) {
  setHidden(byId("no-moves"), model.moves.length > 0);
  setHidden(byId("moves").querySelector(".scroll"), model.moves.length === 0);
  byId("move-rows").replaceChildren(...model.moves.toReversed().map(moveRow));
}

function moveRow(move) {
  const cell = (words) => make("td", { class: "number" }, words);
  return make("tr", {},
    make("td", {}, timeOf(move.onset_s)),
    make("td", {}, text(move.kind)),
    cell(`${mm(move.start_mm)} → ${mm(move.end_mm)}`),
    cell(mm(move.sigma_mm)),
    cell(speed(move.velocity_mm_s)),
    cell(number(move.stop_s - move.onset_s, 1)),
    make("td", {}, text(move.can_state)));
}

export function showEvents(model) {
  setHidden(byId("no-events"), model.events.length > 0);
  setHidden(byId("events").querySelector(".scroll"), model.events.length === 0);
  byId("event-rows").replaceChildren(...model.events.toReversed().map(eventRow));
}

function eventRow(event) {
  return make("li", {}, make("time", {}, timeOf(event.t_s)), make("span", {}, sentence(event.what)));
}
