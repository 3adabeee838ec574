"use strict";
// Colours: read from the style sheet, so that both themes are written there and only there.

Live.palette = (() => {
  const NAMES = ["page", "card", "line", "faint", "muted", "ink", "accent", "biceps", "triceps", "setpoint", "external",
    "forearm", "skin", "beam", "twin"];

  /** @type {Object<string, string>} colour by name */
  const colours = {};
  /** @type {number[][]} colours of string tensions, from none to saturation */
  let scale = [];

  /** Read the style sheet's colours; call it again when the theme changes. */
  function read() {
    const style = getComputedStyle(document.documentElement);
    for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
    scale = style.getPropertyValue("--tension").split(",").map((text) => {
      const number = parseInt(text.trim().slice(1), 16);
      return [number >> 16, (number >> 8) & 255, number & 255];
    });
  }

  /** The colour of a string force. @param {number} share of the springs' saturation force */
  function tension(share) {
    const at = Live.base.clamp(share, 0, 1) * (scale.length - 1);
    const k = Math.min(Math.floor(at), scale.length - 2);
    const mixed = scale[k].map((low, c) => Math.round(low + (scale[k + 1][c] - low) * (at - k)));
    return `rgb(${mixed.join(" ")})`;
  }

  /** A colour with an opacity. @param {string} colour #rrggbb @param {number} opacity 0 to 1 */
  function translucent(colour, opacity) {
    return colour + Math.round(255 * opacity).toString(16).padStart(2, "0");
  }

  return { colours, read, tension, translucent };
})();
