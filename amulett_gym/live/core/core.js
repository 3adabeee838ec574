"use strict";
// The entry: compile the WebAssembly once; each arm is an instance of it.

/**
 * @param {BufferSource} bytes of amulett.wasm
 * @param {string} [hex] the text of firmware.hex, for the loop of that name
 * @returns {Promise<any>} `arm(options)` makes an arm (arm.js); `readPolicy(files)` returns a bundle's policy, for the law
 *   {name: "policy", policy}; `layout` holds the names of loops, laws with their parameters, families, ...
 */
Amulett.load = async (bytes, hex) => {
  const { AmulettError } = Amulett.base;
  const module = await WebAssembly.compile(bytes);
  const [section] = WebAssembly.Module.customSections(module, "amulett.layout");
  if (!section) throw new AmulettError("the WebAssembly is not that of amulett-gym: it has no layout");
  const layout = JSON.parse(new TextDecoder().decode(section));
  const policies = new Map();
  const core = {
    layout,
    policies,
    hex,
    instance() {
      const { exports } = new WebAssembly.Instance(module);
      exports._initialize();
      return exports;
    },
    /** @param {any} options */
    arm: (options) => Amulett.arm.make(core, options),
    /** @param {Object<string, Uint8Array>} files */
    readPolicy: (files) => Amulett.policy.readPolicy(layout, policies, files),
  };
  return core;
};
