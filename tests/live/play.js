"use strict";
// Play arms in node as a page does: a job in JSON from the standard input, what was read of each arm to the output.
// Arguments: the script of `amulett_gym.live.core.script()`, amulett.wasm, and firmware.hex.

const fs = require("node:fs");
const vm = require("node:vm");

const [scriptFile, wasmFile, hexFile] = process.argv.slice(2);
vm.runInThisContext(fs.readFileSync(scriptFile, "utf8"), { filename: scriptFile });

const bytesOf = (files) => Object.fromEntries(Object.entries(files).map(([name, text]) => [name, new Uint8Array(Buffer.from(text, "base64"))]));

/** Play one arm; `inputs`: [tick, method, ...arguments], before that tick. */
function play(core, { options, policy, ticks, every = 1, inputs = [], only }) {
  const law = policy ? { name: "policy", policy: core.readPolicy(bytesOf(policy)) } : options.law;
  const arm = core.arm({ ...options, law }), rows = [];
  const note = () => {
    const read = arm.read();
    rows.push(only ? Object.fromEntries(only.map((name) => [name, read[name]])) : read);
  };
  note();
  for (let tick = 0; tick < ticks; tick += every) {
    for (const [when, method, ...values] of inputs) if (when === tick) arm[method](...values);
    arm.step(every);
    note();
  }
  return rows;
}

/** The text of the error of an arm, or of reading a policy. */
function refusal(core, { options, policy }) {
  try {
    const law = policy ? { name: "policy", policy: core.readPolicy(bytesOf(policy)) } : options.law;
    core.arm({ ...options, law });
  } catch (error) {
    if (!(error instanceof Amulett.base.AmulettError)) throw error;
    return error.message;
  }
  return null;
}

(async () => {
  const core = await Amulett.load(fs.readFileSync(wasmFile), fs.readFileSync(hexFile, "utf8"));
  const { arms = [], refused = [], code = "" } = JSON.parse(fs.readFileSync(0, "utf8"));
  const result = { arms: arms.map((job) => play(core, job)), refused: refused.map((job) => refusal(core, job)) };
  if (code) result.returned = await vm.runInThisContext(`(async (core, input) => {${code}\n})`)(core, { arms, bytesOf });
  process.stdout.write(JSON.stringify(result));
})();
