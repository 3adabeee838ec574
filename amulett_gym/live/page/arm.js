"use strict";
// The picture of one arm. Positions are in units of a drawing that is then scaled to its canvas: y downwards, the joint
// at JOINT. It shows true states, not the sensors' readings.

Live.arm = (() => {
  const { DEGREES, clamp, fixed } = Live.base;
  const { polygon, font, mark } = Live.canvas;

  const BOX = { left: 34, top: 6, width: 548, height: 330 }; // of the drawing
  const JOINT = [352, 236];
  const PULLEY = 44, FOREARM = 168, WIDTH = 20, SCALE = 190;
  const DRIVE_X = 100, BEAM_LEFT = 58;
  const SPRING_LENGTH = 44, STRETCH = 2; // a spring's stretch is magnified, relative to the pulleys' scale
  const ABOVE = -1, BELOW = 1; // sides of the upper arm: biceps, triceps
  const SPRING_AT = { [ABOVE]: 306, [BELOW]: 250 }; // where the springs end when the arm is straight
  const MOST_FAN = 75 / DEGREES;
  const PUSH_AT = 0.8; // where a push acts, as a share of the forearm

  /**
   * @typedef {Object} Frame
   * @property {number} angle [rad] @property {number} setpoint [rad]
   * @property {number[]} tension biceps, triceps [N] @property {number[]} strings their deflections [m]
   * @property {number[]} driveAngles [rad] @property {number} agonist 1: biceps, -1: triceps, 0: none
   * @property {number} stiffness at the joint [N m/rad] @property {number} push [N m] @property {number} contact [N m]
   * @property {{angle: number, side: number} | null} obstacle @property {number} payload [kg]
   */
  /**
   * @typedef {Object} Geometry of a device
   * @property {number} jointRadius [m] @property {number} driveRadius [m] @property {number} maxForce [N]
   */

  /** The point at a radius in the direction of a joint angle. */
  const polar = (radius, angle, [x, y] = JOINT) => [x + radius * Math.cos(angle), y - radius * Math.sin(angle)];

  /** The point along the forearm, moved to its flexion side. */
  function beside(along, aside, angle) {
    const [x, y] = polar(along, angle);
    return [x - aside * Math.sin(angle), y - aside * Math.cos(angle)];
  }

  /**
   * How the drawing lies in a canvas.
   * @param {number} width [px] @param {number} height [px]
   */
  function placement(width, height) {
    const scale = Math.min(width / BOX.width, height / BOX.height);
    return { scale, x: 0.5 * (width - scale * BOX.width) - scale * BOX.left, y: 0.5 * (height - scale * BOX.height) - scale * BOX.top };
  }

  /** A canvas point [px] in the drawing's units. */
  function toDrawing(x, y, width, height) {
    const place = placement(width, height);
    return [(x - place.x) / place.scale, (y - place.y) / place.scale];
  }

  /** The joint angle [rad] in whose direction a point of the drawing lies. */
  function angleAt([x, y]) {
    const angle = Math.atan2(JOINT[1] - y, x - JOINT[0]);
    return angle < -0.6 * Math.PI ? angle + 2 * Math.PI : angle;
  }

  /** Where a point lies beside the forearm: along it and aside, to flexion. */
  function onForearm([x, y], angle) {
    const dx = x - JOINT[0], dy = JOINT[1] - y, c = Math.cos(angle), s = Math.sin(angle);
    return { along: dx * c + dy * s, aside: dy * c - dx * s };
  }

  /** What a pointer takes hold of: the forearm, or the setpoint. @returns {"forearm" | "setpoint"} */
  function partAt(point, frame) {
    const { along, aside } = onForearm(point, frame.angle);
    const reach = Math.hypot(point[0] - JOINT[0], point[1] - JOINT[1]);
    return along > 30 && reach < SCALE - 8 && Math.abs(aside) < WIDTH + 4 ? "forearm" : "setpoint";
  }

  /**
   * Draw an arm.
   * @param {HTMLCanvasElement} element
   * @param {Frame} frame @param {Geometry} device
   * @param {{ghost?: number, pull?: number[] | null, handle?: boolean, active?: string, colour?: string}} options
   *   `ghost`: angle of the other arm [rad]; `pull`: the pointer that pulls, in the drawing's units; `handle`: the
   *   setpoint can be dragged; `active`: what is dragged; `colour`: of the stiffness
   */
  function draw(element, frame, device, options = {}) {
    const { context, width, height } = Live.canvas.begin(element);
    if (!width) return;
    const { colours } = Live.palette, place = placement(width, height);
    const text = clamp(1 / place.scale, 0.9, 1.45); // text keeps its size where the drawing is small
    context.drawImage(still(element, place, text, device), 0, 0, width, height);
    begin(context, place);
    drawFan(context, frame, options.colour || colours.accent, text);
    if (options.ghost !== undefined) drawGhost(context, options.ghost);
    drawStrings(context, frame, device, text);
    drawDrives(context, frame, device, text);
    if (frame.obstacle) drawObstacle(context, frame, frame.obstacle, text);
    drawForearm(context, frame.angle);
    if (frame.payload > 0) drawPayload(context, frame, text);
    drawSetpoint(context, frame.setpoint, Boolean(options.handle), options.active === "setpoint", text);
    if (frame.push) drawPush(context, frame, device, options.pull || null, text);
    drawTensionMarks(context, frame, device);
  }

  function begin(context, place) {
    context.translate(place.x, place.y);
    context.scale(place.scale, place.scale);
    context.lineCap = context.lineJoin = "round";
    context.textBaseline = "middle";
  }

  /** What does not move, drawn once for each size and theme. @type {Map<string, HTMLCanvasElement>} */
  const drawn = new Map();

  function still(element, place, text, device) {
    const { width, height } = element, key = [width, height, place.scale, device.maxForce, Live.palette.colours.card].join();
    const found = drawn.get(key);
    if (found) return found;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")), ratio = width / element.clientWidth;
    context.fillStyle = Live.palette.colours.card;
    context.fillRect(0, 0, width, height);
    context.scale(ratio, ratio);
    begin(context, place);
    drawScale(context, text);
    drawUpperArm(context);
    drawTensionScale(context, device, text);
    if (drawn.size > 4) drawn.clear();
    drawn.set(key, canvas);
    return canvas;
  }

  function line(context, points, colour, width, dash = []) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.beginPath();
    points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
    context.setLineDash([]);
  }

  function fill(context, points, colour) {
    context.fillStyle = colour;
    context.beginPath();
    polygon(context, points);
    context.fill();
  }

  function disc(context, [x, y], radius, colour, edge = "", width = 1) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    if (colour) { context.fillStyle = colour; context.fill(); }
    if (edge) { context.strokeStyle = edge; context.lineWidth = width; context.stroke(); }
  }

  function write(context, text, [x, y], size, colour, align = "left", weight = "400") {
    context.font = font(size, weight);
    context.textAlign = /** @type {CanvasTextAlign} */ (align);
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }

  function drawScale(context, text) {
    const { colours } = Live.palette;
    context.strokeStyle = colours.line;
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(...JOINT, SCALE, -120 / DEGREES, 20 / DEGREES);
    context.stroke();
    for (let degrees = -20; degrees <= 120; degrees += 10) {
      const major = degrees % 30 === 0, angle = degrees / DEGREES;
      line(context, [polar(SCALE, angle), polar(SCALE + (major ? 8 : 5), angle)], major ? colours.faint : colours.line, major ? 1.8 : 1.2);
      if (major && degrees >= 0) write(context, `${degrees}°`, polar(SCALE + 24, angle), 11 * text, colours.muted, "center");
    }
  }

  function drawUpperArm(context) {
    const { colours } = Live.palette, [x, y] = JOINT;
    for (let k = 0; k < 8; k++) line(context, [[BEAM_LEFT, y - 36 + 10 * k], [BEAM_LEFT - 10, y - 28 + 10 * k]], colours.faint, 1.5);
    line(context, [[BEAM_LEFT, y - 40], [BEAM_LEFT, y + 44]], colours.muted, 2);
    context.fillStyle = colours.beam;
    context.strokeStyle = colours.faint;
    context.lineWidth = 1.2;
    context.beginPath();
    context.roundRect(BEAM_LEFT, y - 10, x - BEAM_LEFT, 20, 3);
    context.roundRect(DRIVE_X - 26, y - 62, 52, 124, 10);
    context.fill();
    context.stroke();
    context.fillRect(BEAM_LEFT + 1, y - 9.4, x - BEAM_LEFT, 18.8);
  }

  /** Draw by how much 1 N m turns the joint, either way: the softer, the wider. */
  function drawFan(context, frame, colour, text) {
    if (!(frame.stiffness > 0)) return;
    const { translucent } = Live.palette;
    const half = Math.min(1 / frame.stiffness, MOST_FAN), [x, y] = JOINT;
    const paint = context.createRadialGradient(x, y, PULLEY, x, y, SCALE);
    paint.addColorStop(0, translucent(colour, 0.1));
    paint.addColorStop(1, translucent(colour, 0.4));
    context.fillStyle = paint;
    context.beginPath();
    context.moveTo(x, y);
    context.arc(x, y, SCALE, -frame.angle - half, -frame.angle + half);
    context.closePath();
    context.fill();
    context.strokeStyle = colour;
    context.lineWidth = 3.4;
    context.lineCap = "butt";
    context.beginPath();
    context.arc(x, y, SCALE, -frame.angle - half, -frame.angle + half);
    context.stroke();
    context.lineCap = "round";
    for (const side of [-half, half]) line(context, [polar(SCALE - 7, frame.angle + side), polar(SCALE + 7, frame.angle + side)], colour, 2.2);
    const at = polar(SCALE - 34, frame.angle + half + 0.16);
    write(context, `±${fixed(DEGREES / frame.stiffness, 1)}°`, at, 12.5 * text, colour, "center", "600");
  }

  function drawGhost(context, angle) {
    const { colours, translucent } = Live.palette;
    context.strokeStyle = translucent(colours.twin, 0.9);
    context.lineWidth = 1.6;
    context.setLineDash([5, 5]);
    traceForearm(context, angle, 0);
    context.stroke();
    context.setLineDash([]);
  }

  /** Draw both strings: around the drive's pulley, over the spring, around the joint's pulley. */
  function drawStrings(context, frame, device, text) {
    const { colours } = Live.palette, scale = PULLEY / device.jointRadius;
    [ABOVE, BELOW].forEach((side, k) => {
      const force = frame.tension[k], share = force / device.maxForce, taut = force > 0;
      const colour = taut ? Live.palette.tension(share) : colours.faint, thick = 2.2 + 3 * Math.min(share, 1.2);
      const y = JOINT[1] + side * PULLEY, stretch = frame.strings[k];
      const end = clamp(SPRING_AT[side] + side * PULLEY * frame.angle, DRIVE_X + 84, JOINT[0] - 18);
      const start = Math.max(end - SPRING_LENGTH - STRETCH * scale * Math.max(stretch, 0), DRIVE_X + 26);
      const slack = scale * Math.max(-stretch, 0);
      const leavesAt = -side * Math.max(-side * frame.angle, Math.PI / 2), leaves = polar(PULLEY, leavesAt);
      drawString(context, [DRIVE_X, y], [start, y], slack, colour, thick);
      drawString(context, [end, y], leaves, slack, colour, thick);
      drawSpring(context, start, end, y, colour);
      context.strokeStyle = colour;
      context.lineWidth = thick;
      context.beginPath();
      context.arc(...JOINT, PULLEY, -leavesAt, -frame.angle, side * (frame.angle - leavesAt) < 0 === (side === ABOVE));
      context.stroke();
      const label = taut ? `${fixed(force, 1)} N` : "slack";
      write(context, label, [DRIVE_X + 34, y - side * (10 + 6 * text)], 13 * text, taut ? colours.ink : colours.external, "left", "600");
    });
  }

  /** A piece of string; a slack one sags by its spare length. */
  function drawString(context, [x0, y0], [x1, y1], slack, colour, thick) {
    const length = Math.hypot(x1 - x0, y1 - y0), sag = Math.min(Math.sqrt(0.375 * length * slack), 14);
    context.strokeStyle = colour;
    context.lineWidth = thick;
    context.beginPath();
    context.moveTo(x0, y0);
    context.quadraticCurveTo(0.5 * (x0 + x1), 0.5 * (y0 + y1) + 2 * sag, x1, y1);
    context.stroke();
  }

  function drawSpring(context, left, right, y, colour) {
    const coils = 7, lead = 4, high = 8, pitch = (right - left - 2 * lead) / (2 * coils);
    const points = [[left, y], [left + lead, y]];
    for (let k = 1; k < 2 * coils; k++) points.push([left + lead + pitch * k, y + (k % 2 ? high : -high)]);
    points.push([right - lead, y], [right, y]);
    line(context, points, colour, 2.2);
    disc(context, [left, y], 3.2, colour);
    disc(context, [right, y], 3.2, colour);
  }

  function drawDrives(context, frame, device, text) {
    const { colours } = Live.palette;
    const radius = clamp((PULLEY * device.driveRadius) / device.jointRadius, 9, 20);
    [[ABOVE, "biceps", colours.biceps, "circle"], [BELOW, "triceps", colours.triceps, "triangle"]].forEach(([side, name, colour, shape], k) => {
      const centre = [DRIVE_X, JOINT[1] + /** @type {number} */ (side) * (PULLEY - radius)];
      disc(context, centre, radius, colours.card, colour, 2.5);
      line(context, [centre, polar(radius - 1.5, frame.driveAngles[k], centre)], colour, 3);
      disc(context, centre, 3, colour);
      const at = [DRIVE_X - 26, JOINT[1] + /** @type {number} */ (side) * 77];
      mark(context, shape, at[0] + 4, at[1], 4.5, colour);
      write(context, name, [at[0] + 14, at[1]], 13 * text, colour, "left", "600");
      if (frame.agonist === -side) {
        const begin = at[0] + 14 + context.measureText(`${name} `).width;
        context.font = font(11 * text, "600");
        const wide = context.measureText("agonist").width + 14;
        context.fillStyle = colour;
        context.beginPath();
        context.roundRect(begin, at[1] - 9 * text, wide, 18 * text, 9 * text);
        context.fill();
        write(context, "agonist", [begin + 7, at[1]], 11 * text, colours.card, "left", "600");
      }
    });
  }

  function drawObstacle(context, frame, { angle, side }, text) {
    const { colours, translucent } = Live.palette;
    const touched = frame.contact !== 0, edge = touched ? colours.external : colours.muted;
    const near = 0.5 * FOREARM, far = 0.86 * FOREARM, deep = 30;
    const corner = (along, into) => beside(along, side * (0.42 * WIDTH + into), angle);
    const block = [corner(near, 0), corner(far, 0), corner(far, deep), corner(near, deep)];
    fill(context, block, colours.card);
    fill(context, block, translucent(edge, 0.2));
    for (let start = near - deep + 9; start < far; start += 9) {
      const low = Math.max(start, near), high = Math.min(start + deep, far);
      line(context, [corner(low, low - start), corner(high, high - start)], edge, 1.2);
    }
    line(context, [corner(near, 0), corner(far, 0)], edge, 3.4);
    if (touched) {
      const at = corner(0.5 * (near + far), deep + 26);
      write(context, `${fixed(frame.contact, 2)} N m`, at, 12 * text, colours.external, "center", "600");
    }
  }

  function traceForearm(context, angle, grow) {
    const wide = 0.5 * WIDTH + grow, narrow = 0.36 * WIDTH + grow;
    context.beginPath();
    context.moveTo(...beside(0, wide, angle));
    context.lineTo(...beside(FOREARM, narrow, angle));
    context.arc(...polar(FOREARM, angle), narrow, -angle - Math.PI / 2, -angle + Math.PI / 2);
    context.lineTo(...beside(0, -wide, angle));
    context.closePath();
  }

  function drawForearm(context, angle) {
    const { colours } = Live.palette;
    traceForearm(context, angle, 0);
    context.fillStyle = colours.skin;
    context.fill();
    context.strokeStyle = colours.forearm;
    context.lineWidth = 2.4;
    context.stroke();
    line(context, [polar(FOREARM + 0.36 * WIDTH, angle), polar(SCALE, angle)], colours.forearm, 2);
    disc(context, JOINT, PULLEY - 6, colours.card, colours.forearm, 2);
    for (let k = 0; k < 4; k++) {
      const turn = angle + (k * Math.PI) / 2;
      line(context, [JOINT, polar(PULLEY - 8, turn)], k ? colours.line : colours.forearm, 3);
    }
    disc(context, JOINT, 8, colours.card, colours.forearm, 3);
  }

  function drawPayload(context, frame, text) {
    const { colours } = Live.palette, at = polar(FOREARM, frame.angle);
    disc(context, at, 17 * Math.sqrt(text), colours.ink);
    write(context, frame.payload.toPrecision(2).replace(/\.?0+$/, ""), [at[0], at[1] - 4 * text], 11 * text, colours.card, "center", "600");
    write(context, "kg", [at[0], at[1] + 7 * text], 9 * text, colours.card, "center");
  }

  function drawSetpoint(context, angle, handle, active, text) {
    const { colours, translucent } = Live.palette;
    line(context, [polar(PULLEY, angle), polar(SCALE, angle)], colours.setpoint, 2, [7, 6]);
    const at = polar(SCALE, angle);
    if (handle) disc(context, at, active ? 20 : 15, translucent(colours.setpoint, active ? 0.3 : 0.18));
    mark(context, "diamond", at[0], at[1], handle ? 8.5 : 6, colours.setpoint);
    if (active) write(context, `${fixed(angle * DEGREES, 0)}°`, polar(SCALE - 26, angle + 0.12), 13 * text, colours.setpoint, "center", "700");
  }

  /** Draw the arrow of a push, or the band by which a pointer pulls. */
  function drawPush(context, frame, device, pull, text) {
    const { colours } = Live.palette, side = Math.sign(frame.push), angle = frame.angle;
    const strength = Math.min(Math.abs(frame.push) / (device.maxForce * device.jointRadius), 1);
    const label = `${frame.push > 0 ? "+" : ""}${fixed(frame.push, 2)} N m`;
    if (pull) {
      const hold = polar(clamp(onForearm(pull, angle).along, 60, FOREARM), angle);
      line(context, [hold, pull], colours.external, 2 + 3 * strength, [2, 7]);
      disc(context, hold, 6, colours.external);
      disc(context, pull, 11, Live.palette.translucent(colours.external, 0.25), colours.external, 2);
      write(context, label, [pull[0], pull[1] - 24], 13 * text, colours.external, "center", "700");
      return;
    }
    const long = 30 + 46 * strength, point = (distance, shift = 0) => beside(PUSH_AT * FOREARM + shift, -side * (0.5 * WIDTH + distance), angle);
    line(context, [point(11), point(long)], colours.external, 5);
    fill(context, [point(0), point(15, 9), point(15, -9)], colours.external);
    const tail = point(long + 16);
    write(context, label, [tail[0] + 26 * Math.sign(tail[0] - point(0)[0]), tail[1]], 13 * text, colours.external, "center", "700");
  }

  const BAR = { left: 40, top: 30, wide: 132, high: 8 }; // of the colours of the tensions

  function drawTensionScale(context, device, text) {
    const { colours } = Live.palette, { left, top, wide, high } = BAR;
    const paint = context.createLinearGradient(left, 0, left + wide, 0);
    for (let k = 0; k <= 10; k++) paint.addColorStop(k / 10, Live.palette.tension(k / 10));
    write(context, "string tension [N]", [left, top - 14], 11 * text, colours.muted);
    context.fillStyle = paint;
    context.beginPath();
    context.roundRect(left, top, wide, high, 4);
    context.fill();
    [0, 0.5, 1].forEach((share) => {
      write(context, (share * device.maxForce).toFixed(0), [left + share * wide, top + high + 15], 11 * text, colours.muted, share === 0 ? "left" : share === 1 ? "right" : "center");
    });
  }

  /** A mark for each string on the colours of the tensions. */
  function drawTensionMarks(context, frame, device) {
    const { colours } = Live.palette, { left, top, wide, high } = BAR;
    [["circle", colours.biceps], ["triangle", colours.triceps]].forEach(([shape, colour], k) => {
      const x = left + wide * clamp(frame.tension[k] / device.maxForce, 0, 1);
      mark(context, /** @type {any} */ (shape), x, top + 0.5 * high, 5.4, colours.card);
      mark(context, /** @type {any} */ (shape), x, top + 0.5 * high, 4, /** @type {string} */ (colour));
    });
  }

  return { draw, toDrawing, angleAt, onForearm, partAt, FOREARM, JOINT };
})();
