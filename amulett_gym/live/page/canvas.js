"use strict";
// A canvas whose pixels are those of the screen, whatever its size and the zoom.

Live.canvas = (() => {
  const FONT = 'system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif';
  const MOST_PIXELS = 3; // a pixel of CSS has at most so many of the screen's along each side

  /**
   * @param {HTMLCanvasElement} element
   * @returns {{context: CanvasRenderingContext2D, ratio: number, width: number, height: number}} what to draw on; sizes
   *   are in pixels of CSS, as all coordinates; `ratio`: pixels of the screen along one. The first thing drawn has to
   *   cover all: a canvas without transparency takes less time to show
   */
  function begin(element) {
    const ratio = Math.min(window.devicePixelRatio || 1, MOST_PIXELS);
    const width = element.clientWidth, height = element.clientHeight;
    const wide = Math.max(Math.round(width * ratio), 1), high = Math.max(Math.round(height * ratio), 1);
    if (element.width !== wide || element.height !== high) [element.width, element.height] = [wide, high];
    const context = /** @type {CanvasRenderingContext2D} */ (element.getContext("2d", { alpha: false }));
    context.setTransform(wide / Math.max(width, 1), 0, 0, high / Math.max(height, 1), 0, 0);
    return { context, ratio, width, height };
  }

  /** @param {number} size [px] @param {string} [weight] */
  const font = (size, weight = "400") => `${weight} ${size}px ${FONT}`;

  /**
   * Marks that tell curves and handles apart without their colour.
   * @param {CanvasRenderingContext2D} context
   * @param {"circle" | "triangle" | "diamond" | "square"} shape
   */
  function mark(context, shape, x, y, size, colour) {
    context.fillStyle = colour;
    context.beginPath();
    if (shape === "circle") context.arc(x, y, size, 0, 2 * Math.PI);
    else if (shape === "triangle") polygon(context, [[x, y - 1.2 * size], [x + 1.1 * size, y + 0.8 * size], [x - 1.1 * size, y + 0.8 * size]]);
    else if (shape === "diamond") polygon(context, [[x, y - 1.3 * size], [x + 1.3 * size, y], [x, y + 1.3 * size], [x - 1.3 * size, y]]);
    else context.rect(x - 0.9 * size, y - 0.9 * size, 1.8 * size, 1.8 * size);
    context.fill();
  }

  /** Trace a closed polygon. @param {CanvasRenderingContext2D} context @param {number[][]} points */
  function polygon(context, points) {
    points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
  }

  return { begin, font, mark, polygon };
})();
