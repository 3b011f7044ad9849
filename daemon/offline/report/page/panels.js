// What each plot shows: its series, with the traces they make of the visible stretch.

import { band, column, limits, line, points } from "report/levels.js";
import { faded } from "report/theme.js";

const DASHES = ["dash", "dot", "dashdot", "longdash"];

const number = (digits, unit) => `%{y:.${digits}f} ${unit}`;

function lineSeries(key, name, colour, signal, { digits = 2, unit = "mm", on = true, dash = "solid", width = 1.8 } = {}) {
  return {
    key, name, colour, dash, on, mark: "line",
    traces(record, from, until, paint) {
      const made = line(record, signal, from, until);
      return [{
        x: made.x, y: made.y, customdata: made.half, name, mode: "lines",
        line: { color: paint[colour], width, dash },
        hovertemplate: made.half === null ? number(digits, unit) : `%{y:.${digits}f} ± %{customdata:.${digits}f} ${unit} (95 %)`,
      }];
    },
  };
}

function bandSeries(key, name, colour, signal) {
  return {
    key, name, colour, on: true, mark: "band",
    traces(record, from, until, paint) {
      const made = band(record, signal, from, until);
      return [{
        x: made.x, y: made.y, name, mode: "lines", fill: "toself", fillcolor: faded(paint[colour], 0.22),
        line: { width: 0 }, hoverinfo: "skip",
      }];
    },
  };
}

function limitSeries(key, name, colour, signal, unit, digits) {
  return {
    key, name, colour, on: true, mark: "line", dash: "dash",
    traces(record, from, until, paint) {
      const made = limits(record, signal, from, until);
      const style = { mode: "lines", line: { color: paint[colour], width: 1.3, dash: "dash" }, hovertemplate: number(digits, unit) };
      return [
        { x: made.x, y: made.high, name: `upper ${name}`, ...style },
        { x: made.x, y: made.low, name: `lower ${name}`, ...style },
      ];
    },
  };
}

// Nonsense far outside the stroke is drawn at the edge; its label says what was read.
function pointSeries(key, name, colour, readings, { ill = false, on = true, symbol = "circle", size = 4, bounds = [-Infinity, Infinity] } = {}) {
  return {
    key, name, colour, on, mark: symbol,
    traces(record, from, until, paint) {
      const made = points(record, readings, from, until, ill);
      return [{
        x: made.x, y: made.y.map((y) => Math.min(Math.max(y, bounds[0]), bounds[1])), name, mode: "markers",
        customdata: ill ? made.y.map((y, i) => `${y.toFixed(1)} mm, ${made.words[i]}`) : null,
        marker: { color: paint[colour], size, symbol, line: { width: symbol === "x-thin" ? 1.6 : 0, color: paint[colour] } },
        hovertemplate: ill ? "%{customdata}" : number(1, "mm"),
      }];
    },
  };
}

function referenceSeries(readings) {
  return {
    key: "reference", name: "reference sensor", colour: "reference", dash: "dot", on: true, mark: "line",
    traces(record, from, until, paint) {
      const made = points(record, readings, from, until, false);
      return [{
        x: made.x, y: made.y, name: "reference sensor", mode: "lines",
        line: { color: paint.reference, width: 1.5, dash: "dot" }, hovertemplate: number(2, "mm"),
      }];
    },
  };
}

function columnSeries(key, name, colour, times, values, unit, { dash = "solid", shape = "linear", digits = 0, on = true } = {}) {
  return {
    key, name, colour, dash, on, mark: "line",
    traces(record, from, until, paint) {
      const made = column(times, values, from, until);
      return [{
        x: made.x, y: made.y, name, mode: "lines", line: { color: paint[colour], width: 1.6, dash, shape },
        hovertemplate: number(digits, unit),
      }];
    },
  };
}

function sum(values) {
  let total = 0;
  for (const value of values) total += value;
  return total;
}

