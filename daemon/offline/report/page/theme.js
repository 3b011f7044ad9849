// Colours from the style sheet, so that plots follow light, dark and print.

const NAMES = ["ink", "soft", "line", "paper", "estimate", "smoothed", "observed", "ill", "reference", "limit",
  "vvs", "cvs", "other-1", "other-2", "other-3", "other-4"];

export function colours(element) {
  const style = getComputedStyle(element);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

export function faded(colour, share) {
  const value = parseInt(colour.slice(1), 16);
  return `rgba(${value >> 16}, ${(value >> 8) & 255}, ${value & 255}, ${share})`;
}

export function onChange(redraw) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}
