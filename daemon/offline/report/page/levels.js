// Level of detail: of what is visible, every sample where it is kept and fits, else the envelope in coarser cells.

export const MOST_POINTS = 4000;

// First place in sorted `times` that is not before `t`.
export function placeOf(times, t) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < t) low = middle + 1;
    else high = middle;
  }
  return low;
}

function cellsOf(grid, from, until) {
  // Windows end where cells do, apart from rounding.
  const first = Math.max(0, Math.floor((from - grid.begin) / grid.cell + 1e-4));
  const last = Math.min(grid.cells, Math.ceil((until - grid.begin) / grid.cell - 1e-4));
  return [Math.min(first, grid.cells), Math.max(first, last)];
}

// Cells grouped so that two points each are no more than `most`.
function grouped(grid, from, until, most) {
  const [first, last] = cellsOf(grid, from, until);
  return { fine: false, first, last, group: Math.max(1, Math.ceil((2 * (last - first)) / most)) };
}

// The pieces to draw between two times: runs of cells, and samples where `times` holds all of them.
export function plan(record, times, from, until, most = MOST_POINTS) {
  const { grid, windows } = record;
  const pieces = [];
  let points = 0;
  let at = from;
  for (const [begin, end] of times === null ? [] : windows) {
    if (end < from || begin > until) continue;
    if (begin > at) pieces.push({ ...grouped(grid, at, begin, Infinity), group: 1 });
    const first = placeOf(times, Math.max(begin, from));
    const last = placeOf(times, Math.min(end, until) + 1e-9);
    pieces.push({ fine: true, first, last });
    at = end;
  }
  if (at < until) pieces.push({ ...grouped(grid, at, until, Infinity), group: 1 });
  for (const piece of pieces) points += (piece.fine ? 1 : 2) * (piece.last - piece.first);
  return points <= most ? pieces : [grouped(grid, from, until, most)];
}

// Calls `take(time, width, low, high)` for each group of a run of cells; NaN where there are no samples.
function eachGroup(grid, piece, lows, highs, take) {
  for (let i = piece.first; i < piece.last; i += piece.group) {
    let low = NaN;
    let high = NaN;
    const end = Math.min(i + piece.group, piece.last);
    for (let j = i; j < end; j++) {
      if (!(lows[j] >= low) && !Number.isNaN(lows[j])) low = lows[j];
      if (!(highs[j] <= high) && !Number.isNaN(highs[j])) high = highs[j];
    }
    take(grid.begin + i * grid.cell, (end - i) * grid.cell, low, high, i);
  }
}

// A line through lows and highs, in the order in which the signal runs; every sample where they are kept.
// The half width of its band, if it has one, comes along for the label.
export function line(record, signal, from, until) {
  const made = { x: [], y: [], half: signal.half ? [] : null, fine: false };
  let before = NaN;
  for (const piece of plan(record, signal.fine ? record.fine : null, from, until)) {
    if (piece.fine) {
      made.fine = true;
      for (let i = piece.first; i < piece.last; i++) {
        made.x.push(record.fine[i]);
        made.y.push(signal.fine[i]);
        made.half?.push(signal.half_fine[i]);
      }
      continue;
    }
    eachGroup(record.grid, piece, signal.low, signal.high, (t, width, low, high, cell) => {
      const falling = (low + high) / 2 < before;
      before = (low + high) / 2;
      made.x.push(t + 0.02 * width, t + 0.98 * width);
      made.y.push(falling ? high : low, falling ? low : high);
      made.half?.push(signal.half[cell], signal.half[cell]);
    });
  }
  return made;
}

// The outline of a signal's band: there above, back below, anew behind each hole.
export function band(record, signal, from, until) {
  const made = { x: [], y: [] };
  let run = [];
  const close = () => {
    if (run.length > 1) {
      for (const [t, , high] of run) made.x.push(t), made.y.push(high);
      for (const [t, low] of run.reverse()) made.x.push(t), made.y.push(low);
      made.x.push(NaN);
      made.y.push(NaN);
    }
    run = [];
  };
  const take = (t, low, high) => (Number.isNaN(low + high) ? close() : run.push([t, low, high]));
  for (const piece of plan(record, record.fine, from, until)) {
    if (piece.fine) {
      for (let i = piece.first; i < piece.last; i++) {
        take(record.fine[i], signal.fine[i] - signal.half_fine[i], signal.fine[i] + signal.half_fine[i]);
      }
    } else {
      eachGroup(record.grid, piece, signal.bandLow, signal.bandHigh, (t, width, low, high) => take(t + width / 2, low, high));
    }
  }
  close();
  return made;
}

// Two lines, the lowest lows and the highest highs.
export function limits(record, signal, from, until) {
  const made = { x: [], low: [], high: [] };
  for (const piece of plan(record, null, from, until)) {
    eachGroup(record.grid, piece, signal.low, signal.high, (t, width, low, high) => {
      made.x.push(t + width / 2);
      made.low.push(low);
      made.high.push(high);
    });
  }
  return made;
}

// Readings as points; each ill one with its word.
export function points(record, readings, from, until, ill) {
  const made = { x: [], y: [], words: [] };
  for (const piece of plan(record, readings.times, from, until)) {
    if (piece.fine) {
      for (let i = piece.first; i < piece.last; i++) {
        if (readings.words[i] > 0 !== ill) continue;
        made.x.push(readings.times[i]);
        made.y.push(readings.values[i]);
        made.words.push(record.words[readings.words[i]]);
      }
      continue;
    }
    const { low: lows, high: highs } = ill ? readings.ill : readings.good;
    eachGroup(record.grid, piece, lows, highs, (t, width, low, high, cell) => {
      const word = ill ? Math.max(...readings.illWords.subarray(cell, cell + piece.group)) : 0;
      if (Number.isNaN(low)) return;
      for (const value of low === high ? [low] : [low, high]) {
        made.x.push(t + width / 2);
        made.y.push(value);
        made.words.push(record.words[word]);
      }
    });
  }
  return made;
}

// A column of one value a second; the largest of each group where they are too many.
export function column(times, values, from, until) {
  const first = Math.max(0, placeOf(times, from) - 1);
  const last = Math.min(times.length, placeOf(times, until) + 1);
  const group = Math.max(1, Math.ceil((2 * (last - first)) / MOST_POINTS));
  const made = { x: [], y: [] };
  for (let i = first; i < last; i += group) {
    const part = values.subarray(i, Math.min(i + group, last));
    const [low, high] = [Math.min(...part), Math.max(...part)];
    made.x.push(times[i]);
    made.y.push(low);
    if (low !== high) made.x.push(times[i]), made.y.push(high);
  }
  return made;
}
