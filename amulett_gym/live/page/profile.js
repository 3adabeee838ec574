"use strict";
// A device of one's own, dropped as a profile: checked as `profile.py` does, and packed as `simulation/layout.py` does.
// Names are those of Python, so that the two can be compared line by line.

Live.profile = (() => {
  const { UserError, DEGREES } = Live.base;
  const { checked, isObject, oneOf } = Amulett.base;

  const CELLS = 256;
  const LEAST_INERTIA = 1e-9; // [kg m2]
  const STABLE_STEP = 2.5; // time constants in an integration step
  const DIP = 0.05;
  const BELOW_FLOOR = { clamp: 0, hold: 1, ignore: 2 };
  const AGONIST = { switching: 0, biceps: 1, triceps: -1 };
  const REFERENCES = { "minimum-jerk": 0, "critically-damped": 1, "first-order": 2 }; // control/reference_motion.py
  const ELSEWHERE = "this page cannot compute; give the file to 'amulett live --profile FILE', which can";

  /**
   * Return a device for the page's list.
   * @param {any} content of the file @param {string} file its name
   * @param {any} layout of the simulation @param {any} data the page's data
   */
  function read(content, file, layout, data) {
    const what = `'${file}'`, { schema, bases } = data.profile;
    const profile = resolve(content, what, bases);
    const spring = isObject(profile.spring) ? profile.spring : {};
    if (spring.measured_curve) throw new UserError(`${what} has a 'spring.measured_curve', which ${ELSEWHERE}`);
    if (profile.structure) throw new UserError(`${what} has a 'structure', which ${ELSEWHERE}`);
    if (spring.beyond === "held") profile.spring = { ...spring, beyond: null };
    const sound = checked(schema, profile, what);
    check(sound, what);
    const base = data.devices.find((each) => each.id === content.base) || data.devices.find((each) => each.id === Object.keys(bases)[0]);
    return entry(pack(sound, layout, base.content), what, base.title);
  }

  function entry(content, what, base) {
    const { joint_radius: jointRadius, drive_radius: driveRadius, max_force: maxForce } = content.parameters;
    return {
      title: content.name, description: `of ${what}; its costs are in units of the ${base}'s`, unfit: content.unfit,
      geometry: { jointRadius, driveRadius, maxForce }, content,
    };
  }

  /** A profile with the values of its base where it gives none. */
  function resolve(content, what, bases) {
    const { base } = content;
    if (base === undefined || base === null) return { ...content };
    oneOf(`base of ${what}`, base, Object.keys(bases));
    return merge(bases[base], content);
  }

  function merge(below, changes) {
    const merged = { ...below };
    for (const [key, value] of Object.entries(changes)) {
      const old = Object.hasOwn(merged, key) ? merged[key] : undefined;
      Object.defineProperty(merged, key, { value: isObject(old) && isObject(value) ? merge(old, value) : value, enumerable: true, configurable: true, writable: true });
    }
    return merged;
  }

  /** What no schema says: how values have to fit each other. */
  function check({ plant, spring, drives, loop, variable_stiffness: stiffness }, what) {
    const wrong = (text) => { throw new UserError(`${what}: ${text}`); };
    if (!plant.masses.some(({ mass, arm }) => mass * arm ** 2 >= LEAST_INERTIA)) wrong(`'plant.masses' give no inertia; at least one needs mass times arm squared >= ${LEAST_INERTIA} kg m2`);
    if (spring.beyond === "hard-stop" && spring.stop_stiffness === null) wrong("'spring.beyond' is hard-stop, so stop_stiffness is needed: the stiffness of the stop in N/m");
    if (spring.beyond !== "hard-stop" && spring.stop_stiffness !== null) wrong(`'spring.stop_stiffness' is ${spring.stop_stiffness} N/m; only beyond: hard-stop has a stop`);
    if (spring.free_length > spring.half_width) wrong(`'spring.free_length' is ${spring.free_length} m; it has to be at most half_width, ${spring.half_width} m`);
    if (spring.half_width > 100 * spring.max_deflection) wrong(`'spring.half_width' is ${spring.half_width} m; it has to be at most 100 times max_deflection, ${spring.max_deflection} m`);
    if (drives.stall_torque !== null && drives.lag > 0 && drives.rate_limit_deg === null) wrong(`'drives.stall_torque' is ${drives.stall_torque} N m; with a lag it needs rate_limit_deg, the speed without load`);
    if (loop.tie_width > loop.switch_hysteresis) wrong(`'loop.tie_width' is ${loop.tie_width} m; it has to be at most switch_hysteresis, ${loop.switch_hysteresis} m`);
    if (stiffness.minimum_tension > stiffness.nominal_tension) wrong(`'variable_stiffness.minimum_tension' is ${stiffness.minimum_tension} N; it has to be at most nominal_tension, ${stiffness.nominal_tension} N`);
    const least = loop.control_period / loop.substeps / STABLE_STEP;
    if (drives.lag > 0 && drives.lag < least) wrong(`'drives.lag' is ${drives.lag} s; with these integration steps it has to be 0, or at least ${least.toPrecision(3)} s`);
  }

  // ----- look-up tables: model/spring.py -----

  /** Slopes of the monotone cubic through points (PCHIP, as SciPy computes them). */
  function slopes(x, y) {
    const h = [], m = [], found = [];
    for (let k = 0; k + 1 < x.length; k++) {
      h.push(x[k + 1] - x[k]);
      m.push((y[k + 1] - y[k]) / h[k]);
    }
    for (let k = 1; k < m.length; k++) {
      const flat = Math.sign(m[k]) !== Math.sign(m[k - 1]) || m[k] === 0 || m[k - 1] === 0;
      const before = 2 * h[k] + h[k - 1], after = h[k] + 2 * h[k - 1];
      found.push(flat ? 0 : 1 / ((before / m[k - 1] + after / m[k]) / (before + after)));
    }
    const end = (h0, h1, m0, m1) => {
      const slope = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1);
      if (Math.sign(slope) !== Math.sign(m0)) return 0;
      return Math.sign(m0) !== Math.sign(m1) && Math.abs(slope) > 3 * Math.abs(m0) ? 3 * m0 : slope;
    };
    const n = m.length - 1;
    return [end(h[0], h[1], m[0], m[1]), ...found, end(h[n], h[n - 1], m[n], m[n - 1])];
  }

  /** Cubics of each cell, constant term first, over cells of width `h`. */
  function cubics(x, y) {
    const d = slopes(x, y), found = [];
    for (let k = 0; k + 1 < x.length; k++) {
      const h = x[k + 1] - x[k], slope = (y[k + 1] - y[k]) / h, t = (d[k] + d[k + 1] - 2 * slope) / h;
      found.push([y[k], d[k], (slope - d[k]) / h - t, t / h]);
    }
    return found;
  }

  const range = (count) => Array.from({ length: count }, (_, k) => k);
  /** `count + 1` numbers from 0 to `end`. */
  const even = (end, count = CELLS) => range(count + 1).map((k) => (k === count ? end : k * (end / count)));
  /** A table over cells of width 1. */
  const table = (values) => cubics(range(values.length), values);
  const value = ([a, b, c, d], w) => a + w * (b + w * (c + w * d));

  /** The values of the monotone cubic through (x, y) at rising places. */
  function resampled(x, y, places) {
    const found = cubics(x, y);
    let k = 0;
    return places.map((place) => {
      while (k + 2 < x.length && place >= x[k + 1]) k++;
      return value(found[k], place - x[k]);
    });
  }

  /** A table's value at a position from 0 to 1. */
  function lookUp(cells, position) {
    const scaled = Math.min(Math.max(position, 0), 1) * cells.length, cell = Math.min(Math.floor(scaled), cells.length - 1);
    return value(cells[cell], scaled - cell);
  }

  /** The position at which a rising table has a value. */
  function inverse(cells, wanted) {
    let [low, high] = [0, 1];
    for (let k = 0; k < 60; k++) {
      const middle = 0.5 * (low + high);
      if (lookUp(cells, middle) < wanted) low = middle;
      else high = middle;
    }
    return 0.5 * (low + high);
  }

  /** The look-up tables of a spring assembly by its geometry. */
  function tablesOf({ stiffness, half_width: width, free_length: free, max_deflection: most, beyond, stop_stiffness: stop }) {
    const deflection = even(most), length = deflection.map((y) => Math.hypot(width, y));
    const force = deflection.map((y, k) => 2 * stiffness * y * (1 - free / length[k])), slider = length.map((each) => each - width);
    const root = slider.map(Math.sqrt), places = even(root[CELLS]), forces = table(force);
    const slope = [...forces.map((cell) => cell[1]), forces[CELLS - 1][1] + 2 * forces[CELLS - 1][2] + 3 * forces[CELLS - 1][3]].map((each) => (each * CELLS) / most);
    const largest = lookUp(forces, 1);
    return {
      force: forces, spring: table(slider), slope,
      estimate: table(resampled(root, force, places)), estimatedSlope: table(resampled(root, slope, places)),
      position: table([0, ...even(1).slice(1).map((share) => inverse(forces, share ** 4 * largest))]),
      most, mostSlider: slider[CELLS], largest,
      beyond: beyond === "continued"
        ? { slope: 2 * stiffness * most, free_length: free / most, width: width / most, slider: most }
        : { slope: (stop || 0) * most, free_length: 0, width: 0, slider: 0 },
    };
  }

  const toBase64 = (cells) => {
    const bytes = new Uint8Array(Float64Array.from(cells.flat()).buffer);
    let text = "";
    for (let k = 0; k < bytes.length; k += 8192) text += String.fromCharCode(...bytes.subarray(k, k + 8192));
    return btoa(text);
  };

  // ----- records: simulation/layout.py -----

  const RADIANS = 1 / DEGREES;
  const number = (of) => (Number.isFinite(of) ? of : of > 0 ? "Infinity" : "-Infinity");
  const inertiaOf = (masses) => (masses.reduce((sum, { mass }) => sum + mass, 0) * Math.max(...masses.map(({ arm }) => arm)) ** 2) / 12 + masses.reduce((sum, { mass, arm }) => sum + mass * arm ** 2, 0);

  /** The device as the simulation takes it: `device_data` of live/core/data.py. */
  function pack(profile, layout, base) {
    const tables = tablesOf(profile.spring), { plant, damping } = profile, loops = {};
    const unfit = { [layout.firmware.loop]: layout.firmware.otherDevice };
    const parameters = parametersOf(profile, tables, false), only = parametersOf(profile, tables, true);
    for (const loop of layout.loops.slice(2)) {
      const why = misfit(loop, profile.loops[loop.replaceAll("-", "_")], tables, layout);
      if (why) unfit[loop] = why;
      else loops[loop] = gainsOf(loop, profile, tables, layout);
    }
    return {
      format: "amulett-live-device", version: 1, name: profile.name, angleLimitDeg: plant.angle_limit_deg, orientation: plant.orientation,
      masses: plant.masses.map(({ mass, arm }) => [mass, arm]), payloadArm: Math.max(...plant.masses.map(({ arm }) => arm)), dampingKeeps: damping.keeps,
      parameters, positionOnly: Object.fromEntries(Object.entries(only).filter(([name, each]) => each !== parameters[name])), loops, unfit,
      tables: { force_table: toBase64(tables.force), spring_table: toBase64(tables.spring), estimate_table: toBase64(tables.estimate), position_table: toBase64(tables.position), slope_table: toBase64(tables.estimatedSlope) },
      lawConstants: [plant.joint_pulley_radius, inertiaOf(plant.masses), damping.a, damping.b, parameters.damping_c, damping.d],
      laws: base.laws, prices: base.prices,
    };
  }

  function parametersOf({ plant, damping, drives, sensors, loop, variable_stiffness: stiffness }, tables, positionOnly) {
    const limit = (degrees) => number(degrees === null ? Infinity : degrees * RADIANS);
    const resolution = sensors.potentiometer_bits ? sensors.potentiometer_travel / 2 ** sensors.potentiometer_bits : 0;
    const doubt = Math.max(resolution + 3.5 * sensors.potentiometer_noise, 1e-6 * tables.mostSlider);
    const gains = (name, pid, unit) => ({
      [`${name}_kp`]: pid.kp * unit, [`${name}_ki`]: pid.ki * unit, [`${name}_kd`]: pid.kd * unit,
      [`${name}_filter`]: pid.derivative_filter, [`${name}_on_error`]: Number(pid.derivative_on === "error"),
    });
    const { beyond } = tables;
    return {
      drive_radius: plant.drive_pulley_radius, joint_radius: plant.joint_pulley_radius,
      angle_limit: plant.angle_limit_deg * RADIANS, velocity_limit: plant.velocity_limit_deg * RADIANS,
      inverse_max_deflection: 1 / tables.most, max_spring_deflection: tables.mostSlider, max_force: tables.largest,
      damping_a: damping.a, damping_b: damping.b, damping_c: damping.fit === "shifted" ? damping.b * damping.c : damping.c, damping_d: damping.d,
      damping_by_mean: Number(damping.preload === "mean"),
      extended: Number(beyond.slope > 0 || beyond.slider > 0 || drives.stall_torque !== null),
      beyond_slope: beyond.slope, beyond_free_length: beyond.free_length, beyond_width: beyond.width, beyond_slider: beyond.slider,
      stall_torque: number(drives.stall_torque === null ? Infinity : drives.stall_torque),
      inverse_lag: drives.lag > 0 ? 1 / drives.lag : 0, rate_limit: limit(drives.rate_limit_deg), command_limit: limit(drives.command_limit_deg),
      encoder_resolution: sensors.encoder_bits ? (2 * Math.PI) / 2 ** sensors.encoder_bits : 0, encoder_noise: sensors.encoder_noise_deg * RADIANS,
      slider_resolution: resolution, slider_travel: sensors.potentiometer_travel, slider_noise: sensors.potentiometer_noise,
      slider_end: Math.min(tables.mostSlider, sensors.potentiometer_travel) - doubt,
      force_filter: sensors.force_filter, force_floor: sensors.force_floor, below_floor: BELOW_FLOOR[sensors.below_floor],
      control_period: loop.control_period, substeps: loop.substeps,
      ...gains("position", positionOnly ? loop.position_only : loop.position, 1), ...gains("tension", loop.tension, RADIANS),
      tension_loop: Number(!positionOnly), antagonist_share: Number(positionOnly || loop.wiring === "sum"),
      position_only_offset: loop.offset_deg * RADIANS, fixed_agonist: AGONIST[loop.agonist],
      switch_filter: loop.switch_filter, switch_hysteresis: loop.switch_hysteresis, tie_width: loop.tie_width, tie_error: loop.tie_error_deg * RADIANS,
      velocity_filter: loop.velocity_filter, nominal_tension: stiffness.nominal_tension, minimum_tension: stiffness.minimum_tension,
      error_offset: stiffness.error_offset_deg * RADIANS, law: 0, margin: 2 * RADIANS,
    };
  }

  /** Why a loop does not fit the springs; empty if it does. */
  function misfit(loop, gains, tables, layout) {
    for (const name of ["taut_force", "least_tension"]) {
      if ((gains[name] || 0) >= tables.largest) return `it needs strings with more than ${gains[name]} N ('${name}'); these springs give at most ${tables.largest.toPrecision(4)} N`;
    }
    if (!layout.byStiffness.includes(loop)) return "";
    const { slope } = tables, last = slope[slope.length - 1];
    let [highest, dip] = [-Infinity, 0];
    for (const each of slope) {
      highest = Math.max(highest, each);
      dip = Math.max(dip, highest - each);
    }
    return dip > DIP * highest || last - slope[0] <= DIP * highest ? "it sets the joint stiffness, so the slope of the springs has to rise with the deflection; it does not" : "";
  }

  function gainsOf(loop, profile, tables, layout) {
    const { drives, plant, sensors, loop: { control_period: period } } = profile, gains = profile.loops[loop.replaceAll("-", "_")];
    const share = drives.lag > 0 ? -Math.expm1(-period / drives.lag) : 1, floor = Math.min(sensors.force_floor, tables.largest), inertia = inertiaOf(plant.masses);
    const regulator = loop === "torque-stiffness" ? regulatorGains(gains, inertia) : [0, 0, 0];
    const own = {
      loop: layout.loops.indexOf(loop) - 2, reference_shape: REFERENCES[gains.reference],
      inverse_max_deflection: 1 / tables.most, max_force: tables.largest, floor_position: floor > 0 ? inverse(tables.force, floor) : 0,
      drive_share: share, highest_factor: 1 / share, drive_step: number(drives.rate_limit_deg === null ? Infinity : drives.rate_limit_deg * RADIANS * period),
      inertia, weight: plant.orientation === "vertical" ? layout.constants.GRAVITY * plant.masses.reduce((sum, { mass, arm }) => sum + mass * arm, 0) : 0,
      torque_ki: regulator[0], torque_kp: regulator[1], torque_kd: regulator[2],
    };
    const found = {};
    for (const [name, [, , count]] of Object.entries(layout.records.loop.fields)) {
      if (count === 1) found[name] = name in own ? own[name] : Object.hasOwn(gains, name) ? gains[name] : 0;
    }
    found.lead *= drives.lag;
    return found;
  }

  /** `regulator_gains` of control/torque_stiffness.py. */
  function regulatorGains({ integral_weight: q0, angle_weight: q1, rate_weight: q2, torque_weight: r }, inertia) {
    const ofIntegral = Math.sqrt(q0 / r);
    let [ofAngle, ofRate] = [0, 0];
    for (let k = 0; k < 40; k++) {
      ofAngle = Math.sqrt(q1 / r + 2 * ofIntegral * ofRate);
      ofRate = Math.sqrt(q2 / r + 2 * inertia * ofAngle);
    }
    return [ofIntegral, ofAngle, ofRate];
  }

  return { read };
})();
