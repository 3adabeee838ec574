"use strict";
// The page's one global name. Each file adds its part to it; all files are inlined, in the order of `live/page.py`.
globalThis.Live = {};

Live.base = (() => {
  const DEGREES = 180 / Math.PI;

  /** @param {number} value @param {number} low @param {number} high @returns {number} */
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  /**
   * A number with a typographic minus sign.
   * @param {number} value @param {number} digits after the point
   */
  const fixed = (value, digits) => {
    if (!Number.isFinite(value)) return "–";
    const text = Math.abs(value).toFixed(digits);
    return (value < 0 && Number(text) !== 0 ? "\u2212" : "") + text;
  };

  /** @param {string} id @returns {any} the page's element of that id */
  const byId = (id) => document.getElementById(id);

  /**
   * Make an element. Text is set as text, never as HTML: names may come from files that were dropped on the page.
   * @param {string} tag @param {Object<string, any>} [properties] attributes; `text`: its text
   * @param {...Node} children
   */
  const element = (tag, properties = {}, ...children) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(properties)) {
      if (name === "text") made.textContent = value;
      else if (value === true) made.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
    }
    made.append(...children);
    return made;
  };

  /** Give a node a text, if it is another one: a text that is set costs a layout. @param {any} node @param {string} text */
  const write = (node, text) => { if (node.textContent !== text) node.textContent = text; };

  /** An error with a text for the person in front of the page: the simulation's own kind. */
  const UserError = Amulett.base.AmulettError;

  return { DEGREES, clamp, fixed, byId, element, write, UserError };
})();
