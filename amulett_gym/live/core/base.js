"use strict";
// The simulation's one global name. Each file adds its part to it; `amulett_gym.live.core.script()` joins them in order.
//
//   const core = await Amulett.load(wasmBytes, hexText);
//   const arm = core.arm({device, loop: "decentralized", law: {name: "eq6"}, scenario: {}, seed: 0});
//   arm.setSetpoint(1.0); arm.step(400); arm.read().angle;
//
// `device` is what `amulett_gym.live.core.data.device_data` returns. arm.js says what an arm can do. Angles are in rad,
// forces in N, torques in N m, lengths in m, times in s; only keys that end in `_deg` are in degrees.
globalThis.Amulett = {};

Amulett.base = (() => {
  /** An error with a text for the person who gave what is wrong. */
  class AmulettError extends Error {}

  /** What a value looks like in an error, at most 60 characters. @param {any} value */
  function shown(value) {
    let text;
    if (typeof value === "string") return `'${value.length > 60 ? `${value.slice(0, 57)}…` : value}'`;
    try { text = typeof value === "number" ? String(value) : JSON.stringify(value); } catch { text = typeof value === "object" ? "too deep to show" : String(value); }
    text = text === undefined ? String(value) : text;
    return text.length > 60 ? `${text.slice(0, 57)}…` : text;
  }

  /**
   * The end of an error's sentence that names the nearest valid choice.
   * @param {string} word @param {readonly string[]} choices
   */
  function nearest(word, choices) {
    let best = "", least = Infinity;
    for (const choice of choices) {
      const distance = edits(word.slice(0, 100).toLowerCase(), choice.toLowerCase());
      if (distance < least) [best, least] = [choice, distance];
    }
    return least <= Math.max(word.length, best.length) / 2 ? `; did you mean '${best}'?` : "";
  }

  /** @param {string} a @param {string} b @returns {number} the edit distance */
  function edits(a, b) {
    let row = Array.from({ length: b.length + 1 }, (_, k) => k);
    for (let i = 1; i <= a.length; i++) {
      const next = [i];
      for (let j = 1; j <= b.length; j++) {
        next[j] = Math.min(row[j] + 1, next[j - 1] + 1, row[j - 1] + Number(a[i - 1] !== b[j - 1]));
      }
      row = next;
    }
    return row[b.length];
  }

  /** A name that is one of the choices. @param {string} kind @param {any} name @param {readonly string[]} choices */
  function oneOf(kind, name, choices) {
    if (typeof name === "string" && choices.includes(name)) return name;
    const hint = typeof name === "string" ? nearest(name, choices) : "";
    throw new AmulettError(`unknown ${kind} ${shown(name)}; choose from ${choices.join(", ")}${hint}`);
  }

  /** A finite number within a range. @param {string} what @param {any} value @param {number} low @param {number} high */
  function number(what, value, low = -Infinity, high = Infinity) {
    if (typeof value === "number" && Number.isFinite(value) && value >= low && value <= high) return value;
    const range = high === Infinity ? (low === -Infinity ? "a finite number" : `at least ${low}`) : `from ${low} to ${high}`;
    throw new AmulettError(`${what} is ${shown(value)}; it has to be ${range}`);
  }

  const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

  /**
   * Return a value with the defaults of what it leaves out, if it fits a JSON schema as pydantic writes it.
   * @param {any} schema @param {any} value @param {string} what begins an error's sentence
   * @param {string} path of the value within `what` @param {any} root the schema with the definitions
   */
  function checked(schema, value, what, path = "", root = schema) {
    const place = path ? `'${path}'` : "the content";
    const wrong = (needed) => { throw new AmulettError(`${what}: ${place} is ${shown(value)}; it has to be ${needed}`); };
    if (schema.$ref) return checked(root.$defs[schema.$ref.split("/").pop()], value, what, path, root);
    if (schema.anyOf) {
      const others = schema.anyOf.filter((each) => each.type !== "null");
      if (value === null && others.length < schema.anyOf.length) return null;
      return checked(others[0], value, what, path, root);
    }
    if ("const" in schema && value !== schema.const) wrong(shown(schema.const));
    if (schema.enum && !schema.enum.includes(value)) {
      wrong(`one of ${schema.enum.join(", ")}${typeof value === "string" ? nearest(value, schema.enum) : ""}`);
    }
    if (schema.type === "object") {
      if (!isObject(value)) wrong("an object");
      return checkedObject(schema, value, what, path, root);
    }
    if (schema.type === "array") {
      const { minItems = 0, maxItems = 1e6 } = schema;
      if (!Array.isArray(value)) wrong("a list");
      if (value.length < minItems || value.length > maxItems) wrong(`a list of ${minItems} to ${maxItems} entries`);
      return value.map((item, k) => checked(schema.items, item, what, path ? `${path}.${k}` : String(k), root));
    }
    if (schema.type === "number" || schema.type === "integer") {
      const { minimum = -Infinity, maximum = Infinity, exclusiveMinimum = -Infinity, exclusiveMaximum = Infinity } = schema;
      if (typeof value !== "number" || !Number.isFinite(value)) wrong("a finite number");
      if (schema.type === "integer" && !Number.isInteger(value)) wrong("a whole number");
      if (value < minimum || value <= exclusiveMinimum) wrong(value < minimum ? `at least ${minimum}` : `more than ${exclusiveMinimum}`);
      if (value > maximum || value >= exclusiveMaximum) wrong(value > maximum ? `at most ${maximum}` : `less than ${exclusiveMaximum}`);
    }
    if (schema.type === "string") {
      if (typeof value !== "string") wrong("a text");
      if (value.length < (schema.minLength || 0) || value.length > (schema.maxLength || 1e4)) wrong("a shorter or longer text");
    }
    if (schema.type === "boolean" && typeof value !== "boolean") wrong("true or false");
    return value;
  }

  function checkedObject(schema, value, what, path, root) {
    const within = (key) => (path ? `${path}.${key}` : key);
    const known = schema.properties || {}, names = Object.keys(known), found = {};
    for (const key of Object.keys(value)) {
      if (Object.hasOwn(known, key)) continue;
      if (!isObject(schema.additionalProperties)) {
        throw new AmulettError(`${what}: unknown key ${shown(within(key))}${nearest(key, names)} (allowed: ${names.join(", ")})`);
      }
      found[key] = checked(schema.additionalProperties, value[key], what, within(key), root);
    }
    for (const key of names) {
      const given = Object.hasOwn(value, key);
      if (!given && (schema.required || []).includes(key)) throw new AmulettError(`${what}: '${within(key)}' is missing`);
      found[key] = given ? checked(known[key], value[key], what, within(key), root) : known[key].default;
    }
    return found;
  }

  /** The bytes of a text in base64. @param {string} text @param {string} what */
  function fromBase64(text, what) {
    let letters;
    try { letters = atob(text); } catch { throw new AmulettError(`${what} is damaged: it is no base64`); }
    const bytes = new Uint8Array(letters.length);
    for (let k = 0; k < letters.length; k++) bytes[k] = letters.charCodeAt(k);
    return bytes;
  }

  const PRIMES = (() => {
    const found = [];
    for (let n = 2; found.length < 64; n++) if (found.every((prime) => n % prime)) found.push(n);
    return found;
  })();
  const fraction = (value) => Math.floor((value - Math.floor(value)) * 2 ** 32) | 0;
  const ROUNDS = PRIMES.map((prime) => fraction(Math.cbrt(prime)));

  /** The SHA-256 of bytes (FIPS 180-4), in hexadecimal: the browser's own works asynchronously. @param {Uint8Array} bytes */
  function sha256(bytes) {
    const state = PRIMES.slice(0, 8).map((prime) => fraction(Math.sqrt(prime)));
    const padded = new Uint8Array(64 * Math.ceil((bytes.length + 9) / 64)), view = new DataView(padded.buffer);
    padded.set(bytes);
    padded[bytes.length] = 0x80;
    view.setUint32(padded.length - 8, Math.floor(bytes.length / 2 ** 29));
    view.setUint32(padded.length - 4, (bytes.length * 8) >>> 0);
    const w = new Int32Array(64), turn = (x, n) => (x >>> n) | (x << (32 - n));
    for (let start = 0; start < padded.length; start += 64) {
      for (let k = 0; k < 64; k++) {
        if (k < 16) { w[k] = view.getInt32(start + 4 * k); continue; }
        const x = w[k - 15], y = w[k - 2];
        w[k] = w[k - 16] + (turn(x, 7) ^ turn(x, 18) ^ (x >>> 3)) + w[k - 7] + (turn(y, 17) ^ turn(y, 19) ^ (y >>> 10));
      }
      let [a, b, c, d, e, f, g, h] = state;
      for (let k = 0; k < 64; k++) {
        const one = (h + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & f) ^ (~e & g)) + ROUNDS[k] + w[k]) | 0;
        const two = ((turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))) | 0;
        [h, g, f, e, d, c, b, a] = [g, f, e, (d + one) | 0, c, b, a, (one + two) | 0];
      }
      [a, b, c, d, e, f, g, h].forEach((value, k) => { state[k] = (state[k] + value) | 0; });
    }
    return state.map((value) => (value >>> 0).toString(16).padStart(8, "0")).join("");
  }

  return { AmulettError, shown, nearest, oneOf, number, isObject, checked, fromBase64, sha256 };
})();
