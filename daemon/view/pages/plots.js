// Stroke, velocity and acceleration of the last minute, in step; they can be stopped to look closely.

import { Chart } from "./chart.js";
import { byId, setText } from "./dom.js";
import { clockKnown, fullMinute, moment, mm, speed, timeOf } from "./format.js";
import { WINDOW_S } from "./model.js";
import { text } from "./words.js";

const BAND = 1.96;

export class Plots {
  constructor(model) {
    this.model = model;
    this.held = null; // the estimates that are shown while paused
    this.cursor = null; // the moment under the pointer
    this.charts = {
      stroke: new Chart(byId("plot-stroke"), 12),
      velocity: new Chart(byId("plot-velocity"), 4),
      acceleration: new Chart(byId("plot-acceleration"), 0.08),
    };
    this.readColours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.readColours());
    byId("pause").addEventListener("click", () => this.toggle());
    for (const chart of Object.values(this.charts)) {
      chart.canvas.addEventListener("pointermove", (event) => this.point(chart.momentAt(event.clientX)));
      chart.canvas.addEventListener("pointerleave", () => this.point(null));
      new ResizeObserver(() => this.ask()).observe(chart.canvas);
    }
  }

  toggle() {
    this.held = this.held ? null : [...this.model.estimates];
    this.showWords();
    this.ask();
  }

  point(t) {
    this.cursor = t;
    this.ask();
  }

  /** Draw with the browser's next picture; however often one asks. */
  ask() {
    this.asked ??= requestAnimationFrame(() => {
      this.asked = null;
      this.draw();
    });
  }

  showWords() {
    const button = byId("pause");
    button.textContent = text(this.held ? "resume" : "pause");
    button.setAttribute("aria-pressed", String(this.held !== null));
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const names = ["ink", "soft", "grid", "blue", "band", "dots", "limits"];
    this.colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    this.ask();
  }

  draw() {
    const rows = this.held ?? this.model.estimates;
    const last = rows.at(-1);
    if (!last || !clockKnown()) return;
    const { blue, band, dots, limits } = this.colours;
    const frame = { from: last.t_s - WINDOW_S, to: last.t_s, timeWords: axisTime, roundS: fullMinute(), colours: this.colours, cursor: this.cursor };
    const draw = (name, ...series) => this.charts[name].draw({ ...frame, series });
    const known = rows.filter((row) => this.model.isDetermined(row));
    draw("stroke",
      { kind: "band", colour: band, points: around(known, "displacement_mm", "sigma_mm") },
      { kind: "dots", colour: dots, points: readings(rows) },
      { kind: "line", colour: blue, points: course(known, "displacement_mm") });
    draw("velocity",
      { kind: "band", colour: band, points: around(rows, "velocity_mm_s", "velocity_sigma_mm_s") },
      { kind: "line", colour: blue, points: course(rows, "velocity_mm_s") });
    draw("acceleration",
      { kind: "limits", colour: limits, points: rows.filter((r) => isNumber(r.chart_lower_m_s2) && isNumber(r.chart_upper_m_s2)).map((r) => [r.t_s, r.chart_lower_m_s2, r.chart_upper_m_s2]) },
      { kind: "line", colour: blue, points: course(rows, "acceleration_m_s2") });
    this.read(rows);
  }

  /** The numbers under the pointer. */
  read(rows) {
    const near = this.cursor === null ? null : rows.reduce((best, row) => (Math.abs(row.t_s - this.cursor) < Math.abs(best.t_s - this.cursor) ? row : best));
    setText(byId("readout"), near === null ? "" : text("readStroke", { time: timeOf(near.t_s), stroke: mm(near.displacement_mm), sigma: mm(near.sigma_mm), velocity: speed(near.velocity_mm_s) }));
  }
}

const isNumber = (value) => typeof value === "number";

function course(rows, name) {
  return rows.filter((row) => isNumber(row[name])).map((row) => [row.t_s, row[name]]);
}

function around(rows, name, sigma) {
  return rows.filter((row) => isNumber(row[name]) && isNumber(row[sigma])).map((row) => [row.t_s, row[name] - BAND * row[sigma], row[name] + BAND * row[sigma]]);
}

/** Each reading once, at its own time. */
function readings(rows) {
  const seen = rows.filter((row, i) => isNumber(row.observed_mm) && row.observed_s !== rows[i - 1]?.observed_s);
  return seen.map((row) => [row.observed_s, row.observed_mm]);
}

function axisTime(t) {
  return moment(t).toLocaleTimeString("en-GB");
}
