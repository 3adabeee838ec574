"use strict";
// Files of one's own: dropped anywhere on the page, or opened. They are read as data and checked before they are used.

Live.drop = (() => {
  const { byId, UserError } = Live.base;
  const { shown } = Amulett.base;

  const MOST_FILES = 20;
  const MOST_BYTES = 16000000; // of a file, as `laws/bundle.py` allows
  const MOST_VALUES = 100000; // keys and values in a file, aliases of YAML counted at each use
  const BUNDLE = ["weights.safetensors", "policy.json"];

  /** @param {any} app the page's functions, see app.js */
  function make(app) {
    let depth = 0;
    const shade = byId("drop"), hasFiles = (event) => event.dataTransfer && [...event.dataTransfer.types].includes("Files");
    document.addEventListener("dragenter", (event) => { if (hasFiles(event)) { depth++; shade.hidden = false; } });
    document.addEventListener("dragleave", (event) => { if (hasFiles(event) && --depth <= 0) { depth = 0; shade.hidden = true; } });
    document.addEventListener("dragover", (event) => { if (hasFiles(event)) event.preventDefault(); });
    document.addEventListener("drop", (event) => {
      if (!hasFiles(event)) return;
      event.preventDefault();
      depth = 0;
      shade.hidden = true;
      const entries = [...event.dataTransfer.items].map((item) => (item.webkitGetAsEntry ? item.webkitGetAsEntry() : null)).filter(Boolean);
      const loose = [...event.dataTransfer.files];
      take(async () => (entries.some((entry) => entry.isDirectory) ? inFolders(entries) : loose));
    });
    byId("open-files").addEventListener("change", (event) => {
      const input = /** @type {HTMLInputElement} */ (event.target), files = [...(input.files || [])];
      input.value = "";
      take(async () => files);
    });

    /** @param {() => Promise<File[]>} find */
    async function take(find) {
      try {
        await read(await find(), app);
      } catch (error) {
        Live.messages.fail(error);
      }
    }
  }

  /** The files in dropped folders, one level deep: a bundle is a folder. */
  async function inFolders(entries) {
    const found = [];
    for (const entry of entries) {
      const inner = entry.isDirectory ? await new Promise((done, fail) => entry.createReader().readEntries(done, fail)) : [entry];
      for (const each of inner.slice(0, MOST_FILES + 1)) {
        if (each.isFile) found.push(await new Promise((done, fail) => each.file(done, fail)));
      }
    }
    return found;
  }

  /**
   * Use files: those of a bundle together, any other alone.
   * @param {File[]} files
   */
  async function read(files, app) {
    if (!files.length) throw new UserError("there is no file in what was dropped; drop a device, a policy bundle, a law or a scenario");
    if (files.length > MOST_FILES) throw new UserError(`${files.length} files are too many; at most ${MOST_FILES} are read at a time`);
    for (const file of files) {
      if (file.size > MOST_BYTES) throw new UserError(`'${file.name}' has ${file.size} bytes; at most ${MOST_BYTES} are read`);
    }
    if (files.some((file) => file.name.endsWith(".safetensors")) || files.some((file) => file.name === "policy.json")) {
      const missing = BUNDLE.filter((name) => !files.some((file) => file.name === name));
      if (missing.length) throw new UserError(`a policy bundle needs ${missing.join(" and ")} as well: drop all files of its folder together`);
      const bytes = {};
      for (const file of files) bytes[file.name] = new Uint8Array(await file.arrayBuffer());
      return app.addBundle(bytes);
    }
    for (const file of files) await readOne(file, app);
    return undefined;
  }

  async function readOne(file, app) {
    const name = file.name, suffix = name.toLowerCase().split(".").pop();
    if (!["json", "yaml", "yml"].includes(suffix)) throw new UserError(`'${name}' is neither JSON nor YAML, and no file of a policy bundle (${BUNDLE.join(", ")})`);
    const bytes = new Uint8Array(await file.arrayBuffer()), content = parse(text(bytes, name), suffix, name), hash = Live.link.digest(bytes);
    if (typeof content !== "object" || content === null || Array.isArray(content)) throw new UserError(`'${name}' holds ${shown(content)}; it has to hold keys with values`);
    if (content.format === "amulett-tuned-law") return app.addLaw(name, content, hash);
    if (["moves", "setpoint", "pushes", "initial_angle_deg", "obstacle", "wave", "shake", "payload"].some((key) => Object.hasOwn(content, key))) return app.addScenario(name, content, hash);
    if (["name", "base", "plant", "spring", "drives", "sensors", "loop"].some((key) => Object.hasOwn(content, key))) return app.addDevice(name, content, hash);
    throw new UserError(`'${name}' is no device (it has neither name nor base), no scenario (no moves, setpoint or pushes) and no tuned law (its format is not amulett-tuned-law); its keys are ${Object.keys(content).slice(0, 8).map((key) => key.slice(0, 40)).join(", ") || "none"}`);
  }

  function text(bytes, name) {
    try {
      return new TextDecoder("utf-8", { fatal: true }).decode(bytes);
    } catch {
      throw new UserError(`'${name}' is no text in UTF-8`);
    }
  }

  function parse(content, suffix, name) {
    let found;
    try {
      found = suffix === "json" ? JSON.parse(content) : globalThis.jsyaml.load(content, { schema: globalThis.jsyaml.CORE_SCHEMA });
    } catch (error) {
      throw new UserError(`'${name}' is no valid ${suffix === "json" ? "JSON" : "YAML"}: ${String(error.message).split("\n")[0].slice(0, 200)}`);
    }
    count(found, name);
    return found;
  }

  /** Refuse what is too large to be looked at. */
  function count(content, name) {
    const left = [content];
    for (let seen = 0; left.length; seen++) {
      if (seen > MOST_VALUES) throw new UserError(`'${name}' holds more than ${MOST_VALUES} values, which is the most`);
      const each = left.pop();
      if (typeof each === "object" && each !== null) for (const value of Object.values(each).slice(0, MOST_VALUES)) left.push(value);
    }
  }

  return { make, read };
})();
