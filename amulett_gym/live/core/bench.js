"use strict";
// Measure in node how many control ticks the WebAssembly plays in a second of the processor. Arguments: the scripts, amulett.wasm, a job.

const fs = require("node:fs");
const vm = require("node:vm");

const [scripts, wasm, job] = process.argv.slice(2).map((path) => fs.readFileSync(path));
vm.runInThisContext(scripts.toString());
const { device, scenario, loops, ticks, rounds } = JSON.parse(job.toString());

Amulett.load(wasm).then((core) => {
  const rates = {};
  for (let round = 0; round < rounds; round++) { // the loops in turn, so that all share the same load
    for (const loop of loops) {
      const arm = core.arm({ device, scenario, loop });
      arm.step(ticks / 10);
      const begin = process.cpuUsage();
      arm.step(ticks);
      const { user, system } = process.cpuUsage(begin), seconds = 1e-6 * (user + system);
      if (arm.read().failed) throw new Error(`the arm failed in '${loop}'`);
      rates[loop] = Math.max(rates[loop] || 0, ticks / seconds);
    }
  }
  process.stdout.write(JSON.stringify(rates));
});
