"use strict";
// The laws without a network: amulett_gym/laws/policies.py and parametric.py. A law maps an observation, 13 numbers, to a
// tension. In the loop (eq. 6) it is the WebAssembly that does it, in each control tick.

Amulett.laws = (() => {
  const { AmulettError, isObject, nearest, number, oneOf, shown } = Amulett.base;
  const RADIANS = Math.PI / 180;
  const NAMES = ["constant", "eq6", "eq6-printed", "eq6-held", "eq6-held-printed", "eq6-tuned", "parametric", "policy"];

  /** @param {number} action @param {number[]} range @returns {number} the tension that an action means */
  const tensionOf = (action, [low, high]) => low + 0.5 * (action + 1) * (high - low);
  /** @param {number} tension @param {number[]} range @returns {number} the action that means a tension */
  const actionOf = (tension, [low, high]) => (2 * (tension - low)) / (high - low) - 1;

  /**
   * @typedef {Object} Law
   * @property {any} spec its name and parameters, as JSON
   * @property {string} inLoop which of the WebAssembly's laws acts: "agent", "eq6" or "eq6-printed"
   * @property {Object<string, number>} fields of the device's record that it sets
   * @property {number[] | null} range tensions of an action of -1 and +1; null: the loop's
   * @property {number | null} period time between two actions; null: the arm's
   * @property {number | null} delay control ticks from an agent step's begin to its ramp's; null: the arm's
   * @property {(observation: Float64Array) => number} act returns an action, a 32-bit number from -1 to 1
   * @property {() => any} state what it remembers of the episode, as JSON
   * @property {(state: any) => void} remember
   */

  /**
   * Return a law that can act on a device, checked.
   * @param {any} layout @param {any} given {name, parameters}, with a `policy` that `readPolicy` returned if that is its name; a law that was tuned for
   *   other tensions than the usual ones has a `range`
   * @param {any} device @param {{range: number[], period: number, policies: Map<string, any>}} context
   * @returns {Law}
   */
  function make(layout, given, device, context) {
    const what = "the law";
    if (!isObject(given)) throw new AmulettError(`${what} is ${shown(given)}; it has to be an object such as {name: "constant", parameters: {tension: 10}}`);
    for (const key of Object.keys(given)) oneOf("key of a law", key, ["name", "parameters", "policy", "range"]);
    const name = oneOf("law", given.name, NAMES), { parameters = {} } = given;
    if (name === "policy") return Amulett.policy.make(layout, context.policies, given.policy);
    const plain = { inLoop: "agent", fields: {}, range: null, period: null, delay: null, act: () => 0, state: () => null, remember: () => {} };
    if (name === "constant") {
      const { tension } = read(name, parameters, { tension: device.parameters.nominal_tension });
      reach(`a tension of ${tension} N`, tension, tension, context.range);
      const action = Math.fround(actionOf(tension, context.range));
      return { ...plain, spec: { name, parameters: { tension } }, act: () => action };
    }
    if (name.startsWith("eq6") && name !== "eq6-tuned") return eq6(layout, name, parameters, device, context, plain);
    return tuned(layout, given, device, context, plain);
  }

  /** Return parameters with their defaults; unknown ones are refused. */
  function read(name, given, defaults) {
    if (!isObject(given)) throw new AmulettError(`the parameters of '${name}' are ${shown(given)}; they have to be an object`);
    const names = Object.keys(defaults);
    for (const [key, value] of Object.entries(given)) {
      if (!names.includes(key)) throw new AmulettError(`unknown parameter '${key}' of '${name}'${nearest(key, names)} (allowed: ${names.join(", ")})`);
      number(`'${key}' of '${name}'`, value);
    }
    return { ...defaults, ...given };
  }

  /** Refuse tensions that the actions do not reach. */
  function reach(what, lowest, highest, [low, high]) {
    if (lowest < low - 1e-9 || highest > high + 1e-9) throw new AmulettError(`${what}: the actions in this loop reach from ${low} to ${high} N`);
  }

  /** Eq. 6, in the loop or held over an agent step. */
  function eq6(layout, name, given, device, context, plain) {
    const { nominal_tension, minimum_tension, error_offset } = device.parameters;
    const parameters = read(name, given, { nominal_tension, minimum_tension, error_offset_deg: error_offset / RADIANS });
    const { nominal_tension: nominal, minimum_tension: minimum } = parameters, printed = name.endsWith("-printed");
    number(`'nominal_tension' of '${name}' [N]`, nominal, 1e-3, 1e6);
    number(`'minimum_tension' of '${name}' [N]`, minimum, 0, nominal);
    number(`'error_offset_deg' of '${name}'`, parameters.error_offset_deg, 1e-3, 360);
    // The device's own number, not one that went to degrees and back.
    const offset = "error_offset_deg" in given ? parameters.error_offset_deg * RADIANS : error_offset;
    if (!name.startsWith("eq6-held")) {
      const fields = { nominal_tension: nominal, minimum_tension: minimum, error_offset: offset };
      return { ...plain, spec: { name, parameters: given }, inLoop: name, fields };
    }
    reach(`'${name}'`, minimum, nominal, context.range);
    const scale = layout.scales.position_error, lowest = minimum / nominal;
    if (offset > scale) throw new AmulettError(`'error_offset_deg' of '${name}' is ${parameters.error_offset_deg}; the largest observed error is ${scale / RADIANS} deg`);
    const factor = (error) => printed
      ? Math.min((1 - lowest) * (Math.abs(error) / offset) ** 4 + lowest, 1)
      : (1 - lowest) * Math.max(1 - Math.abs(error) / offset, 0) ** 4 + lowest;
    const act = (seen) => Math.fround(actionOf(factor(seen[0] * scale) * nominal, context.range));
    return { ...plain, spec: { name, parameters: given }, act };
  }

  /** Laws with tuned parameters; those that are left out are the device's own tuned ones. */
  function tuned(layout, { name, parameters: given = {}, range = layout.tensionRange }, device, context, plain) {
    const described = layout.laws[name], shipped = device.laws[name] || {};
    if (!Array.isArray(range) || range.length !== 2 || !(0 <= range[0] && range[0] < range[1])) throw new AmulettError(`the range of '${name}' is ${shown(range)}; it has to be two tensions [N], the lower one first`);
    reach(`'${name}'`, range[0], range[1], context.range);
    const parameters = read(name, given, Object.fromEntries(described.map((each) => [each.name, shipped[each.name]])));
    for (const { name: key, unit, low, high } of described) {
      if (parameters[key] === undefined) throw new AmulettError(`'${name}' was not tuned for the device '${device.name}': give its parameter '${key}'`);
      number(`'${key}' of '${name}' [${unit}]`, parameters[key], low, high);
    }
    const tension = name === "parametric" ? parametric(layout, parameters, device, context, range) : eq6Tuned(layout, parameters);
    return { ...plain, spec: { name, parameters: given, range }, act: (seen) => Math.fround(actionOf(tension(seen), context.range)) };
  }

  function eq6Tuned(layout, { nominal_tension: nominal, minimum_tension: minimum, error_offset: offset, exponent }) {
    const scale = layout.scales.position_error;
    return (seen) => {
      const error = (Math.abs(seen[0]) * scale * 180) / Math.PI;
      return minimum + (nominal - minimum) * Math.max(1 - error / offset, 0) ** exponent;
    };
  }

  /** The richer law; its terms are explained in laws/parametric.py. */
  function parametric(layout, p, device, { period, range }, own) {
    const scale = layout.scales, at = Object.fromEntries(layout.observations.map((name, k) => [name, k]));
    const [radius, inertia, a, b, c, d] = device.lawConstants, [least, most] = own;
    const size = (x) => 1 - Math.exp(-x * x);
    const squash = (wanted) => {
      const middle = 0.5 * (least + most), half = 0.5 * (most - least), x = (wanted - middle) / half;
      return middle + (half * x) / (1 + x ** 8) ** 0.125;
    };
    return (seen) => {
      const error = (seen[at.position_error] * scale.position_error * 180) / Math.PI, rate = seen[at.joint_velocity] * scale.joint_velocity;
      const biceps = seen[at.estimated_tension_biceps] * scale.estimated_tension, triceps = seen[at.estimated_tension_triceps] * scale.estimated_tension;
      const decay = Math.max(a * Math.exp(b * (0.5 * (biceps + triceps)) + c) + d, 0);
      const torque = 2 * decay * inertia * rate - (biceps - triceps) * radius;
      const far = size(error / p.error_width), way = Math.tanh(error / p.error_width), degrees = (rate * 180) / Math.PI;
      const early = Math.exp((-Math.max(seen[at.time_since_move], 0) * scale.time_since_move) / p.early_time);
      const wanted = p.base + p.error_gain * far + p.direction_gain * way + p.switch_gain * Math.max(-seen[at.agonist] * way, 0) +
        p.speed_gain * size(degrees / p.speed_width) + p.approach_gain * way * Math.tanh(degrees / p.speed_width) +
        p.early_gain * early + p.early_error_gain * early * far + p.torque_gain * size(torque / p.torque_width) +
        p.help_gain * way * Math.tanh(torque / p.torque_width) +
        (p.angle_gain * seen[at.joint_angle] * scale.joint_angle) / (0.5 * Math.PI) + p.early_direction_gain * early * way;
      const last = Math.min(Math.max(tensionOf(seen[at.tension_setpoint], range), least), most), next = squash(wanted);
      return last + ((next - last) * period) / ((next > last ? p.rise_time : p.fall_time) + period);
    };
  }

  return { make, NAMES, tensionOf, actionOf };
})();