function strokePanel(record) {
  const { signals, readings, others } = record;
  const bounds = [-0.2 * record.stroke_mm, 1.2 * record.stroke_mm];
  const series = [
    bandSeries("band", "stated 95 %", "estimate", signals.stroke),
  ];
  if (readings.observed !== null) {
    series.push(pointSeries("observed", "displacement sensor", "observed", readings.observed, { bounds }));
    if (readings.observed.illCount > 0) {
      series.push(pointSeries("ill", "its ill readings", "ill", readings.observed, { ill: true, symbol: "x-thin", size: 7, bounds }));
    }
  }
  if (readings.reference !== null) {
    series.push(referenceSeries(readings.reference));
  }
  series.push(lineSeries("smoothed", "smoothed", "smoothed", signals.smoothed, { dash: "dash", on: false }));
  series.push(lineSeries("stroke", "estimate (settled)", "estimate", signals.stroke));
  Object.entries(others).forEach(([name, signal], i) => {
    series.push(lineSeries(`other-${name}`, name, `other-${1 + (i % 4)}`, signal, { on: false, dash: DASHES[i % 4] }));
  });
  // A wide band, or a method that runs away, must not flatten the rest.
  const edges = [-0.5 * record.stroke_mm, 1.5 * record.stroke_mm];
  return { key: "stroke", title: "Stroke", unit: "mm", height: 320, marked: true, named: true, bounds: edges, series };
}

export function panelsOf(record) {
  const { signals, readings, tilt, rates } = record;
  const panels = [strokePanel(record)];
  if (readings.observed !== null) {
    panels.push({
      key: "innovation", title: "Reading minus prediction, and its gate", unit: "mm", height: 180, marked: true,
      bounds: [-1.2 * record.stroke_mm, 1.2 * record.stroke_mm],
      series: [
        limitSeries("gate", "gate", "limit", signals.gate, "mm", 1),
        lineSeries("innovation", "reading minus prediction", "observed", signals.innovation, { width: 1.2 }),
      ],
    });
  }
  panels.push({
    key: "velocity", title: "Speed", unit: "mm/s", height: 210, marked: true,
    series: [
      bandSeries("band", "stated 95 %", "estimate", signals.velocity),
      lineSeries("velocity", "speed (settled)", "estimate", signals.velocity, { unit: "mm/s" }),
    ],
  });
  panels.push({
    key: "acceleration", title: "Levelled acceleration along the push", unit: "m/s²", height: 210, marked: true,
    series: [
      lineSeries("acceleration", "acceleration", "estimate", signals.acceleration, { unit: "m/s²", digits: 3, width: 1 }),
      limitSeries("chart", "chart limit", "limit", signals.chart, "m/s²", 3),
    ],
  });
  panels.push({ key: "lanes", title: "Segments and states", lanes: true });
  panels.push({
    key: "tilt", title: "Tilt felt by the sensor", unit: "°", height: 170,
    series: [
      columnSeries("pitch", "pitch (push axis up)", "estimate", tilt.t, tilt.pitch, "°", { digits: 2 }),
      columnSeries("roll", "roll", "other-1", tilt.t, tilt.roll, "°", { digits: 2, dash: "dash" }),
    ],
  });
  panels.push({
    key: "samples", title: "Inertial samples in each second", unit: "1/s", height: 150,
    series: [
      columnSeries("samples", "good", "estimate", rates.t, rates.samples, "good", { shape: "hvh" }),
      ...(sum(rates.bad) > 0 ? [columnSeries("bad", "bad", "ill", rates.t, rates.bad, "bad", { shape: "hvh", dash: "dot" })] : []),
    ],
  });
  if (sum(rates.frames) + sum(rates.errors) + sum(rates.sent) > 0) {
    panels.push({
      key: "can", title: "CAN frames in each second", unit: "1/s", height: 150,
      series: [
        columnSeries("frames", "received", "estimate", rates.t, rates.frames, "received", { shape: "hvh" }),
        ...(sum(rates.sent) > 0 ? [columnSeries("sent", "sent", "smoothed", rates.t, rates.sent, "sent", { shape: "hvh", dash: "dash" })] : []),
        ...(sum(rates.errors) > 0 ? [columnSeries("errors", "error frames", "ill", rates.t, rates.errors, "error frames", { shape: "hvh", dash: "dot" })] : []),
      ],
    });
  }
  return panels;
}
