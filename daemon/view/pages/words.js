// The language of the page: remembered, at first that of the browser.

import { told } from "./sentences.js";
import { TEXTS } from "./texts.js";

const KEY = "ramstroke.language";
export const LANGUAGES = { en: "English", zh: "中文" };
const TAGS = { en: "en", zh: "zh-CN" };

let language = remembered() ?? (navigator.language.toLowerCase().startsWith("zh") ? "zh" : "en");

function remembered() {
  try {
    const found = localStorage.getItem(KEY);
    return found in TEXTS ? found : null;
  } catch {
    return null; // a browser that keeps nothing
  }
}

export function current() {
  return language;
}

export function choose(name) {
  language = name;
  try {
    localStorage.setItem(KEY, name);
  } catch {
    // then it is forgotten
  }
}

/** The text of that name, with {x} filled in. */
export function text(name, values = {}) {
  return TEXTS[language][name].replace(/\{(\w+)\}/g, (_, key) => values[key]);
}

/** A sentence of the daemon. */
export function sentence(words) {
  return told(words, language);
}

/** Words of the page that stand still. */
export function translatePage() {
  document.documentElement.lang = TAGS[language];
  for (const element of document.querySelectorAll("[data-text]")) element.textContent = text(element.dataset.text);
  for (const element of document.querySelectorAll("[data-label]")) element.setAttribute("aria-label", text(element.dataset.label));
}
