"use strict";
// Curves of the last seconds: one small canvas for each quantity, yours in full and eq. 6's beside it.

Live.strips = (() => {
  const { element, fixed, DEGREES } = Live.base;
  const { font, mark } = Live.canvas;

  const SECONDS = 8;
  const LEFT = 40, RIGHT = 10, TOP = 8, BOTTOM = 18; // of the plot in its canvas [px]

  /**
   * @typedef {Object} Curve
   * @property {string} name @property {"mine" | "twin"} arm @property {string} channel of `Live.samples`
   * @property {string} colour of the palette @property {"circle" | "triangle" | "diamond" | "square" | ""} shape
   * @property {number} [factor] @property {number} [width] @property {number[]} [dash] @property {boolean} [steps]
   */
  /** @type {{title: string, unit: string, digits: number, range: number[], curves: Curve[]}[]} */
  const STRIPS = [
    { title: "Angle", unit: "°", digits: 1, range: [-5, 95], curves: [
      { name: "setpoint", arm: "mine", channel: "setpoint", colour: "setpoint", shape: "diamond", factor: DEGREES, width: 1.5, dash: [5, 5], steps: true },
      { name: "eq. 6", arm: "twin", channel: "angle", colour: "twin", shape: "square", factor: DEGREES, width: 1.5 },
      { name: "yours", arm: "mine", channel: "angle", colour: "accent", shape: "circle", factor: DEGREES, width: 2.4 },
    ] },
    { title: "String tensions, yours", unit: "N", digits: 1, range: [0, 16], curves: [
      { name: "asked for", arm: "mine", channel: "tensionSetpoint", colour: "setpoint", shape: "diamond", width: 1.5, dash: [5, 5], steps: true },
      { name: "biceps", arm: "mine", channel: "biceps", colour: "biceps", shape: "circle", width: 2 },
      { name: "triceps", arm: "mine", channel: "triceps", colour: "triceps", shape: "triangle", width: 2 },
    ] },
    { title: "Joint stiffness", unit: "N m/rad", digits: 1, range: [0, 20], curves: [
      { name: "eq. 6", arm: "twin", channel: "stiffness", colour: "twin", shape: "square", width: 1.5 },
      { name: "yours", arm: "mine", channel: "stiffness", colour: "accent", shape: "circle", width: 2.4 },
    ] },
    { title: "Drive speeds, yours", unit: "°/s", digits: 0, range: [-300, 300], curves: [
      { name: "biceps", arm: "mine", channel: "bicepsSpeed", colour: "biceps", shape: "circle", factor: DEGREES, width: 1.8 },
      { name: "triceps", arm: "mine", channel: "tricepsSpeed", colour: "triceps", shape: "triangle", factor: DEGREES, width: 1.8 },
    ] },
    { title: "Torque from outside", unit: "N m", digits: 2, range: [-0.25, 0.25], curves: [
      { name: "push", arm: "mine", channel: "push", colour: "external", shape: "circle", width: 2, steps: true },
      { name: "obstacle", arm: "mine", channel: "contact", colour: "forearm", shape: "square", width: 1.8 },
    ] },
    { title: "Cost so far", unit: "", digits: 3, range: [0, 0.2], curves: [
      { name: "eq. 6", arm: "twin", channel: "cost", colour: "twin", shape: "square", width: 1.5 },
      { name: "yours", arm: "mine", channel: "cost", colour: "accent", shape: "circle", width: 2.4 },
    ] },
  ];

  /** @type {{canvas: HTMLCanvasElement, values: HTMLElement[], paper: any, ground: HTMLCanvasElement, key: string}[]} */
  let made = [];

  /** Make the figures. @param {HTMLElement} parent */
  function make(parent) {
    made = STRIPS.map((strip) => {
      const values = strip.curves.map(() => element("b"));
      const legend = element("span", { class: "legend" });
      strip.curves.forEach((curve, k) => legend.append(element("span", {}, sample(curve), document.createTextNode(curve.name), values[k])));
      const canvas = /** @type {HTMLCanvasElement} */ (element("canvas", { role: "img", "aria-label": `${strip.title}, last ${SECONDS} seconds` }));
      const unit = strip.unit ? ` [${strip.unit}]` : "";
      parent.append(element("figure", { class: "card strip" }, element("figcaption", {}, element("b", { text: strip.title + unit }), legend), canvas));
      return { canvas, values, paper: Live.paper.make(), ground: document.createElement("canvas"), key: "" };
    });
  }

  /** The line and mark of a curve, for its legend. @param {Curve} curve */
  function sample(curve) {
    const draw = (tag, properties) => {
      const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
      for (const [key, value] of Object.entries(properties)) node.setAttribute(key, value);
      return node;
    };
    const picture = draw("svg", { viewBox: "0 0 16 10", "aria-hidden": "true" });
    const line = draw("line", { x1: 0, y1: 5, x2: 16, y2: 5 }), colour = `var(--${curve.colour})`;
    line.style.stroke = colour;
    line.style.strokeWidth = String(curve.width || 2);
    if (curve.dash) line.style.strokeDasharray = "4 2";
    const shapes = { circle: "M11 5a3 3 0 1 1-6 0a3 3 0 1 1 6 0Z", triangle: "M8 1.2 11.6 8H4.4Z", diamond: "M8 1 12 5 8 9 4 5Z", square: "M5.2 2.2h5.6v5.6H5.2Z" };
    const shape = draw("path", { d: shapes[curve.shape] });
    shape.style.fill = colour;
    picture.append(line, shape);
    return picture;
  }

  let turn = 0;

  /**
   * Draw the strips: all, or while they run every other one, in turns, which halves the time that a frame takes.
   * @param {{mine: any, twin: any}} samples of `Live.samples`
   * @param {number} now [s] @param {boolean} running
   */
  function draw(samples, now, running) {
    turn = 1 - turn;
    made.forEach((figure, k) => { if (!running || k % 2 === turn) drawStrip(figure, STRIPS[k], samples, now); });
  }

  /** Write the present values into the legends: less often than the curves, so that they can be read. */
  function write(samples) {
    made.forEach((figure, k) => STRIPS[k].curves.forEach((curve, c) => {
      const value = samples[curve.arm].last(curve.channel) * (curve.factor || 1);
      Live.base.write(figure.values[c], Number.isFinite(value) ? fixed(value, STRIPS[k].digits) : "");
    }));
  }

  function drawStrip(figure, strip, samples, now) {
    const { context, ratio, width, height } = Live.canvas.begin(figure.canvas);
    if (width < LEFT + RIGHT + 20) return;
    const begin = Math.max(now - SECONDS, 0), [low, high] = spanOf(strip, samples, begin);
    const left = Math.round(LEFT * ratio), wide = Math.round((width - RIGHT) * ratio) - left;
    const top = TOP * ratio, bottom = (height - BOTTOM) * ratio;
    const plot = {
      width: wide, height: figure.canvas.height, ratio, rate: wide / SECONDS, begin, low, high, left, bottom,
      toY: (value) => bottom - ((value - low) / (high - low)) * (bottom - top),
      key: [low, high, ratio, Live.palette.colours.card].join(),
    };
    figure.paper.update(plot, strip.curves, samples);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(groundOf(figure, plot), 0, 0);
    drawSeconds(context, plot);
    figure.paper.put(context, plot, left);
    for (const curve of strip.curves) drawMark(context, plot, curve, samples[curve.arm]);
  }

  /** What lies behind the curves and does not move, drawn once for each size, span and theme. */
  function groundOf(figure, plot) {
    const { width, height, ratio, left, low, high, toY } = plot, { colours } = Live.palette;
    const key = [plot.key, width, height].join(), canvas = figure.ground;
    if (key === figure.key) return canvas;
    figure.key = key;
    [canvas.width, canvas.height] = [figure.canvas.width, height];
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.fillStyle = colours.card;
    context.fillRect(0, 0, canvas.width, height);
    context.font = font(11 * ratio);
    context.textBaseline = "middle";
    context.textAlign = "right";
    const thick = Math.max(Math.round(ratio), 1);
    for (const value of ticks(low, high)) {
      const y = Math.round(toY(value));
      context.fillStyle = value === 0 ? colours.faint : colours.line;
      context.fillRect(left, y, width, thick);
      context.fillStyle = colours.muted;
      context.fillText(label(value), left - 6 * ratio, y);
    }
    return canvas;
  }

  /** Draw a line for each second, and every other one's time. */
  function drawSeconds(context, plot) {
    const { width, ratio, left, bottom, begin } = plot, { colours } = Live.palette, thick = Math.max(Math.round(ratio), 1);
    const whole = [];
    for (let second = Math.ceil(begin); second <= begin + SECONDS; second++) whole.push(second);
    context.fillStyle = colours.line;
    for (const second of whole) context.fillRect(Math.round(xOf(plot, second)), TOP * ratio, thick, bottom - TOP * ratio);
    context.font = font(11 * ratio);
    context.textBaseline = "middle";
    context.textAlign = "center";
    context.fillStyle = colours.muted;
    for (const second of whole) {
      const x = xOf(plot, second);
      if (second % 2 === 0 && x < left + width - 6 * ratio) context.fillText(`${second} s`, x, bottom + 10 * ratio);
    }
  }

  /** Where a time lies: everything moves by whole pixels, as the paper does. */
  const xOf = ({ left, rate, begin }, time) => left + time * rate - Math.round(begin * rate);

  /** Draw the mark at the end of a curve, which an arm that failed leaves behind. */
  function drawMark(context, plot, curve, samples) {
    const x = xOf(plot, samples.last("time")), value = samples.last(curve.channel) * (curve.factor || 1);
    if (Number.isFinite(value) && x >= plot.left) mark(context, curve.shape, x, plot.toY(value), 3.6 * plot.ratio, Live.palette.colours[curve.colour]);
  }

  /** The range of a strip's axis: its usual one, or on to the next line of the axis that the curves need. */
  function spanOf(strip, samples, begin) {
    let [low, high] = strip.range;
    for (const curve of strip.curves) {
      const [least, most] = samples[curve.arm].range(curve.channel, begin);
      low = Math.min(low, least * (curve.factor || 1));
      high = Math.max(high, most * (curve.factor || 1));
    }
    const step = 0.5 * stepOf(low, high);
    return [low < strip.range[0] ? step * Math.floor(low / step) : low, high > strip.range[1] ? step * Math.ceil(high / step) : high];
  }

  /** The distance of an axis's lines: at most five. */
  function stepOf(low, high) {
    const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
    return power * ([1, 2, 5, 10].find((factor) => power * factor >= rough) || 10);
  }

  /** Values at which an axis has a line. @returns {number[]} */
  function ticks(low, high) {
    const step = stepOf(low, high), found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return found;
  }

  /** A short text of a tick. @param {number} value */
  function label(value) {
    const size = Math.abs(value);
    if (size >= 10000) return `${fixed(value / 1000, 0)}k`;
    return value === 0 ? "0" : fixed(value, size >= 1 && Number.isInteger(Math.round(value * 1e6) / 1e6) ? 0 : size >= 0.995 ? 1 : 2);
  }

  return { make, draw, write, SECONDS };
})();
