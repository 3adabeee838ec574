"use strict";
// An arm: a device in a scenario, with a control loop and a law, that is played tick by tick and takes live inputs.

Amulett.arm = (() => {
  const { AmulettError, isObject, number, oneOf, sha256, shown } = Amulett.base;
  const { record, checkDevice, checkScenario, checkSeed, writeDevice, writeScenario, writeObstacle, loadArm } = Amulett.records;
  const MAGIC = "amulett-live-snapshot";
  const FARTHEST = 4 * Math.PI; // of a setpoint [rad]: beyond any arm, and all numbers stay finite

  const START = {
    1: "the strings cannot hold the arm where it begins: a string force is out of the springs' range. Choose another initial angle, tension, payload or obstacle",
    2: "a drive cannot reach where the arm begins: it is beyond its command limit. Choose another initial angle or tension",
    3: "the strings load a drive with its stall torque where the arm begins. Choose a smaller initial tension or payload",
  };

  /**
   * Make an arm.
   * @param {any} core @param {{device: any, loop?: string, law?: any, scenario?: any,
   *   seed?: number | bigint | string, agentPeriod?: number, actionDelay?: number, observationNoise?: number,
   *   tensionRange?: number[] | null}} options
   *   `scenario`: the content of a scenario file; `seed`: key of the sensor noise if the scenario has no `noise_seed`;
   *   the others are keywords of the environment
   */
  function make(core, options) {
    const { layout } = core, { records, constants } = layout, wasm = core.instance();
    const allowed = ["device", "loop", "law", "scenario", "seed", "agentPeriod", "actionDelay", "observationNoise", "tensionRange"];
    for (const key of Object.keys(options)) oneOf("option of an arm", key, allowed);
    const { scenario: given = {}, seed = 0, agentPeriod = 0.02, actionDelay = 0, observationNoise = 0, tensionRange = null } = options;
    const device = checkDevice(layout, options.device), loop = oneOf("loop", options.loop ?? "decentralized", [...layout.loops, layout.firmware.loop]);
    const onChip = loop === layout.firmware.loop;
    const at = (name) => record(wasm.memory.buffer, wasm[`${name}_at`](), records[name]);
    const parameters = at("device"), gains = at("loop"), scene = at("scenario"), state = at("state");
    const memory = new Uint8Array(wasm.memory.buffer, wasm.memory_at(), 8 * constants.MEMORY);
    const index = layout.loops.indexOf(loop) - 2; // of those with gains; the paper's two are before, and the firmware's
    const ranges = index < 0 ? layout.tensionRange : layout.feedForwardRange;

    writeDevice(layout, device, loop, parameters, gains);
    const scenario = checkScenario(layout, given, device), period = parameters.get("control_period");
    const path = writeScenario(layout, device, scenario, checkSeed(seed), scene);
    path.forEach((part, k) => {
      const into = record(wasm.memory.buffer, wasm.path_at() + k * records.part.size, records.part);
      for (const [name, value] of Object.entries(part)) into.set(name, value);
    });
    const chosen = onChip ? constants.OUTSIDE : Math.max(index, -1);
    wasm.choose(chosen, path.length);
    const parts = new Uint8Array(wasm.memory.buffer, wasm.path_at(), path.length * records.part.size);
    const identity = sha256(new Uint8Array([index, ...parameters.bytes, ...(index < 0 ? [] : gains.bytes), ...parts]));
    /** @type {any} */
    let law = null;
    let ticks = 0, phase = 0, wanted = 0, delay = 0; // of an agent step: length, ticks passed, tension at its end, ticks until its ramp
    let range = ranges;
    setLaw(options.law ?? { name: "eq6" });
    const problem = START[wasm.begin()];
    if (problem) throw new AmulettError(problem);
    const firmware = onChip ? beginFirmware() : null;
    let known = { start: state.get("step_start"), jump: 0 }; // of the setpoint's moves, as the firmware has them

    /** Start the firmware where the episode begins: `begin_of` of firmware/recording.py. */
    function beginFirmware() {
      if (!core.hex) throw new AmulettError("the loop 'firmware' needs the hex file; give its text to Amulett.load");
      const found = Amulett.firmware.make(core.hex), both = (name) => [state.get(`${name}_biceps`), state.get(`${name}_triceps`)];
      const springs = new Float64Array(wasm.memory.buffer, wasm.read_springs(), constants.READINGS).slice(3, 5), biases = ["biceps", "triceps"].map((name) => scene.get(`slider_bias_${name}`));
      const single = (...names) => names.map((name) => state.get(name));
      found.start([
        ...both("command"), ...single("angle", "tension_setpoint"), ...both("estimate"), ...single("measured_difference", "position_output"), ...both("offset"),
        state.get("tension_integral"), state.get("angle") + scene.get("encoder_bias"), springs[0] + biases[0], springs[1] + biases[1],
      ], state.get("agonist"));
      return found;
    }

    /** Let the firmware do the next control tick's part: `tick` of firmware/env.py. */
    function askFirmware() {
      const start = state.get("step_start"), jump = state.get("setpoint_jump"), late = Boolean(wasm.misses());
      const count = (name, resolution) => Math.round(state.get(name) / parameters.get(resolution));
      const { commands, tension, agonist } = firmware.tick({
        encoder: count("measured_angle", "encoder_resolution"), biceps: count("measured_biceps", "slider_resolution"), triceps: count("measured_triceps", "slider_resolution"),
        setpoint: state.get("setpoint"), jump: jump - known.jump, begins: start !== known.start, late,
      });
      known = { start, jump: late ? jump : 0 }; // a loop that misses its tick leaves the jump
      wasm.command(...commands, tension, agonist);
    }

    /** Choose the law; a new step of the agent begins. @param {any} next {name, parameters} (laws.js) */
    function setLaw(next) { take(lawOf(next)); }

    /** A law with what it needs to act here, checked. */
    function lawOf(next) {
      if (onChip && (next?.name !== "eq6" || Object.keys(next.parameters || {}).length)) throw new AmulettError("the firmware has its own law, eq. 6 with the device's parameters; choose another loop for another law");
      const found = Amulett.laws.make(layout, next, device, { range: tensionRange || ranges, period: agentPeriod, policies: core.policies });
      const own = found.range || tensionRange || ranges, steps = ticksOf(found.period || agentPeriod), late = found.delay ?? actionDelay;
      if (index < 0 && own[0] === 0) throw new AmulettError(`the law chooses tensions from 0 N on; the loop '${loop}' needs more. Choose another loop, such as 'co-rotation'`);
      number("the delay of an action [control ticks]", late, 0, steps - 1);
      return { law: found, ticks: steps, range: own, delay: late };
    }

    function take(found) {
      if (law && law.inLoop !== "agent") state.set("tension_command", state.get("tension_setpoint"));
      ({ law, ticks, range, delay } = found);
      phase = 0;
      state.set("tension_rate", 0);
      writeLaw();
    }

    function writeLaw() {
      parameters.set("law", layout.tensionLaws[law.inLoop]);
      const { nominal_tension, minimum_tension, error_offset } = device.parameters;
      for (const [name, value] of Object.entries({ nominal_tension, minimum_tension, error_offset, ...law.fields })) parameters.set(name, value);
    }

    /** The control ticks in a time between two actions. */
    function ticksOf(time) {
      number("the time between two actions [s]", time, 0, 100);
      const found = Math.max(Math.round(time / period), 1);
      if (Math.abs(found * period - time) > 1e-6 * time) throw new AmulettError(`the law acts every ${time} s; that has to be a multiple of the control period, ${period} s`);
      return found;
    }

    const observation = () => Float64Array.from(new Float32Array(wasm.memory.buffer, wasm.observe(...range, delay, observationNoise), layout.observations.length));

    /** Let an agent's tension go on a ramp over its step: envs/transition.py. */
    function beginRamp() { state.set("tension_rate", (wanted - state.get("tension_command")) / ticks); }
    function endRamp() { state.set("tension_command", wanted - delay * state.get("tension_rate")); }

    /** Simulate a number of control ticks; a device that failed keeps its state. @param {number} count */
    function step(count) {
      number("the number of ticks", count, 0, 1e9);
      for (let left = Math.floor(count); left > 0;) {
        const agent = law.inLoop === "agent";
        if (agent && phase === 0) wanted = Amulett.laws.tensionOf(Math.min(Math.max(law.act(observation()), -1), 1), range);
        if (agent && phase === delay) beginRamp();
        const stop = agent && phase < delay ? delay : ticks, now = onChip ? 1 : Math.min(left, stop - phase);
        if (onChip && state.get("failure") === constants.RUNNING) askFirmware();
        if (wasm.play(now)) return;
        left -= now;
        phase += now;
        if (phase < ticks) continue;
        if (agent) endRamp();
        phase = 0;
      }
    }

    /** The costs of the episode so far, each as in the reward and not capped, and their sum; null without divisors. */
    function cost(track) {
      const prices = device.prices[track], row = prices && prices[scene.get("family")];
      if (!row) return { terms: null, sum: null };
      const effort = track === "schedule" ? state.get("effort_biceps") + state.get("effort_triceps") : state.get("drive_effort");
      const raw = [state.get("position_ise"), effort, state.get("tension_ise"), state.get("contact_ise")];
      const terms = raw.map((value, k) => value * row[k]);
      return { terms: Object.fromEntries(layout.costTerms.map((name, k) => [name, terms[k]])), sum: terms.reduce((sum, term) => sum + term, 0) };
    }

    /** What is true of the arm now, in SI units and rad; pairs are those of biceps and triceps. */
    function read() {
      const pair = (name) => [state.get(`${name}_biceps`), state.get(`${name}_triceps`)];
      const [stiffness, ...springs] = new Float64Array(wasm.memory.buffer, wasm.read_springs(), constants.READINGS);
      const schedule = cost("schedule"), control = cost("full-control"), wantedStiffness = state.get("stiffness_setpoint");
      const side = scene.get("obstacle_stiffness") > 0 ? scene.get("obstacle_side") : 0;
      return {
        tick: state.get("tick"), time: state.get("tick") * period,
        angle: state.get("angle"), velocity: state.get("velocity"), setpoint: state.get("setpoint"),
        tension: pair("force"), // of the strings [N]
        tensionSetpoint: parameters.get("tension_loop") ? state.get("tension_setpoint") : null, // null: the loop takes none
        stiffness, stiffnessSetpoint: Number.isNaN(wantedStiffness) ? null : wantedStiffness, // at the joint [N m/rad]
        commands: pair("command"), driveAngles: pair("drive"), driveSpeeds: springs.slice(4, 6),
        strings: springs.slice(0, 2), springs: springs.slice(2, 4), // deflections of strings, and of their linear springs [m]
        agonist: state.get("agonist"), // +1: biceps, -1: triceps
        push: state.get("push_torque"), hand: wasm.pushed(), // from outside in the last tick; of it by hand, from now on
        contact: state.get("contact_torque"),
        payload: scene.get("payload_mass"),
        obstacle: side ? { angle: scene.get("obstacle_angle"), side, stiffness: scene.get("obstacle_stiffness"), damping: scene.get("obstacle_damping") } : null,
        measured: { angle: state.get("measured_angle"), velocity: state.get("measured_velocity"), tension: pair("estimate"), springs: pair("measured") },
        positionIse: state.get("position_ise"), tensionIse: state.get("tension_ise"), isav: pair("isav"), effort: pair("effort"), driveEffort: state.get("drive_effort"),
        cost: schedule.sum, costs: schedule.terms, controlCost: control.sum, controlCosts: control.terms,
        failed: layout.failures[state.get("failure")] || null, // the reason, null: it has not failed
      };
    }

    /** Let a move of the setpoint begin at the end of the next control tick: a step, or over a duration [s]. */
    function setSetpoint(angle, duration = 0) {
      number("the setpoint [rad]", angle, -FARTHEST, FARTHEST);
      if (number("the move's duration [s]", duration, 0, 1e6) > 0) number("the move's duration [s]", duration, 1e-3, 1e6);
      wasm.begin_move(angle, duration);
    }

    /** Push the forearm with a torque [N m], positive in flexion, until the next call; a scenario's pushes add. */
    const setPush = (torque) => wasm.push(number("the push [N m]", torque, -100, 100));

    /**
     * Put an obstacle in the forearm's path, or take it away.
     * @param {null | number | {angle: number, side?: number, stiffness?: number, damping?: number}} obstacle joint angle of
     *   its surface [rad]; side +1 blocks flexion, -1 extension, by default that on which the arm is not; N m/rad, N m s/rad
     */
    function setObstacle(obstacle) {
      if (obstacle === null) return writeObstacle(device, scene, null);
      const of = typeof obstacle === "number" ? { angle: obstacle } : obstacle;
      if (!isObject(of)) throw new AmulettError(`the obstacle is ${shown(obstacle)}; it has to be null, an angle [rad] or {angle, side, stiffness, damping}`);
      for (const key of Object.keys(of)) oneOf("key of an obstacle", key, ["angle", "side", "stiffness", "damping"]);
      const angle = number("the obstacle's angle [rad]", of.angle, -Math.PI, Math.PI);
      const side = of.side ?? (state.get("angle") <= angle ? 1 : -1);
      if (side !== 1 && side !== -1) throw new AmulettError(`the obstacle's side is ${shown(side)}; it has to be 1 (blocks flexion) or -1 (extension)`);
      return writeObstacle(device, scene, { angle, side, stiffness: of.stiffness ?? 20, damping: of.damping ?? 0 });
    }

    /** Put a payload into the hand. @param {number} mass [kg] @param {number} [arm] lever about the joint [m] */
    function setPayload(mass, arm = scene.get("payload_arm") || device.payloadArm) {
      loadArm(layout, device, scene, number("the payload [kg]", mass, 0, 20), number("the payload's lever arm [m]", arm, 0, 1));
    }

    /** Let the law be a constant tension [N]. */
    const setTension = (tension) => setLaw({ name: "constant", parameters: { tension } });

    const onPath = () => (scene.get("move_count") === constants.ON_PATH ? path.length : 0);

    /** The whole moment as bytes, for `restore` of an arm with the same device, loop and scenario. */
    function snapshot() {
      const head = { magic: MAGIC, version: 1, identity, law: law.spec, remembered: law.state(), phase, wanted, push: wasm.pushed(), known: firmware && known };
      const text = new TextEncoder().encode(JSON.stringify(head)), size = new Uint8Array(4);
      new DataView(size.buffer).setUint32(0, text.length, true);
      return new Uint8Array([...size, ...text, ...state.bytes, ...scene.bytes, ...memory, ...(firmware ? firmware.snapshot() : [])]);
    }

    /** Go to a snapshot's moment. The bytes are checked before anything changes. @param {Uint8Array} bytes */
    function restore(bytes) {
      const wrong = (text) => { throw new AmulettError(`the snapshot ${text}`); };
      const length = bytes instanceof Uint8Array && bytes.length > 4 ? new DataView(bytes.buffer, bytes.byteOffset, 4).getUint32(0, true) : Infinity;
      const [first, second, third] = [4 + length, 4 + length + state.bytes.length, 4 + length + state.bytes.length + scene.bytes.length];
      if (!Number.isFinite(length) || bytes.length !== third + memory.length + (firmware ? firmware.size : 0)) wrong("is damaged: it has another length");
      let head;
      try { head = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes.subarray(4, first))); } catch { wrong("is damaged: its head is no JSON"); }
      if (!isObject(head) || head.magic !== MAGIC || head.version !== 1) wrong("is of another version, or none");
      if (head.identity !== identity) wrong(`is of another device, loop or path of the setpoint; this arm is '${device.name}' in '${loop}'`);
      const copy = bytes.slice();
      const states = record(copy.buffer, first, records.state), scenes = record(copy.buffer, second, records.scenario);
      checkRecords(states, scenes, wrong);
      number("the snapshot's push", head.push, -100, 100);
      number("the snapshot's tension", head.wanted, -1e6, 1e6);
      const chip = copy.subarray(third + memory.length);
      if (firmware) {
        number("the snapshot's begin of a move [s]", head.known?.start, -1e6, 1e6);
        number("the snapshot's jump [rad]", head.known.jump, -1e6, 1e6);
        if (!firmware.fits(chip)) wrong("is damaged: its chip is not at rest");
      }
      const found = lawOf(head.law);
      number("the snapshot's phase", head.phase, 0, found.ticks - 1);
      found.law.remember(head.remembered);
      take(found);
      state.bytes.set(states.bytes);
      scene.bytes.set(scenes.bytes);
      memory.set(copy.subarray(third, third + memory.length));
      if (firmware) {
        firmware.restore(chip);
        known = head.known;
      }
      [phase, wanted] = [Math.floor(head.phase), head.wanted];
      wasm.push(head.push);
      wasm.choose(chosen, onPath());
    }

    /** Refuse records with which the simulation would not stay within its tables. */
    function checkRecords(states, scenes, wrong) {
      const within = (of, name, low, high) => { if (!(of.get(name) >= low && of.get(name) <= high)) wrong(`is damaged: '${name}' is ${of.get(name)}`); };
      const numbers = [[states, records.state, ["inside_since", "stiffness_setpoint"]], [scenes, records.scenario, []]];
      for (const [of, { fields }, free] of numbers) {
        for (const [name, [, , count]] of Object.entries(fields)) {
          for (let k = 0; k < count; k++) if (!Number.isFinite(of.get(name, k)) && !free.includes(name)) wrong(`is damaged: '${name}' is ${of.get(name, k)}`);
        }
      }
      within(scenes, "move_count", path.length ? constants.ON_PATH : 0, constants.MAX_MOVES);
      within(scenes, "push_count", 0, constants.MAX_PUSHES);
      within(scenes, "family", 0, layout.families.length - 1);
      within(scenes, "orientation", 0, layout.orientations.length - 1);
      within(states, "move", -1, (scenes.get("move_count") === constants.ON_PATH ? path.length : constants.MAX_MOVES) - 1);
      within(states, "failure", 0, layout.failures.length - 1);
      within(states, "tick", 0, 2 ** 40);
      if (Math.abs(states.get("agonist")) !== 1) wrong(`is damaged: 'agonist' is ${states.get("agonist")}`);
    }

    return { device, loop, scenario, controlPeriod: period, step, read, observation, setSetpoint, setPush, setObstacle, setPayload, setLaw, setTension, snapshot, restore };
  }

  return { make };
})();
