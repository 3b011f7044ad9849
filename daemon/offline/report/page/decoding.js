// The numbers of one recording: base64 to typed arrays, each when it is first asked for.

function bytes(text) {
  const raw = atob(text);
  const made = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) made[i] = raw.charCodeAt(i);
  return made.buffer;
}

const floats = (text) => new Float32Array(bytes(text));
const counts = (text) => new Uint32Array(bytes(text));
const codes = (text) => new Uint8Array(bytes(text));

function onUse(made, name, decode) {
  Object.defineProperty(made, name, {
    configurable: true,
    enumerable: true,
    get() {
      const value = decode();
      Object.defineProperty(made, name, { value, enumerable: true });
      return value;
    },
  });
}

// Seconds of fine times: 32-bit counts of a tick.
function seconds(text, tick) {
  return Float64Array.from(counts(text), (count) => count * tick);
}

function signal(packed) {
  const made = {};
  for (const name of Object.keys(packed)) onUse(made, name, () => floats(packed[name]));
  // The band around it.
  onUse(made, "bandLow", () => made.low.map((low, i) => low - made.half[i]));
  onUse(made, "bandHigh", () => made.high.map((high, i) => high + made.half[i]));
  return made;
}

function readings(packed, tick) {
  if (packed === null) return null;
  const made = {
    good: signal(packed.good),
    ill: signal(packed.ill),
    count: packed.count,
    illCount: packed.ill_count,
  };
  onUse(made, "illWords", () => codes(packed.ill_words));
  onUse(made, "times", () => seconds(packed.fine, tick));
  onUse(made, "values", () => floats(packed.fine_values));
  onUse(made, "words", () => codes(packed.fine_words));
  return made;
}

function columns(packed, decode) {
  const made = {};
  for (const [name, text] of Object.entries(packed)) onUse(made, name, () => (name === "t" ? floats : decode)(text));
  return made;
}

export function decoded(element) {
  const packed = JSON.parse(element.textContent);
  const record = { ...packed, signals: {}, others: {} };
  for (const [name, one] of Object.entries(packed.signals)) record.signals[name] = signal(one);
  for (const [name, one] of Object.entries(packed.others)) record.others[name] = signal(one);
  const { gate } = record.signals;
  onUse(gate, "low", () => gate.high.map((high) => -high));
  record.readings = {};
  for (const [name, one] of Object.entries(packed.readings)) record.readings[name] = readings(one, packed.tick);
  onUse(record, "fine", () => seconds(packed.fine, packed.tick));
  record.tilt = columns(packed.tilt, floats);
  record.rates = columns(packed.rates, counts);
  return record;
}
