// The stretch of time that all plots of a recording show.

const LEAST_S = 0.05;

export class Timeline {
  constructor(length, marks) {
    this.length = Math.max(length, LEAST_S);
    this.marks = marks;
    this.from = 0;
    this.until = this.length;
    this.listeners = [];
  }

  get width() {
    return this.until - this.from;
  }

  show(from, until) {
    const width = Math.min(Math.max(until - from, LEAST_S), this.length);
    const begin = Math.min(Math.max((from + until - width) / 2, 0), this.length - width);
    if (begin === this.from && begin + width === this.until) return;
    this.from = begin;
    this.until = begin + width;
    for (const listener of this.listeners) listener();
  }

  whole() {
    this.show(0, this.length);
  }

  // Factor below 1: nearer; `at` stays where it is.
  zoom(factor, at = (this.from + this.until) / 2) {
    this.show(at - (at - this.from) * factor, at + (this.until - at) * factor);
  }

  shift(share) {
    const by = Math.max(-this.from, Math.min(share * this.width, this.length - this.until));
    this.show(this.from + by, this.until + by);
  }

  // A stretch with some air around it; a moment with some seconds.
  look(from, until) {
    const air = Math.max(2, 0.1 * (until - from));
    this.show(from - air, until + air);
  }

  // The next move behind (+1) or before (-1) the middle of what is shown.
  step(direction) {
    const middle = (this.from + this.until) / 2;
    const centre = (mark) => (mark.onset + mark.end) / 2;
    const shown = this.marks.findIndex((mark) => Math.abs(centre(mark) - middle) < 0.01 * this.width);
    const ahead = direction > 0
      ? this.marks.findIndex((mark) => centre(mark) > middle)
      : this.marks.findLastIndex((mark) => centre(mark) < middle);
    const next = this.marks[this.width === this.length ? (direction > 0 ? 0 : this.marks.length - 1)
      : shown >= 0 ? shown + direction : ahead];
    if (next !== undefined) this.look(next.onset, next.end);
  }
}
