// One plot on the page: drawn when it is seen, and again when the shown stretch or the choice of series changes.

import { colours, faded } from "report/theme.js";

export const MARGIN = { l: 58, r: 12, t: 6, b: 24 };
// The date stands at the head of the page.
const TICKS = [
  { dtickrange: [null, 1000], value: "%H:%M:%S.%L" },
  { dtickrange: [1000, 60000], value: "%H:%M:%S" },
  { dtickrange: [60000, "M1"], value: "%H:%M" },
];
const MOST_SHAPES = 160;
const LABEL_PX = 74;
const CONFIG = { displayModeBar: false, responsive: false, doubleClick: false, scrollZoom: false };

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// Shows a legend entry as it is drawn: a line with its dashes, a point with its shape, a band.
function swatch(series) {
  const space = "http://www.w3.org/2000/svg";
  const made = document.createElementNS(space, "svg");
  const dashes = { solid: "", dash: "6 3", dot: "2 3", dashdot: "6 2 2 2", longdash: "10 3" };
  const drawings = {
    line: `<line x1="0" x2="26" y1="7" y2="7" stroke-width="2.5" stroke-dasharray="${dashes[series.dash ?? "solid"]}"/>`,
    band: '<rect x="0" y="2" width="26" height="10" fill-opacity=".3" stroke="none"/>',
    circle: '<circle cx="13" cy="7" r="3"/>',
    "x-thin": '<path d="M9 3l8 8m0-8l-8 8" stroke-width="2.5"/>',
  };
  const isDot = series.mark !== "line" && series.mark !== "band";
  made.setAttribute("viewBox", isDot ? "8 0 10 14" : "0 0 26 14");
  if (isDot) made.setAttribute("class", "dot");
  made.setAttribute("aria-hidden", "true");
  made.setAttribute("style", `color: var(--${series.colour})`);
  made.innerHTML = drawings[series.mark];
  return made;
}

export class Figure {
  constructor(panel, record, timeline, host) {
    Object.assign(this, { panel, record, timeline });
    this.isSeen = false;
    this.isDue = true;
    this.plot = element("div", { class: "plot", "data-panel": panel.key });
    this.plot.style.height = `${panel.height}px`;
    this.box = element(
      "figure",
      { role: "group", "aria-label": `${panel.title}: a plot over time; the table of moves and the list of events say the same in words` },
      element("figcaption", {}, element("strong", {}, panel.title), ` [${panel.unit}] `, this.legend()),
      this.plot,
    );
    host.append(this.box);
  }

  legend() {
    const made = element("span", { class: "legend" });
    for (const series of this.panel.series) {
      const box = element("input", { type: "checkbox" });
      box.checked = series.on;
      box.addEventListener("change", () => {
        series.on = box.checked;
        this.draw();
      });
      made.append(element("label", { "data-series": series.key }, box, swatch(series), series.name));
    }
    return made;
  }

  // Draws now if it can be seen, else when it is.
  refresh() {
    this.isDue = true;
    if (this.isSeen) this.draw();
  }

  seen(isSeen) {
    this.isSeen = isSeen;
    if (isSeen && this.isDue) this.draw();
  }

  x(seconds) {
    const { clock } = this.record;
    return clock.wall ? clock.zero + seconds * 1e3 : clock.zero / 1e3 + seconds;
  }

  second(x) {
    const { clock } = this.record;
    if (!clock.wall) return x - clock.zero / 1e3;
    const ms = typeof x === "number" ? x : Date.parse(`${x.replace(" ", "T")}Z`);
    return (ms - clock.zero) / 1e3;
  }

  get width() {
    return this.plot.clientWidth - MARGIN.l - MARGIN.r;
  }

