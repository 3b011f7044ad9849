// A plot of lines, bands and dots over time on a canvas.

const LEFT = 52;
const BOTTOM = 20;
const TOP = 6;
const RIGHT = 8;
const GAP_S = 0.5; // a line does not bridge more
const FONT = "12px system-ui, sans-serif";

export class Chart {
  /** leastSpan: the ordinate never shows less, so that noise does not fill the plot. */
  constructor(canvas, leastSpan) {
    this.canvas = canvas;
    this.leastSpan = leastSpan;
    this.pen = canvas.getContext("2d");
  }

  /**
   * series: [{kind: "line" | "limits" | "band" | "dots", colour, points: [[t, value] or [t, low, high]]}]
   * timeWords(t): label of a moment. roundS: a moment at which the clock on the wall shows a full minute. cursor: a moment to mark, or null.
   */
  draw({ from, to, series, timeWords, roundS, colours, cursor }) {
    this.fit();
    const pen = this.pen;
    const shown = series.map((one) => ({ ...one, points: within(one.points, from, to) }));
    this.from = from;
    this.to = to;
    [this.low, this.high, this.step] = bounds(shown, this.leastSpan, Math.max(2, Math.floor(this.height / 45)));
    pen.clearRect(0, 0, this.width, this.height);
    this.drawGrid(colours, timeWords, roundS);
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP, this.width - LEFT - RIGHT, this.height - TOP - BOTTOM);
    pen.clip();
    for (const one of shown) this[one.kind](one.points, one.colour);
    if (cursor !== null) this.mark(cursor, colours);
    pen.restore();
  }

  /** The moment under a point of the screen. */
  momentAt(clientX) {
    const box = this.canvas.getBoundingClientRect();
    const share = (clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return this.from + Math.min(Math.max(share, 0), 1) * (this.to - this.from);
  }

  fit() {
    const ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    const [width, height] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  x(t) {
    return LEFT + ((t - this.from) / (this.to - this.from)) * (this.width - LEFT - RIGHT);
  }

  y(value) {
    return this.height - BOTTOM - ((value - this.low) / (this.high - this.low)) * (this.height - TOP - BOTTOM);
  }

  drawGrid(colours, timeWords, roundS) {
    const pen = this.pen;
    pen.font = FONT;
    pen.fillStyle = colours.soft;
    pen.strokeStyle = colours.grid;
    pen.lineWidth = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const digits = Math.max(0, -Math.floor(Math.log10(this.step) + 1e-9));
    for (let i = Math.ceil(this.low / this.step - 1e-6); i * this.step <= this.high + 1e-9; i++) {
      const y = Math.round(this.y(i * this.step)) + 0.5;
      this.path([[LEFT, y], [this.width - RIGHT, y]]);
      pen.fillText((i * this.step).toFixed(digits).replace("-", "−"), LEFT - 6, y);
    }
    pen.textBaseline = "alphabetic";
    const every = this.width < 500 ? 20 : 10;
    for (let t = roundS + Math.ceil((this.from - roundS) / every) * every; t <= this.to; t += every) {
      const x = Math.round(this.x(t)) + 0.5;
      this.path([[x, TOP], [x, this.height - BOTTOM]]);
      pen.textAlign = x > this.width - 36 ? "right" : x < LEFT + 30 ? "left" : "center";
      pen.fillText(timeWords(t), x, this.height - 6);
    }
  }

  path(points) {
    this.pen.beginPath();
    points.forEach(([x, y], i) => (i ? this.pen.lineTo(x, y) : this.pen.moveTo(x, y)));
    this.pen.stroke();
  }

  line(points, colour, width = 2) {
    this.pen.strokeStyle = colour;
    this.pen.lineWidth = width;
    this.pen.lineJoin = "round";
    for (const run of runs(points)) this.path(run.map(([t, value]) => [this.x(t), this.y(value)]));
  }

  limits(points, colour) {
    this.pen.setLineDash([6, 4]);
    for (const side of [1, 2]) this.line(points.map((point) => [point[0], point[side]]), colour, 1.5);
    this.pen.setLineDash([]);
  }

  band(points, colour) {
    const pen = this.pen;
    pen.fillStyle = colour;
    for (const run of runs(points)) {
      pen.beginPath();
      for (const [t, low] of run) pen.lineTo(this.x(t), this.y(low));
      for (const [t, , high] of run.toReversed()) pen.lineTo(this.x(t), this.y(high));
      pen.fill();
    }
  }

  dots(points, colour) {
    const pen = this.pen;
    pen.fillStyle = colour;
    for (const [t, value] of points) {
      const [x, y] = [this.x(t), this.y(value)];
      pen.beginPath();
      pen.moveTo(x - 3, y);
      pen.lineTo(x, y - 3);
      pen.lineTo(x + 3, y);
      pen.lineTo(x, y + 3);
      pen.fill();
    }
  }

  mark(t, colours) {
    this.pen.strokeStyle = colours.ink;
    this.pen.lineWidth = 1;
    this.path([[this.x(t), TOP], [this.x(t), this.height - BOTTOM]]);
  }
}

function within(points, from, to) {
  return points.filter(([t]) => t >= from - 1 && t <= to);
}

function* runs(points) {
  let run = [];
  for (const point of points) {
    if (run.length && point[0] - run.at(-1)[0] > GAP_S) {
      yield run;
      run = [];
    }
    run.push(point);
  }
  if (run.length) yield run;
}

/** Round ends of the ordinate that hold everything, and the distance of its marks. */
export function bounds(series, leastSpan, marks) {
  let [low, high] = [Infinity, -Infinity];
  for (const { points } of series) {
    for (const [, ...values] of points) {
      low = Math.min(low, ...values);
      high = Math.max(high, ...values);
    }
  }
  if (low > high) [low, high] = [0, leastSpan];
  const missing = leastSpan - (high - low);
  if (missing > 0) [low, high] = [low - missing / 2, high + missing / 2];
  const rough = (high - low) / marks;
  const magnitude = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((one) => one * magnitude >= rough - 1e-12) * magnitude;
  const fine = step / 5;
  return [Math.floor(low / fine - 0.5) * fine, Math.ceil(high / fine + 0.5) * fine, step];
}
