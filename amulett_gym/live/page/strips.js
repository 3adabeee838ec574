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
      { name: "setpoint", arm: "mine", channel: "setpoint", colour: "setpoint", shape: "diamond", factor: DEGREES, width: 1.5, dash: [6, 4], steps: true },
      { name: "eq. 6", arm: "twin", channel: "angle", colour: "twin", shape: "square", factor: DEGREES, width: 1.5 },
      { name: "yours", arm: "mine", channel: "angle", colour: "accent", shape: "circle", factor: DEGREES, width: 2.4 },
    ] },
    { title: "String tensions, yours", unit: "N", digits: 1, range: [0, 16], curves: [
      { name: "asked for", arm: "mine", channel: "tensionSetpoint", colour: "setpoint", shape: "diamond", width: 1.5, dash: [6, 4], steps: true },
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

  /** @type {{canvas: HTMLCanvasElement, values: HTMLElement[], span: number[]}[]} */
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
      return { canvas, values, span: [...strip.range] };
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
      figure.values[c].textContent = Number.isFinite(value) ? fixed(value, STRIPS[k].digits) : "";
    }));
  }

  function drawStrip(figure, strip, samples, now) {
    const { context, width, height } = Live.canvas.begin(figure.canvas);
    if (width < LEFT + RIGHT + 20) return;
    const { colours } = Live.palette, end = Math.max(now, SECONDS), begin = end - SECONDS;
    const [low, high] = spanOf(figure, strip, samples, begin);
    const right = width - RIGHT, bottom = height - BOTTOM;
    const toX = (time) => LEFT + ((time - begin) / SECONDS) * (right - LEFT);
    const toY = (value) => bottom - ((value - low) / (high - low)) * (bottom - TOP);
    context.font = font(11);
    context.textBaseline = "middle";
    context.lineWidth = 1;
    for (const value of ticks(low, high)) {
      const y = Math.round(toY(value)) + 0.5;
      context.strokeStyle = value === 0 ? colours.faint : colours.line;
      segment(context, LEFT, y, right, y);
      context.textAlign = "right";
      context.fillStyle = colours.muted;
      context.fillText(label(value), LEFT - 6, y);
    }
    context.textAlign = "center";
    for (let second = Math.ceil(begin); second <= end; second++) {
      const x = Math.round(toX(second)) + 0.5;
      context.strokeStyle = colours.line;
      segment(context, x, TOP, x, bottom);
      if (second % 2 === 0 && x < right - 6) context.fillText(`${second} s`, x, bottom + 10);
    }
    context.save();
    context.beginPath();
    context.rect(LEFT, TOP - 6, right - LEFT + 8, bottom - TOP + 10);
    context.clip();
    for (const curve of strip.curves) drawCurve(context, curve, samples[curve.arm], begin, toX, toY);
    context.restore();
  }

  function drawCurve(context, curve, samples, begin, toX, toY) {
    const colour = Live.palette.colours[curve.colour], factor = curve.factor || 1;
    context.strokeStyle = colour;
    context.lineWidth = curve.width || 2;
    context.lineJoin = "bevel";
    context.setLineDash(curve.dash || []);
    context.beginPath();
    let x = 0, y = 0, drawing = false, before = NaN;
    samples.each(curve.channel, begin, (time, value) => {
      if (!Number.isFinite(value)) { drawing = false; return; }
      [x, y] = [toX(time), toY(value * factor)];
      if (!drawing) context.moveTo(x, y);
      else {
        if (curve.steps && y !== before) context.lineTo(x, before);
        context.lineTo(x, y);
      }
      [drawing, before] = [true, y];
    });
    context.stroke();
    context.setLineDash([]);
    if (drawing && curve.shape) mark(context, curve.shape, x, y, 3.6, colour);
  }

  /** The range of a strip's axis: it grows at once, and shrinks slowly, so that it does not jump. */
  function spanOf(figure, strip, samples, begin) {
    let [low, high] = strip.range;
    for (const curve of strip.curves) {
      const [least, most] = samples[curve.arm].range(curve.channel, begin);
      low = Math.min(low, least * (curve.factor || 1));
      high = Math.max(high, most * (curve.factor || 1));
    }
    const room = 0.05 * (high - low), span = figure.span;
    const wanted = [low < strip.range[0] ? low - room : low, high > strip.range[1] ? high + room : high];
    span[0] = wanted[0] < span[0] ? wanted[0] : span[0] + 0.04 * (wanted[0] - span[0]);
    span[1] = wanted[1] > span[1] ? wanted[1] : span[1] + 0.04 * (wanted[1] - span[1]);
    return span;
  }

  /** Values at which an axis has a line: at most five. @returns {number[]} */
  function ticks(low, high) {
    const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * ([1, 2, 5, 10].find((factor) => power * factor >= rough) || 10);
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return found;
  }

  /** A short text of a tick. @param {number} value */
  function label(value) {
    const size = Math.abs(value);
    if (size >= 10000) return `${fixed(value / 1000, 0)}k`;
    return value === 0 ? "0" : fixed(value, size >= 1 && Number.isInteger(Math.round(value * 1e6) / 1e6) ? 0 : size >= 0.995 ? 1 : 2);
  }

  function segment(context, x0, y0, x1, y1) {
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
    context.stroke();
  }

  return { make, draw, write, SECONDS };
})();
