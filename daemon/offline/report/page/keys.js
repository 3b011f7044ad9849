// Buttons above the plots, and the keys that do the same while the plots have the focus.

import { element } from "report/figures.js";

const ACTIONS = [
  { name: "Whole", label: "Show the whole recording", keys: ["0", "Home"], act: (t) => t.whole() },
  { name: "＋", label: "Zoom in", keys: ["+", "=", "ArrowUp"], act: (t) => t.zoom(0.5) },
  { name: "－", label: "Zoom out", keys: ["-", "ArrowDown"], act: (t) => t.zoom(2) },
  { name: "◀", label: "Earlier", keys: ["ArrowLeft"], byFinger: true, act: (t) => t.shift(-0.25) },
  { name: "▶", label: "Later", keys: ["ArrowRight"], byFinger: true, act: (t) => t.shift(0.25) },
  { name: "◀ move", label: "Previous move", keys: ["p"], needsMoves: true, act: (t) => t.step(-1) },
  { name: "move ▶", label: "Next move", keys: ["n"], needsMoves: true, act: (t) => t.step(1) },
];

export function toolbar(region, timeline, told) {
  const shown = element("output", { class: "shown" });
  const bar = element("div", { class: "toolbar", role: "group", "aria-label": "Stretch of time that the plots show" });
  for (const action of ACTIONS) {
    if (action.needsMoves && timeline.marks.length === 0) continue;
    const button = element("button", { type: "button", "aria-label": action.label, title: `${action.label} (${action.keys[0]})` }, action.name);
    button.addEventListener("click", () => action.act(timeline));
    if (action.byFinger) button.className = "by-finger";
    bar.append(button);
  }
  bar.append(shown);
  const tell = () => (shown.textContent = told(timeline.from, timeline.until));
  timeline.listeners.push(tell);
  tell();

  region.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, summary") !== null) return;
    const action = ACTIONS.find(({ keys }) => keys.includes(event.key));
    if (action === undefined) return;
    event.preventDefault();
    action.act(timeline);
  });
  return bar;
}
