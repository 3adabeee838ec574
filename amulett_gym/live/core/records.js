"use strict";
// Devices and scenarios as the records that the WebAssembly reads. Their layout is in its own section (`build.py`).

Amulett.records = (() => {
  const { AmulettError, checked, fromBase64, isObject, number, shown } = Amulett.base;
  const RADIANS = Math.PI / 180;
  const DEVICE = "amulett-live-device";

  const READ = { f8: "getFloat64", f4: "getFloat32", i8: "getBigInt64", i1: "getInt8", u8: "getBigUint64" };
  const WRITE = { f8: "setFloat64", f4: "setFloat32", i8: "setBigInt64", i1: "setInt8", u8: "setBigUint64" };
  const SIZE = { f8: 8, f4: 4, i8: 8, i1: 1, u8: 8 };

  /**
   * The fields of a record in memory.
   * @param {ArrayBuffer} buffer @param {number} start @param {{size: number, fields: Object<string, any[]>}} layout
   */
  function record(buffer, start, layout) {
    const view = new DataView(buffer, start, layout.size);
    return {
      bytes: new Uint8Array(buffer, start, layout.size),
      /** @param {string} name @param {number} [k] @returns {number} */
      get(name, k = 0) {
        const [type, offset] = layout.fields[name];
        return Number(view[READ[type]](offset + k * SIZE[type], true));
      },
      /** @param {string} name @param {number | bigint} value @param {number} [k] */
      set(name, value, k = 0) {
        const [type, offset] = layout.fields[name];
        const wide = type === "i8" || type === "u8";
        view[WRITE[type]](offset + k * SIZE[type], wide ? BigInt(value) : Number(value), true);
      },
    };
  }

  /** A number of a device's JSON, which has no infinity. */
  function plain(what, value) {
    if (value === "Infinity" || value === "-Infinity") return Number(value);
    return number(what, value);
  }

  /**
   * Return a device that can be played, checked: what `device_data` of `data.py` returns.
   * @param {any} layout @param {any} data
   */
  function checkDevice(layout, data) {
    if (!isObject(data) || data.format !== DEVICE) {
      throw new AmulettError(`the device is ${shown(data)}; it has to be what amulett_gym.live.core.data.device_data returns, an object whose 'format' is '${DEVICE}'`);
    }
    if (data.version !== 1) throw new AmulettError(`the device's 'version' is ${shown(data.version)}; this page reads 1: make it with this amulett-gym`);
    if (typeof data.name !== "string" || !data.name) throw new AmulettError("the device has no 'name'");
    for (const key of ["parameters", "positionOnly", "loops", "unfit", "tables", "prices", "laws"]) {
      if (!isObject(data[key])) throw new AmulettError(`device '${data.name}': '${key}' is ${shown(data[key])}; it has to be an object`);
    }
    return data;
  }

  /** Write numbers by name, and tables, into a record; every field is needed. */
  function fill(into, layout, values, tables, what) {
    for (const [name, [, , count]] of Object.entries(layout.fields)) {
      if (count === 1) {
        if (!Object.hasOwn(values, name)) throw new AmulettError(`${what}: '${name}' is missing`);
        into.set(name, plain(`${what}: '${name}'`, values[name]));
        continue;
      }
      const text = tables[name];
      const bytes = typeof text === "string" ? fromBase64(text, `${what}: the table '${name}'`) : new Uint8Array(0);
      if (bytes.length !== 8 * count) throw new AmulettError(`${what}: the table '${name}' has ${bytes.length} bytes; it has to have ${8 * count}`);
      const numbers = new Float64Array(bytes.buffer);
      if (!numbers.every(Number.isFinite)) throw new AmulettError(`${what}: the table '${name}' holds a number that is not finite`);
      numbers.forEach((value, k) => into.set(name, value, k));
    }
  }

  /** Write a device with one of its loops. @param {any} layout @param {any} device @param {string} loop */
  function writeDevice(layout, device, loop, parameters, gains) {
    const what = `device '${device.name}'`, own = loop === "position-only" ? device.positionOnly : {};
    fill(parameters, layout.records.device, { ...device.parameters, ...own }, device.tables, what);
    if (!["decentralized", "position-only"].includes(loop)) {
      if (device.unfit[loop]) throw new AmulettError(`the loop '${loop}' does not fit the device '${device.name}': ${device.unfit[loop]}`);
      if (loop === layout.firmware.loop) return;
      const { loop_force_table: force = device.tables.force_table } = device.tables;
      fill(gains, layout.records.loop, device.loops[loop] || {}, { ...device.tables, force_table: force }, `${what}, loop '${loop}'`);
    }
  }

  /**
   * Return a scenario, as a scenario file holds it, with all of its keys, checked.
   * @param {any} layout @param {any} content @param {any} device
   */
  function checkScenario(layout, content, device) {
    const what = "scenario", wrong = (text) => { throw new AmulettError(`${what}: ${text}`); };
    const { noise_seed: seed = null, ...others } = isObject(content) ? content : { content };
    const found = checked(layout.schemas.scenario, others, what);
    if (found.wearer !== null) wrong("'wearer' is given, and this device is not worn: delete the wearer");
    if (found.device.name !== null && found.device.name !== device.name) wrong(`'device.name' is '${found.device.name}'; this device is '${device.name}': delete the name`);
    const limit = device.angleLimitDeg;
    if (!(Math.abs(found.initial_angle_deg) < limit)) wrong(`'initial_angle_deg' is ${found.initial_angle_deg}; the device's limit is +-${limit} deg`);
    found.moves.forEach((move, k) => {
      const before = found.moves[k - 1];
      if (before && move.time < (before.time + before.duration) * (1 - 1e-6)) wrong(`'moves.${k}' begins before the last one has ended`);
      if (move.duration > 0 && move.duration < 1e-3) wrong(`'moves.${k}.duration' is ${move.duration} s, less than a millisecond; 0 is a step`);
    });
    found.pushes.forEach((push, k) => {
      if (push.rise > 0 && (push.rise < 1e-3 || 2 * push.rise > push.duration * (1 + 1e-6))) wrong(`'pushes.${k}.rise' is ${push.rise} s; it has to be 0, or at least a millisecond and at most half of the duration`);
    });
    if (found.setpoint) checkSamples(found.setpoint, wrong);
    if (found.setpoint && found.moves.length) wrong("'moves' and 'setpoint' are both given; give one of them");
    if (found.setpoint && !("initial_angle_deg" in others)) found.initial_angle_deg = found.setpoint.angle_deg[0];
    return { ...found, noise_seed: checkSeed(seed) };
  }

  function checkSamples({ time, angle_deg: angle }, wrong) {
    if (time.length !== angle.length) wrong(`'setpoint.time' has ${time.length} samples and 'setpoint.angle_deg' ${angle.length}; they have to be equally many`);
    time.forEach((value, k) => {
      if (!(value >= 0 && value <= 1e6 && value >= (time[k - 1] || 0))) wrong(`'setpoint.time' of sample ${k} is ${value}; times have to rise, from 0 to 1e6 s`);
      if (Math.abs(angle[k]) > 180) wrong(`'setpoint.angle_deg' of sample ${k} is ${angle[k]}; it has to be from -180 to 180`);
    });
  }

  /** A key of the sensor noise: a whole number of 64 bits, above 2^53 as a text. */
  function checkSeed(seed) {
    if (seed === null) return null;
    const fits = typeof seed === "bigint" || Number.isSafeInteger(seed) || (typeof seed === "string" && /^\d{1,20}$/.test(seed));
    const value = fits ? BigInt(seed) : -1n;
    if (value < 0n || value >= 2n ** 64n) throw new AmulettError(`the seed is ${String(seed).slice(0, 60)}; it has to be a whole number of at least 0, above 2^53 as a text`);
    return value;
  }

  /** The largest stiffness and damping of an obstacle that the integration step can resolve. @returns {number[]} */
  function mostObstacle(device, inertia) {
    const step = device.parameters.control_period / device.parameters.substeps;
    return [(0.25 * inertia) / step ** 2, (0.1 * inertia) / step];
  }

  /** Set J, M_m and the factor of the decay rate of an arm with a payload: `load_arm` of simulation/layout.py. */
  function loadArm(layout, device, into, mass, arm) {
    const masses = [...device.masses, [mass, mass > 0 ? arm : 0]];
    const inertiaOf = (all) => (all.reduce((sum, [m]) => sum + m, 0) * Math.max(...all.map(([, l]) => l)) ** 2) / 12 + all.reduce((sum, [m, l]) => sum + m * l ** 2, 0);
    const inertia = inertiaOf(masses) * into.get("inertia_factor"), plane = layout.orientations[into.get("orientation")];
    const vertical = plane === "vertical" || (plane === "profile" && device.orientation === "vertical");
    into.set("payload_mass", mass);
    into.set("payload_arm", arm);
    into.set("inertia", inertia);
    into.set("static_torque", vertical ? layout.constants.GRAVITY * masses.reduce((sum, [m, l]) => sum + m * l, 0) : 0);
    into.set("friction", into.get("damping_factor") * (device.dampingKeeps === "torque" ? inertiaOf(device.masses) / inertia : 1));
  }

  /** Write an obstacle, null for none. @param {{angle: number, side: number, stiffness: number, damping: number} | null} of */
  function writeObstacle(device, into, of) {
    const [stiffness, damping] = mostObstacle(device, into.get("inertia"));
    if (of) {
      number("the obstacle's stiffness [N m/rad]", of.stiffness, 0, stiffness * (1 + 1e-6));
      number("the obstacle's damping [N m s/rad]", of.damping, 0, damping * (1 + 1e-6));
    }
    for (const key of ["angle", "side", "stiffness", "damping"]) into.set(`obstacle_${key}`, of ? of[key] : 0);
  }

  /** Write a checked scenario. @param {bigint} seed key of the noise if the scenario has none */
  function writeScenario(layout, device, scenario, seed, into) {
    into.bytes.fill(0);
    const put = (prefix, part, k = 0) => {
      for (const [key, value] of Object.entries(part)) {
        const factor = !prefix && layout.factors.includes(key);
        const name = factor ? `${key}_factor` : prefix + key.replace(/_deg$/, "");
        if (name in layout.records.scenario.fields && typeof value === "number") into.set(name, key.endsWith("_deg") ? value * RADIANS : value, k);
      }
    };
    const hasPath = scenario.setpoint !== null || scenario.moves.length > layout.constants.MAX_MOVES;
    into.set("initial_angle", scenario.initial_angle_deg * RADIANS);
    into.set("initial_tension", scenario.initial_tension === null ? device.parameters.nominal_tension : scenario.initial_tension);
    into.set("measure_from", scenario.measure_from);
    into.set("noise_key", scenario.noise_seed === null ? seed : scenario.noise_seed);
    into.set("orientation", layout.orientations.indexOf(scenario.orientation));
    into.set("family", layout.families.indexOf(scenario.family || (scenario.obstacle ? "contact" : null)));
    put("", scenario.device);
    if (scenario.wave) put("wave_", scenario.wave);
    if (scenario.shake) put("shake_", scenario.shake);
    const { mass = 0, arm = 0 } = scenario.payload || {};
    loadArm(layout, device, into, mass, arm);
    into.set("move_count", hasPath ? layout.constants.ON_PATH : scenario.moves.length);
    if (!hasPath) scenario.moves.forEach((move, k) => put("move_", move, k));
    into.set("push_count", scenario.pushes.length);
    scenario.pushes.forEach((push, k) => {
      put("push_", push, k);
      into.set("push_inverse_rise", push.rise > 0 ? 1 / push.rise : 0, k);
    });
    const { angle_deg: angle = 0, blocks, stiffness, damping } = scenario.obstacle || {};
    writeObstacle(device, into, scenario.obstacle && { angle: angle * RADIANS, side: blocks === "flexion" ? 1 : -1, stiffness, damping });
    return hasPath ? pathOf(layout, scenario) : [];
  }

  /** The parts of a setpoint's path: `pack_path` of tasks/scenario.py. */
  function pathOf(layout, { setpoint, moves, initial_angle_deg: begin }) {
    const { MINIMUM_JERK, LINEAR, STEPS } = layout.shapes;
    let [times, angles, durations, shape] = [moves.map((m) => m.time), moves.map((m) => m.angle_deg), moves.map((m) => m.duration), MINIMUM_JERK];
    if (setpoint) {
      [times, angles, durations, shape] = [setpoint.time, setpoint.angle_deg, setpoint.time.map(() => 0), STEPS];
      if (setpoint.interpolation === "linear") {
        [durations, shape] = [[0, ...times.slice(1).map((time, k) => time - times[k]), 0], LINEAR];
        [times, angles] = [[times[0], ...times], [...angles, angles[angles.length - 1]]];
      }
    }
    if (times.length > layout.constants.MOST_PARTS) throw new AmulettError(`scenario: the setpoint has ${times.length} parts; at most ${layout.constants.MOST_PARTS} can be played`);
    return times.map((time, k) => ({ time, start: (k ? angles[k - 1] : begin) * RADIANS, angle: angles[k] * RADIANS, duration: durations[k], shape }));
  }

  return { record, checkDevice, writeDevice, checkScenario, checkSeed, writeScenario, loadArm, writeObstacle, RADIANS };
})();
