"use strict";
// The panel's fields: labelled sliders, choices and checks, each reachable and usable by keyboard.

Live.fields = (() => {
  const { element, write, fixed, clamp } = Live.base;
  let count = 0;

  /**
   * A slider with its name and value.
   * @param {{label: string, unit?: string, low: number, high: number, step?: number, digits?: number, value: number,
   *   logarithmic?: boolean, help?: string, id?: string, onInput: (value: number) => void}} of
   */
  function slider(of) {
    const id = of.id || `field-${++count}`, steps = 400, digits = of.digits === undefined ? 1 : of.digits;
    const toPlace = (value) => (of.logarithmic ? (steps * Math.log(value / of.low)) / Math.log(of.high / of.low) : value);
    const toValue = (place) => {
      const value = of.logarithmic ? of.low * (of.high / of.low) ** (place / steps) : place;
      return clamp(Number(value.toPrecision(6)), of.low, of.high);
    };
    const input = /** @type {HTMLInputElement} */ (element("input", {
      type: "range", id, min: of.logarithmic ? 0 : of.low, max: of.logarithmic ? steps : of.high,
      step: of.logarithmic ? 1 : of.step || (of.high - of.low) / 400, title: of.help || false,
    }));
    const output = element("output", { for: id });
    const show = (value) => {
      write(output, `${fixed(value, digits)}${of.unit && of.unit !== "1" ? `\u2009${of.unit}` : ""}`);
      input.setAttribute("aria-valuetext", output.textContent);
    };
    const set = (value) => { input.value = String(toPlace(value)); show(value); };
    input.addEventListener("input", () => {
      const value = toValue(Number(input.value));
      show(value);
      of.onInput(value);
    });
    set(of.value);
    return { node: element("div", { class: "field" }, element("label", { for: id, text: of.label }), output, input), input, set };
  }

  /**
   * A choice among names; a group's name stands above its choices.
   * @param {{label: string, id?: string, choices: {id: string, title: string, group?: string, why?: string}[], value: string,
   *   onChange: (id: string) => void}} of `why`: the reason for which a choice cannot be taken
   */
  function select(of) {
    const id = of.id || `field-${++count}`, input = /** @type {HTMLSelectElement} */ (element("select", { id }));
    const fill = (choices, value) => {
      input.replaceChildren();
      const groups = {};
      for (const choice of choices) {
        const option = element("option", { value: choice.id, text: choice.title, disabled: Boolean(choice.why), title: choice.why || false });
        if (!choice.group) input.append(option);
        else (groups[choice.group] ||= input.appendChild(element("optgroup", { label: choice.group }))).append(option);
      }
      input.value = value;
    };
    fill(of.choices, of.value);
    input.addEventListener("change", () => of.onChange(input.value));
    return { node: element("div", { class: "field" }, element("label", { for: id, text: of.label }), input), input, fill };
  }

  /** @param {{label: string, id?: string, value: boolean, onChange: (on: boolean) => void}} of */
  function check(of) {
    const input = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id: of.id || `field-${++count}` }));
    input.checked = of.value;
    input.addEventListener("change", () => of.onChange(input.checked));
    return { node: element("label", { class: "check" }, input, document.createTextNode(of.label)), input };
  }

  /**
   * A button that acts while it is held, by pointer, Space or Enter.
   * @param {{label: string, title?: string, onHold: (held: boolean) => void}} of
   */
  function hold(of) {
    const node = element("button", { type: "button", text: of.label, title: of.title || false, "aria-pressed": "false" });
    let held = false;
    const set = (now) => {
      if (now === held) return;
      held = now;
      node.setAttribute("aria-pressed", String(held));
      of.onHold(held);
    };
    node.addEventListener("pointerdown", (event) => { node.setPointerCapture(event.pointerId); set(true); });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) node.addEventListener(name, () => set(false));
    node.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      set(true);
    });
    node.addEventListener("keyup", (event) => { if (event.key === " " || event.key === "Enter") set(false); });
    return { node };
  }

  return { slider, select, check, hold };
})();
