// Fingers on the plots: sideways moves, two fingers zoom, up and down scrolls the page. Mouse: wheel with Ctrl zooms.

import { MARGIN } from "report/figures.js";

const MOVED_PX = 8;

export function listen(region, timeline, hover) {
  const fingers = new Map();
  let start = null;

  const room = () => region.clientWidth - MARGIN.l - MARGIN.r;
  const timeAt = (px) => {
    const share = (px - region.getBoundingClientRect().left - MARGIN.l) / room();
    return timeline.from + Math.min(Math.max(share, 0), 1) * timeline.width;
  };
  const place = () => {
    const xs = [...fingers.values()];
    const centre = xs.reduce((a, b) => a + b, 0) / xs.length;
    return { count: xs.length, centre, apart: xs.length > 1 ? Math.abs(xs[0] - xs[1]) : 0 };
  };
  const begin = () => {
    start = { ...place(), time: timeAt(place().centre), width: timeline.width, moved: false };
  };
  const isPlot = (event) => event.pointerType === "touch" && event.target.closest(".plot") !== null;

  region.addEventListener("pointerdown", (event) => {
    if (!isPlot(event)) return;
    fingers.set(event.pointerId, event.clientX);
    begin();
  });
  region.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    fingers.set(event.pointerId, event.clientX);
    const now = place();
    if (!start.moved && now.count === 1 && Math.abs(now.centre - start.centre) < MOVED_PX) return;
    start.moved = true;
    const width = now.count > 1 && start.apart > 0 ? (start.width * start.apart) / Math.max(now.apart, 1) : start.width;
    const share = (now.centre - region.getBoundingClientRect().left - MARGIN.l) / room();
    const from = Math.max(0, Math.min(start.time - share * width, timeline.length - width));
    timeline.show(from, from + width);
  });
  const end = (event) => {
    if (!fingers.delete(event.pointerId)) return;
    if (event.type === "pointerup" && start !== null && !start.moved) hover(timeAt(event.clientX));
    if (fingers.size > 0) begin();
  };
  region.addEventListener("pointerup", end);
  region.addEventListener("pointercancel", end);

  region.addEventListener("wheel", (event) => {
    if (!event.ctrlKey || event.target.closest(".plot") === null) return;
    event.preventDefault();
    timeline.zoom(Math.exp(event.deltaY * 0.004), timeAt(event.clientX));
  }, { passive: false });
}
