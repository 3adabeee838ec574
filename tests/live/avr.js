"use strict";
// Give the firmware's hex file in JavaScript (`amulett_gym.live.core.script()`, which stands before) the bytes that a host
// has sent; `avr.py` gives it the job, and compares what the chip answers with what it answered in simavr.

/**
 * @param {{hex: string, exchanges: [number[], number[]][]}} job bytes to the chip, and from it
 */
function play({ hex, exchanges }) {
  const chip = Amulett.chip.make(hex), answers = [], cycles = chip.cycles, begin = performance.now();
  let held = []; // what has no answer goes with what comes next
  for (const [bytes, expected] of exchanges) {
    held.push(...bytes);
    answers.push(expected.length ? chip.exchange(held.splice(0)) : []);
  }
  return { answers, cycles: chip.cycles - cycles, seconds: (performance.now() - begin) / 1000 };
}

if (typeof process === "object") process.stdout.write(JSON.stringify(play(JSON.parse(require("node:fs").readFileSync(0, "utf8")))));
