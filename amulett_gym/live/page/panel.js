"use strict";
// The panel beside the arms: inputs, choices, the law's parameters.

Live.panel = (() => {
  const { byId, element, DEGREES } = Live.base;
  const { slider, select, check, hold } = Live.fields;

  const FEW = 5; // so many parameters are shown at once; more are folded away

  /**
   * @param {any} app the page's functions, see app.js
   */
  function make(app) {
    const { data } = app, limits = data.limits, most = limits.setpoint * DEGREES;
    /** @type {{angle: number, stiffness: number, damping: number}} */
    const obstacle = { angle: 60, stiffness: 8, damping: 0 };

    const setpoint = slider({ label: "Setpoint", id: "setpoint", unit: "°", low: -Math.min(30, most), high: most, step: 1, digits: 0, value: 0, onInput: (value) => app.input("setpoint", value / DEGREES) });
    const push = slider({ label: "Push", id: "push", unit: "N m", low: -limits.push, high: limits.push, step: 0.01, digits: 2, value: 0, help: "Springs back when a pointer lets it go; by keyboard it stays until Esc", onInput: (value) => app.input("push", value) });
    for (const name of ["pointerup", "pointercancel"]) push.input.addEventListener(name, () => app.input("push", 0));
    const extend = hold({ label: "\u2212 Extend", title: "Push while held (E)", onHold: (held) => app.input("push", held ? -app.strength() : 0) });
    const flex = hold({ label: "Flex +", title: "Push while held (F)", onHold: (held) => app.input("push", held ? app.strength() : 0) });
    const blocked = check({ label: "Obstacle", id: "obstacle", value: false, onChange: (on) => { obstacles.hidden = !on; placeObstacle(on); } });
    const where = slider({ label: "at", unit: "°", low: -30, high: 120, step: 1, digits: 0, value: obstacle.angle, onInput: (value) => { obstacle.angle = value; placeObstacle(true); } });
    const hard = slider({ label: "stiffness", unit: "N m/rad", low: 1, high: limits.obstacle, logarithmic: true, digits: 1, value: obstacle.stiffness, onInput: (value) => { obstacle.stiffness = value; placeObstacle(true); } });
    const obstacles = element("div", { class: "inner", hidden: true }, where.node, hard.node);
    const payload = slider({ label: "Payload at the hand", id: "payload", unit: "kg", low: 0, high: limits.payload, step: 0.05, digits: 2, value: 0, onInput: (value) => app.input("payload", value) });

    byId("input-fields").append(setpoint.node, push.node, element("div", { class: "field" }, element("div", { class: "row" }, extend.node, flex.node)), blocked.node, obstacles, payload.node);

    function placeObstacle(on) {
      const angle = obstacle.angle / DEGREES, side = app.state().angle <= angle ? 1 : -1;
      app.input("obstacle", on ? { angle, side, stiffness: obstacle.stiffness, damping: obstacle.damping } : null);
    }

    const task = select({ label: "Task", id: "task", choices: data.tasks, value: app.settings.task, onChange: (id) => app.choose({ task: id }) });
    const device = select({ label: "Device", id: "device", choices: data.devices, value: app.settings.device, onChange: (id) => app.choose({ device: id }) });
    const loop = select({ label: "Control loop", id: "loop", choices: [], value: "", onChange: (id) => app.choose({ loop: id }) });
    const law = select({ label: "Law of the tension", id: "law", choices: [], value: "", onChange: (id) => app.chooseLaw(id) });
    byId("choice-fields").append(task.node, device.node, loop.node, law.node);

    /** Show the present choices, and the parameters of the present law. */
    function showChoices() {
      const { settings } = app, chosen = data.devices.find((each) => each.id === settings.device);
      task.fill(data.tasks, settings.task);
      device.fill(data.devices, settings.device);
      loop.fill(data.loops.map((each) => ({ ...each, why: chosen.unfit[each.id] || "" })), settings.loop);
      if (app.run.ownLaw) law.fill([{ id: "", title: "eq. 6, compiled into the firmware" }], "");
      else law.fill(data.laws, settings.law.name);
      law.input.disabled = app.run.ownLaw;
      const described = [data.tasks.find((each) => each.id === settings.task), chosen, data.loops.find((each) => each.id === settings.loop), ...(app.run.ownLaw ? [] : [app.law()])];
      byId("choice-note").replaceChildren(...described.flatMap((each, k) => (each.description ? [
        element("b", { text: `${each.title}: ` }), document.createTextNode(each.description), ...(k < 3 ? [element("br")] : []),
      ] : [])));
      showParameters();
    }

    /** @type {Map<string, {set: (value: number) => void}>} */
    const parameters = new Map();

    function showParameters() {
      const of = app.law(), { settings } = app, values = settings.law.parameters;
      parameters.clear();
      const nodes = (app.run.ownLaw ? [] : app.parameters()).map((each) => {
        const made = slider({
          label: each.title, unit: each.unit, low: each.name === "tension" ? data.ranges[settings.loop][0] : each.low, high: each.high, digits: each.high < 3 ? 3 : 1, logarithmic: each.logarithmic,
          help: each.meaning, value: values[each.name], onInput: (value) => app.setParameter(each.name, value),
        });
        parameters.set(each.name, made);
        return made.node;
      });
      const reset = element("button", { type: "button", text: "As shipped" });
      reset.addEventListener("click", () => app.chooseLaw(of.id, true));
      const content = nodes.length ? [...nodes, element("div", { class: "row" }, reset)] : [];
      const inner = element("div", { class: "inner" }, ...content);
      const folded = nodes.length > FEW ? element("details", { id: "parameters" }, element("summary", { text: `its ${nodes.length} parameters` }), inner) : inner;
      byId("law-fields").replaceChildren(...(nodes.length ? [folded] : []));
    }

    /** Show where the inputs are now, except for the one that is being moved. @param {any} state */
    function showInputs(state) {
      const active = document.activeElement, { asked } = app.run;
      const show = (field, value) => { if (!(field.input === active && field.input.matches(":active"))) field.set(value); };
      show(setpoint, Math.round(asked.setpoint * DEGREES));
      show(push, asked.push);
      show(payload, state.payload);
      blocked.input.checked = Boolean(state.obstacle);
      obstacles.hidden = !state.obstacle;
      if (state.obstacle) {
        const { angle, stiffness, damping } = state.obstacle;
        Object.assign(obstacle, { angle: Math.round(angle * DEGREES), stiffness, damping });
        show(where, obstacle.angle);
        show(hard, obstacle.stiffness);
      }
    }

    return { showChoices, showInputs, toggleObstacle: () => blocked.input.click() };
  }

  return { make };
})();
