"use strict";
// The whole state as text for the address: choices and every input since the run's begin, checked when it is read.

Live.link = (() => {
  const { UserError } = Live.base;
  const { number, oneOf, shown, nearest } = Amulett.base;

  const VERSION = 1;
  const MOST_TEXT = 400000; // characters of a link
  const MOST_BYTES = 4000000; // of its unpacked content

  /**
   * @typedef {Object} Moment
   * @property {string} device @property {string} loop @property {{name: string, parameters: Object<string, number>}} law
   * @property {string} task @property {number} seed @property {number} speed
   * @property {number} tick @property {number} end @property {Input[]} events
   * @property {Hashes} hashes of the contents that the names stand for
   */
  /** @typedef {{simulation: string, device: string, task: string, laws: Object<string, string>}} Hashes */

  /**
   * The text of a moment; an event is [ticks since the one before, kind, value].
   * @param {Moment} moment
   */
  async function encode(moment) {
    let before = 0;
    const events = moment.events.map(({ tick, kind, value }) => {
      const row = [tick - before, kind, value];
      before = tick;
      return row;
    });
    return pack({ version: VERSION, ...moment, events });
  }

  /** A link's content as text. @param {any} content */
  async function pack(content) {
    const bytes = new TextEncoder().encode(JSON.stringify(content));
    const text = `z${toBase64(await packed(bytes, new CompressionStream("deflate-raw"), Infinity))}`;
    if (bytes.length > MOST_BYTES || text.length > MOST_TEXT) throw new UserError(`the run has too many inputs for a link, which has at most ${MOST_TEXT} characters; restart, or save the CSV`);
    return text;
  }

  /**
   * @param {string} text of `encode`
   * @returns {Promise<any>} its content, which `check` has to check
   */
  async function decode(text) {
    if (text.length > MOST_TEXT) throw new UserError(`the link has ${text.length} characters; at most ${MOST_TEXT} are read`);
    let content;
    try {
      if (text[0] !== "z") throw new Error("its first letter is not z");
      const bytes = await packed(fromBase64(text.slice(1)), new DecompressionStream("deflate-raw"), MOST_BYTES);
      content = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
    } catch (error) {
      if (error instanceof UserError) throw error;
      throw new UserError("the link is damaged: it cannot be unpacked. Copy it again, whole");
    }
    return content;
  }

  /** Bytes through a stream, at most so many. */
  async function packed(bytes, stream, most) {
    const reader = new Blob([bytes]).stream().pipeThrough(stream).getReader();
    const parts = [];
    let size = 0;
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      size += value.length;
      if (size > most) {
        reader.cancel().catch(() => {});
        throw new UserError(`the link unpacks to more than ${most} bytes, which is the most`);
      }
      parts.push(value);
    }
    return new Uint8Array(await new Blob(parts).arrayBuffer());
  }

  function toBase64(bytes) {
    let text = "";
    for (let k = 0; k < bytes.length; k += 8192) text += String.fromCharCode(...bytes.subarray(k, k + 8192));
    return btoa(text).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
  }

  const fromBase64 = (text) => Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (letter) => letter.charCodeAt(0));

  // What follows is about contents: a name alone does not say which numbers follow.

  /** The first digits of the SHA-256 of bytes. @param {Uint8Array} bytes */
  const digest = (bytes) => Amulett.base.sha256(bytes).slice(0, 12);

  /** The hash of what a device, law or task of the page stands for: of its file, if it came as one. */
  function hashOf(entry) {
    entry.hash ||= digest(new TextEncoder().encode(JSON.stringify([entry.content || entry.scenario, entry.script || []])));
    return entry.hash;
  }

  /** The names of all laws that act in a run. @param {{law: any, events: Input[]}} moment @returns {string[]} */
  const lawsOf = ({ law, events }) => [...new Set([law.name, ...events.filter((each) => each.kind === "law").map((each) => each.value.name)])];

  /** The hashes of all that a moment names. @param {any} moment @param {any} data the page's data @returns {Hashes} */
  function hashesOf(moment, data) {
    const find = (list, id) => hashOf(data[list].find((each) => each.id === id));
    return {
      simulation: data.simulation, device: find("devices", moment.device), task: find("tasks", moment.task),
      laws: Object.fromEntries(lawsOf(moment).map((name) => [name, find("laws", name)])),
    };
  }

  /** Refuse a link whose names stand for something else on this page. */
  function checkHashes(moment, data) {
    const here = hashesOf(moment, data), given = keys("'hashes'", moment.hashes, Object.keys(here));
    keys("'hashes.laws'", given.laws, Object.keys(here.laws));
    const same = (kind, id, one, other) => {
      if (one === other) return;
      const remedy = id.startsWith("own:") ? "Drop that other file on this page" : "Use the page, or the amulett-gym, that the link was made with";
      throw new UserError(`the link's ${kind} ${shown(id.replace(/^own:/, ""))} is another one than that of this page, though of the same name: its content has the hash ${shown(one)}, this one's ${shown(other)}. So the numbers would not be the link's. ${remedy}`);
    };
    same("device", moment.device, given.device, here.device);
    same("task", moment.task, given.task, here.task);
    for (const name of Object.keys(here.laws)) same("law", name, given.laws[name], here.laws[name]);
    same("simulation", "amulett.wasm", given.simulation, here.simulation);
  }

  // What follows checks data: of links, and of scripts.

  /** As `number`, without a fraction. */
  function whole(what, value, low, high) {
    if (!Number.isInteger(number(what, value, low, high))) throw new UserError(`${what} is ${shown(value)}; it has to be a whole number`);
    return value;
  }

  /** The id of something that the page offers; what is somebody's own has to be given to the page first. */
  function listed(what, id, choices) {
    const ids = choices.map((each) => each.id);
    if (typeof id === "string" && id.startsWith("own:") && !ids.includes(id)) {
      throw new UserError(`the link uses a ${what} of somebody's own, ${shown(id.slice(4, 60))}; drop its files on this page, and the link opens`);
    }
    return oneOf(`${what} of the link`, id, ids);
  }

  /** An object with exactly these keys. */
  function keys(what, value, names) {
    if (typeof value !== "object" || value === null || Array.isArray(value)) throw new UserError(`${what} is ${shown(value)}; it has to be an object`);
    for (const name of Object.keys(value)) {
      if (!names.includes(name)) throw new UserError(`${what} has the unknown key ${shown(name)}${nearest(name.slice(0, 100), names)} (allowed: ${names.join(", ")})`);
    }
    for (const name of names) if (!Object.hasOwn(value, name)) throw new UserError(`${what}: '${name}' is missing`);
    return value;
  }

  /**
   * Return a moment whose every key and value is allowed.
   * @param {any} content @param {any} data the page's data
   * @returns {Moment}
   */
  function check(content, data) {
    const names = ["version", "device", "loop", "law", "task", "seed", "speed", "tick", "end", "events", "hashes"];
    keys("the link", content, names);
    if (content.version !== VERSION) throw new UserError(`the link is of version ${shown(content.version)}; this page reads version ${VERSION}`);
    const most = Math.ceil(Live.run.MOST_SECONDS / 1e-6);
    listed("device", content.device, data.devices);
    const device = data.devices.find((each) => each.id === content.device);
    listed("control loop", content.loop, data.loops);
    listed("task", content.task, data.tasks);
    whole("'seed'", content.seed, 0, 2 ** 32 - 1);
    number("'speed'", content.speed, 0.01, 1);
    whole("'end'", content.end, 0, most);
    whole("'tick'", content.tick, 0, content.end);
    if (!Array.isArray(content.events) || content.events.length > Live.run.MOST_EVENTS) throw new UserError(`'events' has to be a list of at most ${Live.run.MOST_EVENTS} inputs`);
    let tick = 0;
    const events = content.events.map((row, k) => {
      if (!Array.isArray(row) || row.length !== 3) throw new UserError(`'events.${k}' is ${shown(row)}; it has to be [ticks, kind, value]`);
      tick += whole(`'events.${k}.0'`, row[0], 0, most);
      oneOf(`input 'events.${k}.1' of the link`, row[1], [...Live.run.SHARED, "law"]);
      return { tick, kind: row[1], value: checkInput(`'events.${k}.2'`, row[1], row[2], device, data) };
    });
    if (tick > content.end) throw new UserError(`'end' is ${content.end}; it has to be at least ${tick}, the tick of the last input`);
    const moment = { ...content, law: checkLaw("'law'", content.law, device, data), events };
    checkHashes(moment, data);
    return moment;
  }

  /** The value of one input. */
  function checkInput(what, kind, value, device, data) {
    const { limits } = data;
    if (kind === "setpoint") return number(what, value, -limits.setpoint, limits.setpoint);
    if (kind === "push") return number(what, value, -limits.push, limits.push);
    if (kind === "payload") return number(what, value, 0, limits.payload);
    if (kind === "law") return checkLaw(what, value, device, data);
    if (value === null) return null;
    keys(what, value, ["angle", "side", "stiffness", ...("damping" in value ? ["damping"] : [])]);
    if ("damping" in value) number(`${what} damping`, value.damping, 0, 100);
    number(`${what} angle`, value.angle, -limits.setpoint, limits.setpoint);
    number(`${what} stiffness`, value.stiffness, 0.1, limits.obstacle);
    if (value.side !== 1 && value.side !== -1) throw new UserError(`${what} side is ${shown(value.side)}; it has to be 1 or -1`);
    return value;
  }

  /** A law by its name, with all of its parameters within their ranges. */
  function checkLaw(what, value, device, data) {
    keys(what, value, ["name", "parameters"]);
    listed("law", value.name, data.laws);
    const parameters = Live.laws.parametersOf(data.laws.find((each) => each.id === value.name), device);
    keys(`${what} parameters`, value.parameters, parameters.map((each) => each.name));
    for (const each of parameters) number(`${what} ${each.name} [${each.unit}]`, value.parameters[each.name], each.low, each.high);
    return value;
  }

  return { encode, decode, check, pack, digest, hashesOf };
})();
