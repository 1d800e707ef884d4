"use strict";
// What the live figures share. A figure is HTML with inputs (data-key; data-values are those of a
// slider whose steps are uneven) and buttons (data-press, data-guess); its script gives the model and
// draws. Classic scripts, so that pages work from the disk.
window.live = {
  // start(figure, state): called once for each figure of this name; returns {draw, words, press}
  figure(name, start) {
    const ready = () => document.querySelectorAll(`[data-figure="${name}"]`)
      .forEach((root) => live.attach(root, start));
    if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", ready);
    else ready();
  },

  attach(root, start) {
    const inputs = [...root.querySelectorAll("[data-key]")], state = {};
    const frames = root.querySelector("script[type='application/json']");
    const figure = start(root, state, frames && JSON.parse(frames.textContent));
    const said = root.querySelector("[data-said]");
    let waiting;
    const values = ({ dataset }) => (dataset.values || "").split(" ").map(Number);
    const read = () => inputs.forEach((input) => {
      const key = input.dataset.key;
      if (input.type === "range") {
        state[key] = input.dataset.values ? values(input)[input.value] : Number(input.value);
      } else if (input.checked) state[key] = input.value;
    });
    const show = () => {
      read();
      figure.draw();
      inputs.filter((input) => input.type === "range").forEach((input) => {
        const text = figure.text(input.dataset.key, state[input.dataset.key]);
        input.setAttribute("aria-valuetext", figure.spoken?.(input.dataset.key) ?? text);
        input.parentNode.querySelector("output").textContent = text;
      });
      const words = figure.words();
      root.querySelector("[data-words]").textContent = words;
      clearTimeout(waiting); // a screen reader hears where a drag ends, not all it passes
      waiting = setTimeout(() => { said.textContent = words; }, 400);
    };
    state.set = (key, value) => {
      inputs.filter((input) => input.dataset.key === key).forEach((input) => {
        if (input.type === "radio") input.checked = input.value === value;
        else input.value = input.dataset.values ? values(input).indexOf(value) : value;
      });
      read();
    };
    state.step = (key) => {
      root.querySelector(`[data-key="${key}"]`).stepUp();
      read();
    };
    state.show = show;
    inputs.forEach((input) => input.addEventListener("input", () => {
      read();
      if (figure.changed) figure.changed(input.dataset.key);
      show();
    }));
    root.querySelectorAll("[data-press]").forEach((button) =>
      button.addEventListener("click", () => { figure.press[button.dataset.press](); show(); }));
    root.querySelectorAll("[data-guess]").forEach((button) =>
      button.addEventListener("click", () => {
        const guess = button.dataset.guess;
        root.querySelectorAll("[data-guess]").forEach((each) =>
          each.setAttribute("aria-pressed", each === button));
        const { right, why } = figure.answer();
        root.querySelector("[data-verdict]").textContent =
          (guess === right ? "Right. " : "Not so. ") + why;
        show();
      }));
    read();
    if (figure.changed) figure.changed(null);
    show();
    root.classList.add("on");
  },

  number: (x, digits = 2) => {
    const text = Math.abs(x).toFixed(digits);
    return (x < 0 && Number(text) !== 0 ? "−" : "") + text;
  },

  // [1, 3, 4, 5] → "1 and 3 to 5"
  list(numbers) {
    const runs = [];
    numbers.forEach((x) => {
      const run = runs[runs.length - 1];
      if (run && run[1] === x - 1) run[1] = x;
      else runs.push([x, x]);
    });
    const parts = runs.map(([a, b]) => (a === b ? `${a}` : b === a + 1 ? `${a} and ${b}` : `${a} to ${b}`));
    return parts.length < 2 ? parts.join("")
      : `${parts.slice(0, -1).join(", ")} and ${parts[parts.length - 1]}`;
  },

  element(parent, tag, attributes = {}, text = "") {
    const svg = parent.namespaceURI.endsWith("svg") || tag === "svg";
    const node = document.createElementNS(
      svg ? "http://www.w3.org/2000/svg" : "http://www.w3.org/1999/xhtml", tag);
    Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
    node.textContent = text;
    parent.appendChild(node);
    return node;
  },
};
