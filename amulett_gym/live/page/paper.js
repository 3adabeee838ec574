"use strict";
// Curves on a canvas that is not shown itself and moves to the left as time goes on: a sample is drawn once, since strokes
// are what takes a processor longest. Coordinates are the screen's pixels, so that a shift by whole pixels blurs nothing.

Live.paper = (() => {
  const MARGIN = 4; // [px of CSS] right of the newest sample, for the width of a line

  /**
   * @typedef {Object} Plot where curves lie
   * @property {number} width of the time shown [px of the screen] @property {number} height [px of the screen]
   * @property {number} ratio pixels of the screen along one of CSS @property {number} rate pixels of the screen in a second
   * @property {number} begin the earliest time shown [s] @property {(value: number) => number} toY
   * @property {string} key of all that makes an earlier drawing wrong: span, colours
   */

  function make() {
    const canvas = document.createElement("canvas"), context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    let key = "", moved = 0, until = -Infinity; // moved: the time 0 is so many pixels left of the canvas; until: drawn so far [s]
    /** @type {any} */
    let of = null;

    /** Begin with an empty canvas. @param {Plot} plot */
    function clear({ width, height, ratio, rate, begin }) {
      [canvas.width, canvas.height] = [2 * width + Math.ceil(MARGIN * ratio), height]; // which empties it
      [moved, until] = [Math.floor(begin * rate), begin];
    }

    /** Move what is still shown to the left edge. @param {Plot} plot */
    function shift({ rate, begin }) {
      const by = Math.floor(begin * rate) - moved;
      context.globalCompositeOperation = "copy";
      context.drawImage(canvas, -by, 0);
      context.globalCompositeOperation = "source-over";
      moved += by;
    }

    /**
     * Draw the samples that are new, or all of those shown if an earlier drawing does not hold any more.
     * @param {Plot} plot @param {any[]} curves @param {{mine: any, twin: any}} samples of `Live.samples`
     */
    function update(plot, curves, samples) {
      const newest = Math.max(samples.mine.last("time"), samples.twin.last("time"));
      const now = [plot.key, plot.width, plot.height, samples.mine.cleared].join();
      if (now !== key || samples !== of || until < plot.begin) clear(plot);
      else if (newest * plot.rate - moved > canvas.width - MARGIN * plot.ratio) shift(plot);
      [key, of] = [now, samples];
      for (const curve of curves) stroke(plot, curve, samples[curve.arm]);
      until = newest;
    }

    function stroke({ ratio, rate, toY }, curve, samples) {
      const factor = curve.factor || 1;
      let drawing = false, before = NaN;
      context.beginPath();
      samples.each(curve.channel, until, (time, value) => {
        if (!Number.isFinite(value)) { drawing = false; return; }
        const x = time * rate - moved, y = toY(value * factor);
        if (!drawing) {
          context.moveTo(x, y);
          context.lineDashOffset = x; // dashes go on where the last piece ended
        } else {
          if (curve.steps && y !== before) context.lineTo(x, before);
          context.lineTo(x, y);
        }
        [drawing, before] = [true, y];
      });
      context.strokeStyle = Live.palette.colours[curve.colour];
      context.lineWidth = ratio * (curve.width || 2);
      context.lineCap = context.lineJoin = "round"; // of pieces that were drawn one after another
      context.setLineDash((curve.dash || []).map((length) => ratio * length));
      context.stroke();
    }

    /** Put what is shown into a canvas. @param {CanvasRenderingContext2D} onto @param {number} left [px of the screen] */
    function put(onto, { width, height, ratio, rate, begin }, left) {
      const wide = width + Math.ceil(MARGIN * ratio);
      onto.drawImage(canvas, Math.round(begin * rate) - moved, 0, wide, height, left, 0, wide, height);
    }

    return { update, put };
  }

  return { make };
})();
