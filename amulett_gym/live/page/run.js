"use strict";
// A run: two arms with the same inputs, and the record of these inputs. The simulation is deterministic, so that the
// record is the whole state: replaying it gives the same numbers to the last bit, here and on another computer.

Live.run = (() => {
  const { UserError } = Live.base;

  const SAMPLE = 0.02; // [s] between two samples of the strips: some pixels hold one
  const SNAPSHOT = 2; // [s] between two snapshots, from which an earlier moment is found again
  const SHARED = ["setpoint", "push", "obstacle", "payload"]; // inputs of both arms; "law" is of yours alone
  const MOST_EVENTS = 20000;
  const MOST_SECONDS = 600;

  /** @typedef {{tick: number, kind: string, value: any}} Input what comes before the tick that it acts in */
  /**
   * @typedef {Object} Spec what a run begins with
   * @property {any} device @property {string} loop @property {Law} law @property {any} scenario @property {number} seed
   * @property {(law: Law) => any} lawOf returns a law as the simulation takes it
   */
  /** @typedef {{name: string, parameters: Object<string, number>}} Law of the page's list */

  /**
   * @param {any} core what `Amulett.load` returned
   * @param {Spec} spec
   * @param {Input[]} events inputs that come by themselves, in the order of their ticks
   */
  function make(core, spec, events = []) {
    const { device, scenario, seed, lawOf } = spec;
    const ownLaw = spec.loop === core.layout.firmware.loop; // eq. 6 on the chip, whatever law is chosen
    const mine = core.arm({ device, loop: spec.loop, law: ownLaw ? { name: "eq6" } : lawOf(spec.law), scenario, seed });
    const twin = core.arm({ device, loop: "decentralized", law: { name: "eq6" }, scenario, seed });
    const period = mine.controlPeriod, agentTicks = Math.max(Math.round(0.02 / period), 1);
    const sampleTicks = Math.max(Math.round(SAMPLE / period), 1), snapshotTicks = Math.round(SNAPSHOT / period);
    const capacity = Math.ceil((Live.strips.SECONDS + 1) / (sampleTicks * period));
    const samples = { mine: Live.samples.make(capacity), twin: Live.samples.make(capacity) };
    events = [...events];
    let tick = 0, next = 0, end = 0; // next: index of the first event that has not acted yet
    /** @type {{tick: number, next: number, mine: Uint8Array, twin: Uint8Array}[]} */
    let snapshots = [{ tick: 0, next: 0, mine: mine.snapshot(), twin: twin.snapshot() }];
    // Loops are compared by the cost of the track "full control", laws in the paper's by that of "schedule".
    const control = core.layout.loops.indexOf(spec.loop) >= 2;
    const look = (arm) => {
      const found = arm.read();
      return control ? { ...found, cost: found.controlCost } : found;
    };
    let state = { mine: look(mine), twin: look(twin) };
    sample();

    function sample() {
      samples.mine.add(state.mine);
      samples.twin.add(state.twin);
    }

    function apply({ kind, value }) {
      if (kind === "law") {
        if (!ownLaw) mine.setLaw(lawOf(value));
        return;
      }
      for (const arm of [mine, twin]) {
        if (kind === "setpoint") arm.setSetpoint(value);
        else if (kind === "push") arm.setPush(value);
        else if (kind === "obstacle") arm.setObstacle(value);
        else arm.setPayload(value);
      }
    }

    /** Let the next recorded input act. One that is refused, as after a change of the device, leaves the record. */
    function replay() {
      try {
        apply(events[next]);
      } catch (error) {
        events = events.filter((_, k) => k !== next);
        throw error;
      }
      next++;
    }

    /** Simulate up to a tick, with the recorded inputs. @param {number} target */
    function advance(target) {
      while (tick < target) {
        if (tick % snapshotTicks === 0 && tick > snapshots[snapshots.length - 1].tick) {
          snapshots.push({ tick, next, mine: mine.snapshot(), twin: twin.snapshot() });
        }
        while (next < events.length && events[next].tick <= tick) replay();
        let stop = Math.min(target, (Math.floor(tick / sampleTicks) + 1) * sampleTicks, (Math.floor(tick / snapshotTicks) + 1) * snapshotTicks);
        if (next < events.length) stop = Math.min(stop, events[next].tick);
        mine.step(stop - tick);
        twin.step(stop - tick);
        tick = stop;
        if (tick % sampleTicks === 0) {
          state = { mine: look(mine), twin: look(twin) };
          sample();
        }
      }
      end = Math.max(end, tick);
      state = { mine: look(mine), twin: look(twin) };
    }

    /** Go to a tick of the record, earlier or later. @param {number} target */
    function seek(target) {
      const from = Math.max(target - Math.round(Live.strips.SECONDS / period), 0); // the strips need what was before
      if (target >= tick && target - tick < from) return advance(target);
      const place = [...snapshots].reverse().find((each) => each.tick <= from) || snapshots[0];
      restore(place);
      [tick, next] = [place.tick, place.next];
      for (const each of Object.values(samples)) each.clear();
      state = { mine: look(mine), twin: look(twin) };
      sample();
      return advance(target);
    }

    /** @type {{mine: Uint8Array, twin: Uint8Array}} both arms at the present tick, before its inputs */
    let before;

    function restore(place) {
      mine.restore(place.mine);
      twin.restore(place.twin);
    }

    /**
     * Record an input, which acts from the next tick on: the newest of its kind within a tick, as if the others had not
     * been, so that the record gives the same numbers again. What was recorded for later is dropped: all of it, or if
     * only the law changes, the later laws, so that another law can meet the same pushes.
     * @param {string} kind @param {any} value
     */
    function input(kind, value) {
      if (events.length >= MOST_EVENTS) throw new UserError(`the run holds ${MOST_EVENTS} inputs, which is the most; restart it`);
      const later = kind === "law" ? events.slice(next).filter((each) => each.kind !== "law") : [];
      const earlier = events.slice(0, next).filter((each) => each.tick < tick), acted = events.slice(earlier.length, next);
      if (acted.length) restore(before);
      else before = { mine: mine.snapshot(), twin: twin.snapshot() };
      const inputs = [...acted.filter((each) => each.kind !== kind), { tick, kind, value }];
      try {
        inputs.forEach(apply);
      } catch (error) { // it stays as it was
        restore(before);
        acted.forEach(apply);
        throw error;
      }
      events = [...earlier, ...inputs, ...later];
      next = earlier.length + inputs.length;
      if (kind !== "law") end = tick;
      snapshots = snapshots.filter((each) => each.tick < tick || each.tick === 0);
      state = { mine: look(mine), twin: look(twin) };
    }

    return {
      spec, period, agentTicks, control, ownLaw, samples, advance, seek, input,
      /** Before the first tick: let inputs come by themselves, and a replay last until a tick. */
      script: (inputs, until) => { [events, end] = [[...inputs], until]; },
      /** Ticks that can still be simulated. */
      room: () => Math.max(Math.floor(MOST_SECONDS / period) - tick, 0),
      get tick() { return tick; },
      get time() { return tick * period; },
      get end() { return Math.max(end, events.length ? events[events.length - 1].tick : 0); },
      get replaying() { return next < events.length || tick < end; },
      get events() { return events; },
      /** The setpoint and the push by hand that are asked for, though no tick may have followed. */
      get asked() {
        let { setpoint } = state.mine.failed ? state.twin : state.mine; // an arm that failed takes no more
        for (let k = next - 1; k >= 0 && events[k].tick === tick; k--) if (events[k].kind === "setpoint") { setpoint = events[k].value; break; }
        return { setpoint, push: state.mine.hand };
      },
      /** The law that acts: the run's first, or the one that was chosen last. @returns {Law} */
      get law() {
        for (let k = next - 1; k >= 0; k--) if (events[k].kind === "law") return events[k].value;
        return spec.law;
      },
      get state() { return state; },
      arms: { mine, twin },
    };
  }

  return { make, SHARED, MOST_EVENTS, MOST_SECONDS };
})();
