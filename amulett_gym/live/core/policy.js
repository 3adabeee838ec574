"use strict";
// Policy bundles: amulett_gym/laws/bundle.py, actor.py, features.py, memory.py and history.py. A bundle is data, and no
// file of it is used before it was checked.

Amulett.policy = (() => {
  const { AmulettError, checked, isObject, number, oneOf, shown, sha256 } = Amulett.base;
  const FILES = ["weights.safetensors", "policy.json", "env.json", "provenance.json"], MANIFEST = "manifest.json";
  const OPTIONAL = ["card.md", "critic.npz"]; // which no policy needs to act
  const MOST_BYTES = 16e6, MOST_WEIGHT = 1e6, MOST_HEADER = 1e5;

  const sameList = (a, b) => a.length === b.length && a.every((each, k) => each === b[k]);

  /**
   * Return a policy from its bundle's files, checked as `read_bundle` does; it is remembered by its id, so that a
   * snapshot can name it.
   * @param {any} layout @param {Map<string, any>} policies @param {Object<string, Uint8Array>} files name -> content
   */
  function readPolicy(layout, policies, files) {
    if (!isObject(files)) throw new AmulettError("a policy bundle is its files: an object of name -> bytes");
    for (const [name, bytes] of Object.entries(files)) {
      if (![...FILES, ...OPTIONAL, MANIFEST].includes(name)) throw new AmulettError(`'${name.slice(0, 100)}' is no file of a policy bundle; it holds ${[...FILES, MANIFEST].join(", ")}`);
      if (!(bytes instanceof Uint8Array)) throw new AmulettError(`'${name}' has to be bytes`);
      if (bytes.length > MOST_BYTES) throw new AmulettError(`'${name}' has ${bytes.length} bytes; a bundle's files have at most ${MOST_BYTES}`);
    }
    for (const name of [MANIFEST, ...FILES]) if (!Object.hasOwn(files, name)) throw new AmulettError(`'${name}' of the policy bundle is missing; give all of its files together`);
    const manifest = checked(MANIFEST_SCHEMA, json(files, MANIFEST), `'${MANIFEST}'`);
    for (const name of Object.keys(files).filter((each) => each !== MANIFEST)) {
      const wanted = manifest.sha256[name];
      if (!wanted) throw new AmulettError(`'${MANIFEST}' does not list '${name}'`);
      if (sha256(files[name]) !== wanted) throw new AmulettError(`'${name}' was changed or damaged: its SHA-256 differs from the manifest's`);
    }
    const policy = checked(layout.schemas.policy, json(files, "policy.json"), "'policy.json'");
    checkPolicy(layout, policy);
    const env = json(files, "env.json"), keywords = isObject(env.keywords) ? env.keywords : {};
    const control = oneOf("control loop in 'env.json'", keywords.control ?? "decentralized", layout.loops);
    const delay = keywords.action_delay === undefined ? 0 : number("'env.json': 'keywords.action_delay'", keywords.action_delay, 0, 1e6);
    const found = { id: sha256(files[MANIFEST]), delay: Math.floor(delay), policy, layers: readLayers(files["weights.safetensors"], policy.network), control };
    policies.set(found.id, found);
    return found;
  }

  const MANIFEST_SCHEMA = {
    type: "object",
    properties: {
      format: { const: "amulett-policy-bundle" }, version: { const: 1 },
      sha256: { type: "object", additionalProperties: { type: "string" } },
    },
    required: ["format", "version", "sha256"],
  };

  function json(files, name) {
    let value;
    try {
      value = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(files[name]));
    } catch (error) {
      throw new AmulettError(`'${name}' is no JSON: ${error instanceof Error ? error.message : error}`);
    }
    if (!isObject(value)) throw new AmulettError(`'${name}' has to hold a JSON object`);
    return value;
  }

  /** Refuse a policy whose inputs and outputs are not those of this version, or not those of a device alone. */
  function checkPolicy(layout, policy) {
    const wrong = (text) => { throw new AmulettError(`'policy.json': ${text}`); };
    const { network: { layers }, tension_range: [low, high] } = policy;
    if (policy.mean_angle_range !== null || policy.setpoint_gain !== null) wrong("the policy commands drive angles, as in Amulett/Drives-v0; this page plays laws that choose a tension");
    if (policy.actions !== null) wrong("the policy is for a device that a person wears; this page plays devices without a wearer");
    for (const [key, ours] of [["observations", layout.observations], ["features", layout.features], ["memory", layout.memory]]) {
      const theirs = policy[key] || [];
      if (sameList(theirs, ours) || (key !== "observations" && !theirs.length)) continue;
      const different = [...theirs.filter((name) => !ours.includes(name)), ...ours.filter((name) => !theirs.includes(name))].slice(0, 5);
      wrong(`the ${key} are not those of this version; different: ${different.join(", ").slice(0, 200) || "their order"}`);
    }
    for (const [name, scale] of Object.entries(layout.scales)) {
      const found = policy.observation_scales[name];
      if (!(Math.abs(found - scale) <= 1e-12 * Math.abs(scale))) wrong(`the scale of observation '${name}' is ${shown(found)}; here it has to be ${scale}`);
    }
    if (!(low >= 0 && low < high && high <= 1e6)) wrong(`'tension_range' is ${shown([low, high])} N; it has to be 0 <= low < high`);
    if (layers.some((size) => size < 1 || size > 4096)) wrong(`'network.layers' are ${shown(layers)}; every size has to be from 1 to 4096`);
    const size = policy.observations.length + policy.features.length + (policy.memory || []).length;
    if (layers[0] !== policy.history * size || layers[layers.length - 1] !== 1) {
      wrong(`the network maps ${layers[0]} numbers to ${layers[layers.length - 1]}; it has to map ${policy.history} times the ${size} observations and features to 1 action`);
    }
  }

  /** The layers of ``weights.safetensors``: a length of 64 bits, a header in JSON, the numbers. */
  function readLayers(bytes, { layers: sizes }) {
    const wrong = (text) => { throw new AmulettError(`'weights.safetensors'${text}`); };
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
    const length = bytes.length < 8 ? Infinity : Number(view.getBigUint64(0, true));
    if (length > Math.min(MOST_HEADER, bytes.length - 8)) wrong(" is not a valid safetensors file: its header is too long");
    const header = json({ "weights.safetensors": bytes.subarray(8, 8 + length) }, "weights.safetensors");
    const wanted = sizes.slice(1).flatMap((outputs, k) => /** @type {[string, number[]][]} */ ([[`layer_${k}.weight`, [outputs, sizes[k]]], [`layer_${k}.bias`, [outputs]]]));
    for (const name of Object.keys(header)) if (name !== "__metadata__" && !wanted.some(([each]) => each === name)) wrong(` holds '${name.slice(0, 100)}', which policy.json does not describe`);
    const tensors = wanted.map(([name, shape]) => {
      const { dtype, shape: found, data_offsets: offsets } = isObject(header[name]) ? header[name] : wrong(` does not hold '${name}', which policy.json describes`);
      const [begin, end] = Array.isArray(offsets) ? offsets : [NaN, NaN];
      const count = shape.reduce((product, size) => product * size, 1), start = 8 + length + begin;
      if (dtype !== "F32" || !Array.isArray(found) || !sameList(found, shape)) wrong(`: '${name}' is ${shown(dtype)} of shape ${shown(found)}; it has to be F32 of shape ${shown(shape)}`);
      if (!(Number.isInteger(begin) && begin >= 0 && end - begin === 4 * count && start + 4 * count <= bytes.length)) wrong(` is not a valid safetensors file: '${name}' is not within it`);
      const numbers = Float64Array.from({ length: count }, (_, k) => view.getFloat32(start + 4 * k, true));
      if (!numbers.every((value) => Math.abs(value) <= MOST_WEIGHT)) wrong(`: '${name}' holds a number that is not finite, or beyond +-${MOST_WEIGHT}`);
      return numbers;
    });
    return sizes.slice(1).map((_, k) => ({ weight: tensors[2 * k], bias: tensors[2 * k + 1] }));
  }

  /** A network's output, in 64 bits and then rounded to 32. */
  function forward(layers, network, inputs) {
    let values = inputs;
    layers.forEach(({ weight, bias }, k) => {
      const next = new Float64Array(bias.length), size = values.length;
      for (let row = 0; row < next.length; row++) {
        let sum = 0;
        for (let column = 0; column < size; column++) sum += values[column] * weight[row * size + column];
        sum += bias[row];
        next[row] = k === layers.length - 1 ? sum : network.activation === "tanh" ? Math.tanh(sum) : Math.max(sum, 0);
      }
      values = next;
    });
    return Math.fround(network.output === "tanh" ? Math.tanh(values[0]) : Math.min(Math.max(values[0], -1), 1));
  }

  /** Observations by name. */
  const named = (layout, seen) => Object.fromEntries(layout.observations.map((name, k) => [name, seen[k]]));
  const DEGREES = 180 / Math.PI;

  /** laws/features.py */
  function features(layout, seen, range) {
    const o = named(layout, seen), { tanh, exp, max } = Math, scale = layout.scales, FLOOR = 5.3;
    const error = scale.position_error * DEGREES * o.position_error, velocity = scale.joint_velocity * DEGREES * o.joint_velocity;
    const time = scale.time_since_move * max(o.time_since_move, 0), agonist = o.agonist, unit = scale.estimated_tension;
    const biceps = unit * o.estimated_tension_biceps, triceps = unit * o.estimated_tension_triceps;
    const [pulling, other] = agonist > 0 ? [biceps, triceps] : [triceps, biceps];
    const setpoint = Amulett.laws.tensionOf(o.tension_setpoint, range);
    const fine = tanh(error / 1.5), coarse = tanh(error / 5), slow = tanh(velocity / 8), fast = tanh(velocity / 30);
    return [
      fine, coarse, tanh(error / 15), slow, fast, tanh(velocity / 100), exp(-time / 0.1), exp(-time / 0.4),
      agonist * fine, agonist * coarse, agonist * fast, fine * slow, coarse * fast, pulling / unit, other / unit,
      tanh((other - FLOOR) / 0.5), tanh((other - 7) / 2), tanh((other - setpoint) / 0.5), tanh((other - setpoint) / 2),
      tanh((other - setpoint) / 6), tanh(setpoint - FLOOR),
    ];
  }

  /** The quantities of laws/memory.py that are averaged. */
  function quantities(layout, seen, before) {
    const now = named(layout, seen), last = named(layout, before), { tanh, abs } = Math, scale = layout.scales, flexes = now.agonist > 0;
    const sorted = (biceps, triceps) => (flexes ? [biceps, triceps] : [triceps, biceps]);
    const sides = (name) => sorted(now[`${name}_biceps`], now[`${name}_triceps`]);
    const changes = (name, unit) => sorted(unit * (now[`${name}_biceps`] - last[`${name}_biceps`]), unit * (now[`${name}_triceps`] - last[`${name}_triceps`]));
    const error = scale.position_error * DEGREES * now.position_error, velocity = scale.joint_velocity * DEGREES * now.joint_velocity;
    const jolt = velocity - scale.joint_velocity * DEGREES * last.joint_velocity;
    const [pulled, followed] = changes("command", scale.command * DEGREES), [stretched] = sides("spring_deflection");
    const [pulling, other] = sides("estimated_tension"), [grows, changed] = changes("estimated_tension", scale.estimated_tension);
    return [
      tanh(abs(error) / 3), now.agonist * tanh(error / 3), tanh(abs(velocity) / 30), tanh(abs(jolt) / 30), tanh(abs(pulled) / 8),
      tanh(abs(followed) / 8), pulling, other, tanh(abs(grows) / 0.7), tanh(abs(changed) / 0.7), tanh(pulled / 8) * tanh(grows / 0.7),
      tanh(followed / 8) * tanh(changed / 0.7), now.agonist * tanh(jolt / 15) * tanh(pulled / 8), stretched,
      other * scale.estimated_tension < 5.05 ? 1 : 0, now.tension_setpoint,
    ];
  }

  /**
   * Return a policy as a law (see laws.js).
   * @param {any} layout @param {Map<string, any>} policies @param {any} given what `readPolicy` returned, or its id
   */
  function make(layout, policies, given) {
    const id = typeof given === "string" ? given : isObject(given) ? given.id : null, found = policies.get(id);
    if (!found) throw new AmulettError("the policy is not known here: read its bundle first (core.readPolicy)");
    const { policy, layers } = found, range = policy.tension_range, size = layers[0].weight.length / layers[0].bias.length;
    const empty = () => ({ steps: 0, last: [], means: new Array(policy.memory ? layout.memory.length : 0).fill(0), history: new Array(policy.history > 1 ? size : 0).fill(0) });
    let kept = empty();

    function remember(seen) {
      const values = quantities(layout, seen, kept.steps ? kept.last : seen), count = values.length;
      layout.spans.forEach((span, part) => {
        const share = 1 / Math.min(kept.steps + 1, span);
        values.forEach((value, k) => { kept.means[part * count + k] += share * (value - kept.means[part * count + k]); });
      });
      kept.last = Array.from(seen);
    }

    function inputs(seen) {
      if (policy.memory) remember(seen);
      kept.steps++;
      const own = [...seen, ...(policy.features.length ? features(layout, seen, range) : []), ...kept.means];
      if (policy.history === 1) return own;
      kept.history = [...kept.history.slice(own.length), ...own];
      return kept.history;
    }

    function act(seen) {
      const wanted = forward(layers, policy.network, inputs(seen));
      if (policy.follow === 1) return wanted;
      const present = seen[layout.observations.indexOf("tension_setpoint")];
      return Math.fround(present + policy.follow * (wanted - present));
    }

    return {
      spec: { name: "policy", policy: id }, inLoop: "agent", fields: {}, range, period: policy.agent_period, delay: found.delay, act,
      state: () => kept,
      remember(state) {
        const fits = isObject(state) && Number.isInteger(state.steps) && state.steps >= 0 &&
          Object.entries({ ...empty(), last: state.steps && policy.memory ? layout.observations : [] }).every(([key, like]) => !Array.isArray(like) ||
            (Array.isArray(state[key]) && state[key].length === like.length && state[key].every(Number.isFinite)));
        if (!fits) throw new AmulettError("the snapshot holds another policy's memory");
        kept = { steps: state.steps, last: [...state.last], means: [...state.means], history: [...state.history] };
      },
    };
  }

  return { readPolicy, make, features, quantities };
})();