  draw(paint = colours(this.plot)) {
    this.isDue = false;
    const { from, until, width } = this.timeline;
    const air = 0.02 * width;
    const x = (t) => this.x(t);
    this.traces = this.panel.series
      .filter((series) => series.on)
      .flatMap((series) => series.traces(this.record, from - air, until + air, paint)
        .map((trace) => ({ ...trace, x: trace.x.map(x), type: "scatter", connectgaps: false })));
    const range = [x(from), x(until)];
    const isTouch = matchMedia("(pointer: coarse)").matches;
    const axis = { gridcolor: paint.line, zerolinecolor: paint.soft, linecolor: paint.soft, color: paint.soft };
    const layout = {
      height: this.panel.height, width: this.plot.clientWidth, margin: MARGIN, showlegend: false,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: 12, color: paint.soft },
      hovermode: "x unified", hoverdistance: 30, dragmode: isTouch ? false : "zoom",
      hoverlabel: { bgcolor: paint.paper, bordercolor: paint.soft, font: { color: paint.ink } },
      xaxis: {
        ...axis, range, fixedrange: isTouch, type: this.record.clock.wall ? "date" : "linear",
        tickformatstops: TICKS,
        hoverformat: this.record.clock.wall ? "%H:%M:%S.%L" : ".3f", ticksuffix: this.record.clock.wall ? "" : " s",
        nticks: Math.max(3, Math.floor(this.width / 110)), separatethousands: false,
      },
      yaxis: { ...axis, fixedrange: true, automargin: false, nticks: Math.max(3, Math.floor(this.panel.height / 40)), ...(this.panel.bounds ? { autorangeoptions: { clipmin: this.panel.bounds[0], clipmax: this.panel.bounds[1] } } : {}) },
      shapes: this.panel.marked ? [...this.shades(paint), ...this.lines(paint)] : [],
      annotations: this.panel.named ? this.labels(paint) : [],
    };
    const isNew = !this.plot.data;
    Plotly.react(this.plot, this.traces, layout, CONFIG);
    if (isNew) {
      this.plot.on("plotly_relayout", (change) => this.follow(change));
      this.plot.on("plotly_doubleclick", () => this.timeline.whole());
    }
  }

  // The mouse has chosen another stretch.
  follow(change) {
    const [from, until] = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    if (from !== undefined && until !== undefined) this.timeline.show(this.second(from), this.second(until));
  }

  visible(begin, end) {
    const { from, until, width } = this.timeline;
    return end > from && begin < until && ((end - begin) / width) * this.width >= 0.7;
  }

  shades(paint) {
    const shown = this.record.segments.filter(([begin, end, word]) => word !== "ZUPT" && this.visible(begin, end));
    if (shown.length > MOST_SHAPES) return [];
    return shown.map(([begin, end, word]) => ({
      type: "rect", xref: "x", yref: "paper", x0: this.x(begin), x1: this.x(end), y0: 0, y1: 1, layer: "below",
      line: { width: 0 }, fillcolor: faded(word === "VVS" ? paint.vvs : paint.cvs, word === "VVS" ? 0.22 : 0.12),
    }));
  }

  // Change points: a full line where a move began, a dotted one where it began to stop.
  lines(paint) {
    const { from, until } = this.timeline;
    const made = [];
    for (const mark of this.record.marks) {
      for (const [t, dash] of [[mark.onset, "solid"], [mark.stop, "dot"]]) {
        if (t < from || t > until) continue;
        made.push({
          type: "line", xref: "x", yref: "paper", x0: this.x(t), x1: this.x(t), y0: 0, y1: 1,
          line: { color: paint.soft, width: 1, dash },
        });
      }
    }
    return made.length > MOST_SHAPES ? [] : made;
  }

  labels(paint) {
    const { from, until, width } = this.timeline;
    let free = -Infinity;
    const made = [];
    for (const mark of this.record.marks) {
      if (mark.end < from || mark.onset > until) continue;
      const at = Math.max(mark.onset, from);
      const px = ((at - from) / width) * this.width;
      if (px < free || px > this.width - LABEL_PX) continue;
      free = px + LABEL_PX;
      made.push({
        x: this.x(at), y: 1, xref: "x", yref: "paper", text: `${mark.kind} ${mark.number}`, showarrow: false,
        xanchor: "left", yanchor: "top", font: { size: 12, color: paint.ink }, bgcolor: faded(paint.paper, 0.7),
      });
    }
    return made;
  }
}
