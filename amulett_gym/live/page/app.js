"use strict";
// The page: it holds the choices and the run, and calls the other parts once a frame.

Live.app = (() => {
  const { byId, element, write, fixed, DEGREES, clamp, UserError } = Live.base;

  const SPEEDS = [[1, "real time"], [0.5, "1/2"], [0.25, "1/4"], [0.1, "1/10"]];
  const MOST_PASSED = 0.1; // [s] of real time that a frame makes up for
  const WRITE_EVERY = 200; // [ms] between two updates of numbers, which cost more than a picture and have to be read
  const KEPT = 3600; // durations of frames

  const TERMS = [
    ["Two motors, two strings", "One pulls like a biceps, one like a triceps, each over a spring that gets stiffer as it is stretched. Pulling both at once does not move the joint; it makes it stiff."],
    ["The fan", "By how much 1 N m would turn the joint, either way. Wide is soft. The law can only change it by the tension that it asks for."],
    ["Agonist", "The motor that moves the joint at this moment. The other one, the antagonist, keeps the tension that the law asks for."],
    ["Law", "What chooses that tension: a constant, the paper's equation 6, a formula with tuned parameters, or a trained network. It decides every 20 ms; eq. 6 inside the loop at every tick."],
    ["Cost", "What the environment's reward counts: the position error, the motors' effort, the tension error, and a collision. Lower is better. The arm beside yours always has eq. 6 in the paper's loop, with the same setpoint, pushes and sensor noise."],
    ["Link", "It holds your choices and all your inputs. The simulation is deterministic: whoever opens it sees the same numbers."],
  ];

  /** @param {any} data the page's data @param {any} core what `Amulett.load` returned */
  function make(data, core) {
    const settings = { ...data.start };
    const memory = {}; // parameters of laws that were chosen before; those that a device has of its own, for each device

    /** The present device. */
    const device = () => data.devices.find((each) => each.id === settings.device);

    /** Where the parameters of a law are remembered. */
    const place = (id) => (Live.laws.isOfDevice(data.laws.find((each) => each.id === id)) ? `${id} of ${settings.device}` : id);

    settings.law = fresh(settings.law.name);
    let run = begin([]), playing = false, carry = 0, last = NaN, written = 0, untouched = true, dirty = false, awake = false;
    let lag = 0; // share of the last frames that could not make up for the time that had passed
    /** @type {any} content of a link that needs files which this page has not, or others of the same name */
    let awaited = null;
    const durations = [];

    const app = {
      data, settings,
      law: () => data.laws.find((each) => each.id === settings.law.name),
      parameters: () => Live.laws.parametersOf(app.law(), device()),
      state: () => run.state.mine,
      strength: () => 0.5 * data.limits.push,
      input, choose, chooseLaw, setParameter, load, addBundle, addLaw, addScenario, addDevice, moment, table, link, restart, replay,
      get run() { return run; },
      get playing() { return playing; },
      durations,
    };

    // ----- the run -----

    /** A run of the present choices, with inputs that come by themselves. */
    function begin(script) {
      const { content } = device(), task = data.tasks.find((each) => each.id === settings.task);
      const spec = { device: content, loop: settings.loop, law: settings.law, scenario: task.scenario, seed: settings.seed, lawOf: (law) => lawOf(law, content) };
      return Live.run.make(core, spec, script);
    }

    /** A law of the page's list, as the simulation takes it. @param {any} law @param {any} of the device's content */
    function lawOf({ name, parameters }, of) {
      const { content } = data.laws.find((each) => each.id === name), { error_offset_deg: offset, ...others } = parameters;
      if (content.name === "policy") return content;
      // Degrees that are those of the device are left out, so that their radians are the device's to the last bit.
      const own = offset === undefined || Math.abs(offset - of.parameters.error_offset * DEGREES) < 1e-9;
      return { ...content, parameters: own ? others : parameters };
    }

    /** The inputs that come by themselves in the present task. */
    function scripted() {
      const period = device().content.parameters.control_period;
      const task = data.tasks.find((each) => each.id === settings.task);
      return (task.script || []).map(([time, kind, value]) => ({ tick: Math.round(time / period), kind, value }));
    }

    /** Begin anew, with the inputs of the task alone. */
    function restart(play = playing) {
      run = begin(scripted());
      carry = 0;
      setPlaying(play);
      refresh();
    }

    /** Begin anew with the same inputs: the recorded ones, without changes of the law. */
    function replay(play = true) {
      const { period, end, events } = run, before = events.filter((each) => each.kind !== "law");
      run = begin([]);
      run.script(before.map((each) => ({ ...each, tick: Math.round((each.tick * period) / run.period) })), Math.round((end * period) / run.period));
      carry = 0;
      setPlaying(play);
      refresh();
    }

    /** An input of the person in front of the page. */
    function input(kind, value) {
      guarded(() => {
        touched();
        run.input(kind, value);
        redraw();
      });
    }

    function touched() {
      untouched = false;
      byId("hint").classList.add("gone");
    }

    /** Change choices; what is wrong with them is shown. */
    function choose(changes) {
      guarded(() => change(changes));
      refresh();
    }

    /** Change choices, or raise. A loop or a device begins anew, with the inputs so far; a task without them. */
    function change(changes) {
      const before = { ...settings };
      touched();
      Object.assign(settings, changes);
      if (changes.device && !changes.law && Live.laws.isOfDevice(app.law())) settings.law = fresh(settings.law.name);
      const { title, unfit } = device();
      try {
        if (unfit[settings.loop]) {
          if (changes.loop) throw new UserError(`the loop '${settings.loop}' does not fit this device: ${unfit[settings.loop]}`);
          settings.loop = "decentralized";
          Live.messages.show(`${title} cannot have that loop; it now has the paper's.`);
        }
        if (changes.task || !run.events.some((each) => each.kind !== "law")) restart();
        else {
          replay(playing);
          Live.messages.show("From the beginning, with your inputs so far. Drag or push to take over.");
        }
      } catch (error) {
        Object.assign(settings, before);
        throw error;
      }
      refresh();
    }

    /** The law of that name, with the parameters that it had last. */
    function fresh(id, shipped = false) {
      const law = data.laws.find((each) => each.id === id), at = place(id);
      if (shipped) delete memory[at];
      memory[at] ||= Object.fromEntries(Live.laws.parametersOf(law, device()).map((each) => [each.name, each.value]));
      return { name: id, parameters: { ...memory[at] } };
    }

    function chooseLaw(id, shipped = false) {
      const before = settings.law;
      guarded(() => {
        if (run.ownLaw) throw new UserError("the firmware has its own law, eq. 6 in the chip's program; choose another control loop for another law");
        touched();
        settings.law = fresh(id, shipped);
        run.input("law", settings.law);
      }, () => { settings.law = before; });
      refresh();
    }

    function setParameter(name, value) {
      guarded(() => {
        touched();
        const law = { name: settings.law.name, parameters: { ...settings.law.parameters, [name]: value } };
        run.input("law", law);
        settings.law = law;
        memory[place(law.name)] = { ...law.parameters };
        redraw();
      });
    }

    /** Show the law that acts: anywhere else in the record it may be another one. */
    function followLaw() {
      settings.law = run.law;
      memory[place(settings.law.name)] = { ...settings.law.parameters };
    }

    /** Do something that may be refused: then say why, and undo. */
    function guarded(act, undo = () => {}) {
      try {
        act();
      } catch (error) {
        undo();
        Live.messages.fail(error);
      }
    }

    // ----- what is one's own -----

    /** Offer something new, and use it; take it back if that is refused. An open link that needs it is tried again. */
    function offer(list, entry, use) {
      const before = list.findIndex((each) => each.id === entry.id), kept = [...list];
      if (before >= 0) list[before] = entry;
      else list.push(entry);
      try {
        use();
      } catch (error) {
        list.splice(0, list.length, ...kept);
        throw error;
      }
      Live.messages.show(`Now with ${entry.title}.`);
      if (!awaited || !JSON.stringify(awaited).includes(JSON.stringify(entry.id))) return;
      guarded(() => {
        load(awaited);
        Live.messages.show("This is what the link needs: here is its moment.");
      });
    }

    /** A policy bundle. @param {Object<string, Uint8Array>} files */
    function addBundle(files) {
      const policy = core.readPolicy(files), id = `own:policy ${policy.id.slice(0, 12)}`;
      const entry = { id, title: id.slice(4), group: "Your own", description: "a policy of your own", parameters: [], content: { name: "policy", policy: policy.id } };
      offer(data.laws, entry, () => change({ loop: policy.control, law: { name: id, parameters: {} } }));
    }

    /** A tuned law, as `amulett tune-law` writes it. */
    function addLaw(file, content, hash) {
      const recipe = content.recipe || {}, loop = recipe.control || "decentralized", known = core.layout.laws;
      Amulett.base.oneOf(`law of '${file}'`, recipe.law, Object.keys(known));
      Amulett.base.oneOf(`control loop of '${file}'`, loop, data.loops.map((each) => each.id));
      const parameters = known[recipe.law].map((each) => {
        const value = ((content.parameters || {})[each.name] || {}).value;
        Amulett.base.number(`'${each.name}' of '${file}' [${each.unit}]`, value, each.low, each.high);
        return { ...each, title: each.name.replaceAll("_", " "), value };
      });
      const id = `own:${file}`, entry = { id, title: file, group: "Your own", description: `${recipe.law}, tuned by you`, parameters, content: { name: recipe.law, range: data.ranges[loop] }, hash };
      offer(data.laws, entry, () => change({ loop, law: fresh(id, true) }));
    }

    function addScenario(file, content, hash) {
      const id = `own:${file}`, entry = { id, title: file, group: "Your own", description: "a scenario of your own", scenario: content, script: [], hash };
      offer(data.tasks, entry, () => change({ task: id }));
    }

    function addDevice(file, content, hash) {
      const found = Live.profile.read(content, file, core.layout, data), id = `own:${found.title}`;
      for (const at of Object.keys(memory)) if (at.endsWith(` of ${id}`)) delete memory[at];
      offer(data.devices, { ...found, id, group: "Your own", hash }, () => change({ device: id }));
    }

    // ----- links -----

    /** The whole state as data. */
    function moment() {
      const { device, loop, task, seed } = settings;
      const found = { device, loop, law: run.spec.law, task, seed, speed: Number(byId("speed").value), tick: run.tick, end: run.end, events: run.events };
      return { ...found, hashes: Live.link.hashesOf(found, data) };
    }

    /** Show a moment; raises what is wrong with it. @param {any} content of a link */
    function load(content) {
      awaited = JSON.stringify(content).includes('"own:') ? content : null; // until it is open
      const checked = Live.link.check(content, data), before = { ...settings };
      const { device, loop, law, task, seed } = checked;
      Object.assign(settings, { device, loop, law, task, seed });
      try {
        const made = begin([]);
        if (checked.end > made.room()) throw new UserError(`the link's run is longer than ${Live.run.MOST_SECONDS} s, which is the most`);
        made.script(checked.events, checked.end);
        made.advance(checked.tick);
        run = made;
      } catch (error) {
        Object.assign(settings, before);
        throw error;
      }
      awaited = null;
      followLaw();
      byId("speed").value = String(SPEEDS.map(([speed]) => speed).reduce((a, b) => (Math.abs(b - checked.speed) < Math.abs(a - checked.speed) ? b : a)));
      touched();
      setPlaying(false);
      refresh();
    }

    /** Put the state into the address, and copy it. */
    async function link() {
      const text = await Live.link.encode(moment());
      history.replaceState(null, "", `#${text}`);
      let copied = true;
      try { await navigator.clipboard.writeText(location.href); } catch { copied = false; }
      Live.messages.show(copied ? "A link to this moment is copied; it is also in the address." : "The link is in the address: copy it from there.");
      return text;
    }

    /** The run so far as CSV. */
    function table() { return Live.csv.table(run, core); }

    function saveCsv() {
      const file = new Blob([table()], { type: "text/csv" }), url = URL.createObjectURL(file);
      const anchor = element("a", { href: url, download: `amulett-${settings.device.replace(/[^\w-]+/g, "-")}-${(run.ownLaw ? settings.loop : settings.law.name).replace(/[^\w-]+/g, "-")}.csv` });
      document.body.append(anchor);
      anchor.click();
      anchor.remove();
      setTimeout(() => URL.revokeObjectURL(url), 10000);
      Live.messages.show(`Saved ${run.tick + 1} rows, one for each control tick.`);
    }

    // ----- time -----

    function setPlaying(now) {
      playing = now;
      byId("play-word").textContent = now ? "Pause" : "Run";
      byId("play-sign").textContent = now ? "\u275A\u275A" : "\u25B6";
      redraw();
    }

    function stepOnce(ticks) {
      setPlaying(false);
      guarded(() => run.advance(run.tick + Math.min(ticks, run.room())));
      redraw();
    }

    /** Draw in the next frame. */
    function redraw() {
      dirty = true;
      wake();
    }

    function wake() {
      if (!awake) requestAnimationFrame(frame);
      awake = true;
    }

    /** Simulate and draw; while there is nothing to do, no frame is asked for. */
    function frame(now) {
      const began = performance.now(), passed = Math.min((now - last) / 1000, MOST_PASSED);
      [awake, last] = [false, now];
      guarded(() => {
        pointer.follow();
        if (playing && passed > 0) play(passed);
      }, () => setPlaying(false));
      guarded(() => {
        if (dirty || playing) draw(now);
      }, () => {
        setPlaying(false);
        dirty = false; // else each frame would be refused, and say so
      });
      durations.push(performance.now() - began);
      if (durations.length > KEPT) durations.shift();
      if (playing || dirty || pointer.pull) wake();
      else last = NaN; // the next frame is a first one
    }

    function play(passed) {
      lag += 0.1 * (Number(passed === MOST_PASSED) - lag);
      carry += (passed * Number(byId("speed").value)) / run.period;
      const ticks = Math.min(Math.floor(carry), run.room());
      carry -= Math.floor(carry);
      run.advance(run.tick + ticks);
      const task = data.tasks.find((each) => each.id === settings.task);
      if (untouched && task.repeat && run.time > task.repeat) restart();
      if (run.room() === 0) {
        setPlaying(false);
        Live.messages.show(`A run has ${Live.run.MOST_SECONDS} s at most. Restart to go on.`);
      }
    }

    // ----- pictures and numbers -----

    const geometry = () => device().geometry;

    function draw(now) {
      dirty = false;
      if (run.law !== settings.law) {
        followLaw();
        refresh();
      }
      const { mine, twin } = run.state;
      Live.arm.draw(byId("mine-canvas"), mine, geometry(), { ghost: twin.angle, pull: pointer.pull, handle: true, active: pointer.part });
      Live.arm.draw(byId("twin-canvas"), twin, geometry(), { colour: Live.palette.colours.twin });
      Live.strips.draw(run.samples, run.time, playing);
      if (now - written >= WRITE_EVERY || !playing) {
        written = now;
        writeNumbers(mine, twin);
      }
    }

    function writeNumbers(mine, twin) {
      panel.showInputs(mine);
      Live.strips.write(run.samples);
      write(byId("clock"), `${run.time.toFixed(2)} s`);
      write(byId("pace"), playing && lag > 0.5 ? "slower than real time" : "");
      const bar = byId("time");
      bar.max = String(Math.max(run.end, 1));
      bar.value = String(run.tick);
      bar.setAttribute("aria-valuetext", `${run.time.toFixed(2)} seconds`);
      for (const [name, state] of [["mine", mine], ["twin", twin]]) {
        write(byId(`${name}-cost`), state.cost.toFixed(3));
        readings[name].forEach((reading, k) => write(reading, READINGS[k][1](state)));
        const failure = byId(`${name}-failure`);
        failure.hidden = !state.failed;
        if (state.failed) write(failure, `Left its limits (${state.failed}). Restart, or go back in time.`);
        byId(`${name}-canvas`).setAttribute("aria-label", described(name, state));
      }
      write(byId("verdict"), verdict(mine, twin));
    }

    const READINGS = /** @type {[string, (state: any) => string][]} */ ([
      ["stiffness", (state) => `${fixed(state.stiffness, 1)} N m/rad`],
      ["1 N m turns it by", (state) => (state.stiffness > 0 ? `${fixed(DEGREES / state.stiffness, 1)}°` : "freely")],
      ["error", (state) => `${fixed((state.setpoint - state.angle) * DEGREES, 1)}°`],
      ["tension asked for", (state) => (state.tensionSetpoint === null ? "–" : `${fixed(state.tensionSetpoint, 1)} N`)],
    ]);
    const readings = Object.fromEntries(["mine", "twin"].map((name) => [name, READINGS.map(([title]) => {
      const value = element("dd", { text: "–" });
      byId(`${name}-readings`).append(element("div", {}, element("dt", { text: title, title }), value));
      return value;
    })]));

    function described(name, state) {
      return `${name === "mine" ? "Your arm" : "The arm under eq. 6"}: ${fixed(state.angle * DEGREES, 0)} degrees, setpoint ${fixed(state.setpoint * DEGREES, 0)}, tensions ${fixed(state.tension[0], 1)} and ${fixed(state.tension[1], 1)} newtons, stiffness ${fixed(state.stiffness, 1)} newton metres per radian`;
    }

    /** @returns {string} your cost beside eq. 6's, once there is something to compare */
    function verdict(mine, twin) {
      // An arm that has failed costs no more, so the two costs no longer compare.
      if (mine.failed || twin.failed) return mine.failed && twin.failed ? "both arms failed" : `${mine.failed ? "your arm" : "eq. 6's arm"} failed`;
      if (twin.cost < 1e-3) return "your cost / eq. 6's: –";
      const share = mine.cost / twin.cost;
      if (Math.abs(share - 1) < 0.005) return "costs as much as eq. 6";
      return share < 1 ? `costs ${Math.round(100 * (1 - share))} % less than eq. 6` : share < 2 ? `costs ${Math.round(100 * (share - 1))} % more than eq. 6` : `costs ${share < 100 ? share.toPrecision(2) : Math.round(share)} times eq. 6's`;
    }

    /** Show the choices anew, and draw. */
    function refresh() {
      const loop = data.loops.find((each) => each.id === settings.loop);
      byId("mine-law").textContent = run.ownLaw ? "eq. 6 on the chip" : app.law().title;
      byId("mine-loop").textContent = `${loop.title} \u00B7 ${device().title}`;
      for (const label of document.querySelectorAll(".cost small")) label.textContent = run.control ? "cost, full control" : "cost so far";
      panel.showChoices();
      redraw();
    }

    // ----- wiring -----

    const nudge = (degrees) => {
      const most = data.limits.setpoint, angle = run.asked.setpoint + degrees / DEGREES;
      input("setpoint", clamp(Math.round(angle * DEGREES) / DEGREES, -most, most));
    };
    const another = (way) => {
      const { laws } = data, at = laws.findIndex((each) => each.id === settings.law.name);
      chooseLaw(laws[(at + way + laws.length) % laws.length].id);
    };
    const letGo = () => input("push", 0);
    Live.keys.make([
      { keys: [" "], shown: "Space", does: "run or pause", down: () => setPlaying(!playing) },
      { keys: ["."], shown: ".", does: "one step of the law, 20 ms", down: () => stepOnce(run.agentTicks) },
      { keys: [","], shown: ",", does: "one control tick", down: () => stepOnce(1) },
      { keys: ["arrowright", "arrowup"], shown: "→ ↑", does: "setpoint up by 5° (Shift: 1°)", down: (event) => nudge(event.shiftKey ? 1 : 5) },
      { keys: ["arrowleft", "arrowdown"], shown: "← ↓", does: "setpoint down by 5° (Shift: 1°)", down: (event) => nudge(event.shiftKey ? -1 : -5) },
      { keys: [..."0123456789"], shown: "0 … 9", does: "setpoint to 0° … 90°", down: (event) => input("setpoint", (Number(event.key) * 10) / DEGREES) },
      { keys: ["f"], shown: "F", does: "push in flexion, while held", down: () => input("push", app.strength()), up: letGo },
      { keys: ["e"], shown: "E", does: "push in extension, while held", down: () => input("push", -app.strength()), up: letGo },
      { keys: ["escape"], shown: "Esc", does: "let go of the push", down: letGo },
      { keys: ["o"], shown: "O", does: "obstacle in or out", down: () => panel.toggleObstacle() },
      { keys: ["p"], shown: "P", does: "payload of 0.5 kg in or out", down: () => input("payload", run.state.mine.payload > 0 ? 0 : Math.min(0.5, data.limits.payload)) },
      { keys: ["]"], shown: "]", does: "next law", down: () => another(1) },
      { keys: ["["], shown: "[", does: "law before", down: () => another(-1) },
      { keys: ["s"], shown: "S", does: "slow motion: 1/2, 1/4, 1/10, real time", down: () => slower() },
      { keys: ["r"], shown: "R", does: "restart without your inputs", down: () => guarded(() => restart()) },
      { keys: ["y"], shown: "Y", does: "replay with your inputs", down: () => guarded(() => replay()) },
      { keys: ["l"], shown: "L", does: "link to this moment", down: () => { link().catch(Live.messages.fail); } },
      { keys: ["c"], shown: "C", does: "save the run as CSV", down: () => guarded(saveCsv) },
      { keys: ["?"], shown: "?", does: "this help", down: () => byId("help").showModal() },
    ]);
    byId("help-terms").append(...TERMS.flatMap(([term, meaning]) => [element("dt", { text: term }), element("dd", { text: meaning })]));

    function slower() {
      const speed = byId("speed"), k = SPEEDS.findIndex(([value]) => String(value) === speed.value);
      speed.value = String(SPEEDS[(k + 1) % SPEEDS.length][0]);
      Live.messages.show(`Speed: ${SPEEDS[(k + 1) % SPEEDS.length][1]}`);
    }

    byId("speed").append(...SPEEDS.map(([value, text]) => element("option", { value, text: String(text) })));
    byId("speed").value = String(settings.speed);
    const panel = Live.panel.make(app);
    const pointer = Live.pointer.make(byId("mine-canvas"), {
      frame: () => run.state.mine, limits: data.limits, touched,
      setpoint: (angle) => { if (angle !== run.asked.setpoint) input("setpoint", angle); },
      push: (torque) => { if (torque !== run.asked.push) input("push", torque); },
    });
    Live.strips.make(byId("strips"));
    Live.drop.make(app);
    byId("play").addEventListener("click", () => setPlaying(!playing));
    byId("step").addEventListener("click", () => stepOnce(run.agentTicks));
    byId("restart").addEventListener("click", () => guarded(() => restart()));
    byId("replay").addEventListener("click", () => guarded(() => replay()));
    byId("copy-link").addEventListener("click", () => link().catch(Live.messages.fail));
    byId("save-csv").addEventListener("click", () => guarded(saveCsv));
    byId("open-help").addEventListener("click", () => byId("help").showModal());
    byId("time").addEventListener("input", () => guarded(() => {
      setPlaying(false);
      run.seek(Number(byId("time").value));
      redraw();
    }));
    document.addEventListener("submit", (event) => { if (!(event.target instanceof HTMLElement && event.target.closest("dialog"))) event.preventDefault(); });
    new ResizeObserver(redraw).observe(byId("stage"));
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { Live.palette.read(); redraw(); });
    window.addEventListener("hashchange", () => open(location.hash));

    /** Open a link's text. */
    async function open(hash) {
      if (hash.length < 2 || byId(hash.slice(1))) return; // none, or a place on this page
      try { load(await Live.link.decode(hash.slice(1))); } catch (error) { Live.messages.fail(error); }
    }
    app.open = open;

    refresh();
    restart(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
    return app;
  }

  /** Begin: read the page's data, load the simulation, and open the link in the address. */
  async function start() {
    const data = JSON.parse(byId("data").textContent);
    const bytes = Amulett.base.fromBase64(data.wasm, "the simulation"), { hex } = data;
    delete data.wasm;
    delete data.hex;
    data.simulation = Live.link.digest(new Uint8Array([...bytes, ...new TextEncoder().encode(hex)]));
    Live.palette.read();
    const core = await Amulett.load(bytes, hex), policies = {};
    for (const [name, files] of Object.entries(data.policies)) {
      policies[name] = core.readPolicy(Object.fromEntries(Object.entries(files).map(([file, text]) => [file, Amulett.base.fromBase64(text, file)]))).id;
    }
    for (const { content } of data.laws) if (content.name === "policy") content.policy = policies[content.policy];
    delete data.policies;
    const app = make(data, core);
    globalThis.amulettLive = app; // for the console, and for tests
    if (location.hash.length > 1) await app.open(location.hash);
    document.documentElement.dataset.ready = "true";
  }

  return { start };
})();

Live.app.start().catch((error) => {
  Live.messages.show(`This page cannot run here: ${error.message}. It needs a browser with WebAssembly of 2023 or later.`, true);
  console.error(error);
});
