// Segments and the state of each part as lanes: a pattern, a colour and, where there is room, the word.

import { element, MARGIN } from "report/figures.js";
import { colours } from "report/theme.js";

const SPACE = "http://www.w3.org/2000/svg";
const ROW = 24;
const GAP = 5;
const NAMED = 16;
const LETTER_PX = 7.2;
const SEGMENTS = { ZUPT: "rest (ZUPT)", VVS: "varying speed (VVS)", CVS: "constant speed (CVS)" };
const LOOKS = { ok: "plain", "rest (ZUPT)": "plain", "constant speed (CVS)": "cvs", "varying speed (VVS)": "vvs", off: "plain", absent: "dots", waiting: "dots" };

let made = 0;

function shape(name, attributes, text = "") {
  const one = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
  one.textContent = text;
  return one;
}

export class Lanes {
  constructor(panel, record, timeline, host) {
    Object.assign(this, { panel, record, timeline });
    this.isSeen = false;
    this.isDue = true;
    this.id = `lanes-${made++}`;
    const segments = record.segments.map(([begin, end, word]) => [begin, end, SEGMENTS[word], ""]);
    const gaps = record.gaps.map(([begin, end]) => [begin, end, "gap", `no samples for ${(end - begin).toFixed(3)} s`]);
    this.rows = [
      ...(segments.length ? [{ name: "segment", spans: segments }] : []),
      ...(gaps.length ? [{ name: "gaps in the samples", spans: gaps }] : []),
      ...record.lanes,
    ];
    this.plot = element("div", { class: "plot lanes", "data-panel": panel.key });
    this.said = element("p", { class: "under", "aria-live": "off" });
    this.box = element(
      "figure",
      { role: "group", "aria-label": `${panel.title}: lanes over time; the list of events says the same in words` },
      element("figcaption", {}, element("strong", {}, panel.title)),
      this.plot,
      this.said,
      this.inWords(),
    );
    host.append(this.box);
    this.plot.addEventListener("pointermove", (event) => this.tell(event));
    this.plot.addEventListener("pointerdown", (event) => this.tell(event));
  }

  // The same for those who do not see it.
  inWords() {
    const list = element("ul");
    for (const { name, spans } of this.rows) {
      if (name === "segment") continue;
      const seconds = new Map();
      for (const [begin, end, word] of spans) seconds.set(word, (seconds.get(word) ?? 0) + end - begin);
      const words = [...seconds].map(([word, s]) => `${word} ${s.toFixed(1)} s`).join(", ");
      list.append(element("li", {}, `${name}: ${words}`));
    }
    return element("details", {}, element("summary", {}, "The lanes in words"), list);
  }

  refresh() {
    this.isDue = true;
    if (this.isSeen) this.draw();
  }

  seen(isSeen) {
    this.isSeen = isSeen;
    if (isSeen && this.isDue) this.draw();
  }

  // What lies under the pointer, in words.
  tell(event) {
    const span = event.target.closest?.("[data-said]");
    this.said.textContent = span ? span.dataset.said : "";
  }

  draw(paint = colours(this.plot)) {
    this.isDue = false;
    const width = this.plot.clientWidth;
    const room = width - MARGIN.l - MARGIN.r;
    const height = this.rows.length * (ROW + NAMED + GAP) + GAP;
    const svg = shape("svg", { width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
    svg.append(this.patterns(paint));
    this.rows.forEach((row, i) => {
      const y = GAP + i * (ROW + NAMED + GAP);
      svg.append(shape("text", { x: MARGIN.l, y: y + 12, fill: paint.ink, class: "lane" }, row.name));
      svg.append(shape("rect", { x: MARGIN.l, y: y + NAMED, width: room, height: ROW, fill: "none", stroke: paint.line }));
      for (const span of this.merged(row.spans, room)) svg.append(...this.drawn(span, row.name, y + NAMED, room, paint));
    });
    this.plot.replaceChildren(svg);
  }

  // Visible spans; those too narrow to see join into one that says how many they are.
  merged(spans, room) {
    const { from, until, width } = this.timeline;
    const found = [];
    for (const [begin, end, word, what] of spans) {
      if (end <= from || begin >= until) continue;
      const last = found[found.length - 1];
      const narrow = ((end - begin) / width) * room < 1.5;
      if (narrow && last?.narrow && last.word === word && ((begin - last.end) / width) * room < 1) {
        last.end = end;
        last.count += 1;
      } else {
        found.push({ begin, end, word, what, narrow, count: 1 });
      }
    }
    return found;
  }

  drawn({ begin, end, word, what, count }, lane, y, room, paint) {
    const { from, until, width } = this.timeline;
    const x0 = MARGIN.l + ((Math.max(begin, from) - from) / width) * room;
    const x1 = MARGIN.l + ((Math.min(end, until) - from) / width) * room;
    const wide = Math.max(x1 - x0, 1.5);
    const look = LOOKS[word] ?? "ill";
    const said = `${lane}: ${word}${count > 1 ? ` (${count} times)` : ""}, ${(end - begin).toFixed(2)} s${what ? `; ${what}` : ""}`;
    const rect = shape("rect", {
      x: x0, y, width: wide, height: ROW, fill: `url(#${this.id}-${look})`, stroke: paint.soft, "stroke-width": wide > 4 ? 0.6 : 0,
      "data-said": said,
    });
    rect.append(shape("title", {}, said));
    const label = word.length * LETTER_PX + 10 < wide ? word : "";
    if (!label) return [rect];
    const back = shape("rect", {
      x: x0 + wide / 2 - (word.length * LETTER_PX) / 2 - 4, y: y + 4, width: word.length * LETTER_PX + 8, height: ROW - 8,
      rx: 3, fill: paint.paper, "pointer-events": "none",
    });
    return [rect, back, shape("text", { x: x0 + wide / 2, y: y + ROW / 2 + 4.5, fill: paint.ink, "text-anchor": "middle", "pointer-events": "none" }, label)];
  }

  patterns(paint) {
    const defs = shape("defs", {});
    const pattern = (look, size, ...shapes) => {
      const one = shape("pattern", { id: `${this.id}-${look}`, width: size, height: size, patternUnits: "userSpaceOnUse" });
      one.append(shape("rect", { width: size, height: size, fill: paint.paper }), ...shapes);
      defs.append(one);
    };
    const wash = (size, colour, opacity) => shape("rect", { width: size, height: size, fill: colour, "fill-opacity": opacity });
    const path = (d, colour, width) => shape("path", { d, stroke: colour, "stroke-width": width, fill: "none" });
    pattern("plain", 8, wash(8, paint.soft, 0.12));
    pattern("cvs", 8, wash(8, paint.cvs, 0.35), path("M0 4H8", paint.cvs, 1));
    pattern("vvs", 8, wash(8, paint.vvs, 0.55), path("M-2 2L2 -2M0 8L8 0M6 10L10 6", paint.vvs, 2));
    pattern("dots", 8, wash(8, paint.observed, 0.15), shape("circle", { cx: 4, cy: 4, r: 1.6, fill: paint.observed }));
    pattern("ill", 8, wash(8, paint.ill, 0.35), path("M0 0L8 8M0 8L8 0", paint.ill, 1.4));
    return defs;
  }
}
