// The ram, drawn to scale: the rod comes out as the stroke grows.

import { byId, makeSvg, setText } from "./dom.js";
import { mm } from "./format.js";
import { strokeWords } from "./stroke.js";
import { text } from "./words.js";

const LEFT = 210; // of the drawing, where the stroke is zero
const LENGTH = 590;
const TOP = 22;
const BAND = 1.96;

export class Ram {
  constructor() {
    this.rod = makeSvg("rect", { class: "ram-rod", x: LEFT, y: TOP + 32, height: 26 });
    this.band = makeSvg("rect", { class: "ram-band", y: TOP - 6, height: 102 });
    this.end = makeSvg("path", { class: "ram-end", d: `M-6 ${TOP} h12 v76 h40 v14 h-52 z` });
    this.observed = makeSvg("path", { class: "ram-observed", d: `M0 ${TOP + 104} l14 22 h-28 z` });
    this.observedWord = makeSvg("text", { class: "ram-observed-text", x: 20, y: TOP + 125 });
    this.support = makeSvg("text", { class: "ram-text", x: 105, y: TOP + 126 });
    this.conveyor = makeSvg("text", { class: "ram-text ram-conveyor", x: 56, y: TOP + 54 });
    this.scale = makeSvg("g");
    this.svg = makeSvg(
      "svg",
      { viewBox: "0 0 1000 212", role: "img" },
      makeSvg("rect", { class: "ram-steel", x: 10, y: TOP - 6, width: 34, height: 102, rx: 4 }),
      makeSvg("rect", { class: "ram-steel", x: 40, y: TOP + 14, width: LEFT - 40, height: 62, rx: 6 }),
      this.scale, this.band, this.rod, this.end, this.observed, this.observedWord, this.support, this.conveyor,
    );
    byId("ram").append(this.svg);
    this.strokeMm = 0;
  }

  show(model) {
    if (model.hello === null) return;
    this.setScale(model.hello.stroke_mm);
    const estimate = model.estimate;
    const known = estimate !== null && !model.undetermined;
    for (const part of [this.rod, this.end, this.conveyor]) part.style.visibility = known ? "visible" : "hidden";
    this.band.style.visibility = estimate === null ? "hidden" : "visible";
    if (estimate !== null) {
      const x = this.at(estimate.displacement_mm);
      const half = BAND * estimate.sigma_mm;
      const [low, high] = model.undetermined ? [LEFT, LEFT + LENGTH] : [this.at(estimate.displacement_mm - half), this.at(estimate.displacement_mm + half)];
      this.rod.setAttribute("width", Math.max(0, x - LEFT));
      this.end.setAttribute("transform", `translate(${x} 0)`);
      this.conveyor.setAttribute("transform", `translate(${x} 0)`);
      this.band.setAttribute("x", low);
      this.band.setAttribute("width", Math.max(0, high - low));
    }
    this.showObserved(estimate);
  }

  showObserved(estimate) {
    const seen = estimate?.observed_mm ?? null;
    for (const part of [this.observed, this.observedWord]) {
      part.style.visibility = seen === null ? "hidden" : "visible";
      if (seen !== null) part.setAttribute("transform", `translate(${this.at(seen)} 0)`);
    }
  }

  /** Once a second is often enough for words. */
  showWords(model) {
    for (const [part, name] of [[this.support, "support"], [this.conveyor, "conveyor"], [this.observedWord, "reported"]]) setText(part, text(name));
    this.svg.setAttribute("aria-label", text("ramAbout", { stroke: model.undetermined || !model.estimate ? strokeWords(model) : `${mm(model.estimate.displacement_mm)} mm` }));
  }

  at(strokeMm) {
    return LEFT + (LENGTH * Math.min(Math.max(strokeMm, -30), this.strokeMm + 30)) / this.strokeMm;
  }

  setScale(strokeMm) {
    if (this.strokeMm === strokeMm) return;
    this.strokeMm = strokeMm;
    const step = strokeMm > 1200 ? 500 : strokeMm > 250 ? 100 : 20;
    const marks = [];
    for (let mark = 0; mark <= strokeMm + 1e-6; mark += step) {
      marks.push(makeSvg("path", { class: "ram-scale", d: `M${this.at(mark)} ${TOP + 138} v14` }));
      const label = makeSvg("text", { class: "ram-text", x: this.at(mark), y: TOP + 182 });
      label.textContent = mark;
      marks.push(label);
    }
    marks.push(makeSvg("path", { class: "ram-scale", d: `M${LEFT} ${TOP + 138} H${LEFT + LENGTH}` }));
    this.scale.replaceChildren(...marks);
  }
}
