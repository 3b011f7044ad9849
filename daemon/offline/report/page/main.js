// Puts each recording's plots on the page, when its tab is first shown, and joins tables and plots.

import { decoded } from "report/decoding.js";
import { element, Figure } from "report/figures.js";
import { listen } from "report/gestures.js";
import { toolbar } from "report/keys.js";
import { Lanes } from "report/lanes.js";
import { panelsOf } from "report/panels.js";
import { onChange } from "report/theme.js";
import { Timeline } from "report/timeline.js";

const chapters = [];

function timeText(record, seconds) {
  const { wall, zero } = record.clock;
  if (!wall) return `${(zero / 1e3 + seconds).toFixed(2)} s`;
  return new Date(zero + seconds * 1e3).toISOString().slice(11, 22);
}

class Chapter {
  constructor(section, numbers) {
    this.section = section;
    this.numbers = numbers;
    this.figures = [];
  }

  open() {
    if (this.figures.length > 0) return;
    const record = (this.record = decoded(this.numbers));
    const timeline = (this.timeline = new Timeline(record.length, record.marks));
    const region = (this.region = this.section.querySelector(".plots"));
    for (const [name, value] of Object.entries({ tabindex: "0", role: "region", "aria-label": "Plots over time" })) {
      region.setAttribute(name, value);
    }
    const told = (from, until) => `${timeText(record, from)} – ${timeText(record, until)} (${record.clock.name})`;
    region.append(toolbar(region, timeline, told));
    region.append(element("p", { class: "under help" }, "Drag sideways to zoom, double click for the whole. Keys: + − ← → zoom and move, n and p next and previous move, 0 whole. Full line: onset; dotted line: stop; shaded: moving (dark VVS, light CVS)."));
    for (const panel of panelsOf(record)) {
      this.figures.push(new (panel.lanes ? Lanes : Figure)(panel, record, timeline, region));
    }
    timeline.listeners.push(() => this.refresh());
    listen(region, timeline, (seconds) => this.hover(seconds));
    this.watch();
    for (const button of this.section.querySelectorAll("button.zoom")) {
      const row = button.closest("tr") ?? button;
      row.addEventListener("click", () => this.look(button));
    }
  }

  // Plots are drawn when they are seen, or about to be.
  watch() {
    const byPlot = new Map(this.figures.map((figure) => [figure.plot, figure]));
    const onlooker = new IntersectionObserver((entries) => {
      for (const entry of entries) byPlot.get(entry.target).seen(entry.isIntersecting);
    }, { rootMargin: "120px" });
    for (const figure of this.figures) onlooker.observe(figure.plot);
    let width = this.region.clientWidth;
    new ResizeObserver(() => {
      if (this.region.clientWidth === width || this.region.clientWidth === 0) return;
      width = this.region.clientWidth;
      this.refresh();
    }).observe(this.region);
  }

  refresh() {
    for (const figure of this.figures) figure.refresh();
  }

  drawAll() {
    for (const figure of this.figures) figure.draw();
  }

  hover(seconds) {
    for (const figure of this.figures) {
      if (figure.isSeen && figure.traces?.length) Plotly.Fx.hover(figure.plot, { xval: figure.x(seconds) });
    }
  }

  look(button) {
    const [from, until] = [Number(button.dataset.from), Number(button.dataset.until)];
    for (const other of this.section.querySelectorAll("[data-shown]")) delete other.dataset.shown;
    (button.closest("tr, li") ?? button).dataset.shown = "";
    this.timeline.look(from, until);
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.region.scrollIntoView({ behavior: still ? "auto" : "smooth", block: "start" });
    this.region.focus({ preventScroll: true });
  }
}

function choose(number) {
  document.querySelectorAll('[role="tab"]').forEach((tab, i) => {
    tab.setAttribute("aria-selected", String(i === number));
    tab.tabIndex = i === number ? 0 : -1;
  });
  chapters.forEach((chapter, i) => (chapter.section.hidden = i !== number));
  chapters[number].open();
}

function start() {
  document.querySelectorAll("section.chapter").forEach((section, i) => {
    chapters.push(new Chapter(section, document.getElementById(`numbers-${i}`)));
  });
  const tabs = [...document.querySelectorAll('[role="tab"]')];
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => choose(i));
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step === undefined) return;
      const next = (i + step + tabs.length) % tabs.length;
      tabs[next].focus();
      choose(next);
    });
  });
  choose(0);
  const redraw = () => chapters.filter((chapter) => chapter.figures.length).forEach((chapter) => chapter.refresh());
  onChange(redraw);
  matchMedia("print").addEventListener("change", () => chapters.find((chapter) => !chapter.section.hidden)?.drawAll());
  globalThis.ramstroke = { chapters };
}

start();
