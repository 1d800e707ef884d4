"use strict";
// The learning curves of the study of what to keep. Every number comes from learning_curves.py: a curve is a
// list of whole numbers, each as its difference to the one before.
live.curves = {
  line(steps) {
    let x = 0;
    return steps.map((step) => { x += step; return x; });
  },
};

live.figure("curves", (root, state, data) => {
  const M = live.curves, [first] = Object.keys(data.tasks), on = new Set(data.opening);
  const svg = live.element(root.querySelector("[data-graph]"), "svg", { preserveAspectRatio: "none", "aria-hidden": "true" });
  const buttons = [...root.querySelectorAll("[data-press]")].filter(({ dataset }) => dataset.press !== "reset");
  const slider = root.querySelector('[data-key="episode"]');
  let task, curves; // curves: {arm: [middle, low, high]}

  const episode = (k) => data.first + data.every * k;
  const Y = (x) => {
    const { ticks } = task, top = ticks[ticks.length - 1];
    return ((100 * (top - x)) / (top - ticks[0])).toFixed(2);
  };
  const shown = () => Object.keys(curves).filter((arm) => on.has(arm));

  // Drawn once for each task; drawing then only hides, shows and moves
  let parts, cursor;
  const load = () => {
    task = data.tasks[state.task || first];
    curves = Object.fromEntries(Object.entries(task.arms).map(([arm, lines]) => [arm, lines.map(M.line)]));
    root.querySelector("[data-verdict]").textContent = ""; // it was about another task
    root.querySelectorAll("[data-guess]").forEach((each) => each.removeAttribute("aria-pressed"));
    slider.max = Object.values(curves)[0][0].length - 1;
    svg.textContent = "";
    svg.setAttribute("viewBox", `0 0 ${task.episodes} 100`);
    task.drifted.forEach(([start, end]) => live.element(
      svg, "rect", { class: "reversed", x: start, width: end - start, height: 100 }));
    task.ticks.forEach((x) => live.element(svg, "path", { class: "axis", d: `M0,${Y(x)}H${task.episodes}` }));
    cursor = live.element(svg, "path", { class: "cursor" });
    parts = Object.fromEntries(buttons.filter(({ dataset }) => dataset.press in curves).map((button) => {
      const arm = button.dataset.press, style = button.getAttribute("style");
      const [middle, low, high] = curves[arm].map((line) => line.map((x, k) => `${episode(k)},${Y(x)}`));
      const part = (kind, d) => live.element(svg, "path", { class: kind, style, d });
      return [arm, [part("half", `M${low.join("L")}L${high.reverse().join("L")}Z`),
        part("curve", `M${middle.join("L")}`), part("spot", "")]];
    }));
    const named = (place, list) => {
      place.textContent = "";
      list.forEach(([style, name]) => live.element(place, "span", { style }, name));
    };
    named(root.querySelector("[data-heights]"), task.ticks.map((x) => [`top: ${Y(x)}%`, live.number(x, 0)]));
    named(root.querySelector("[data-ticks]"), [...new Set([0, ...task.drifted.flat(), task.episodes])]
      .map((x) => [`left: ${(100 * x) / task.episodes}%`, x]));
  };

  const draw = () => {
    const x = episode(state.episode);
    cursor.setAttribute("d", `M${x},0V100`);
    Object.entries(parts).forEach(([arm, pieces]) => {
      pieces.forEach((piece) => { piece.style.display = on.has(arm) ? "" : "none"; });
      pieces[2].setAttribute("d", `M${x},${Y(curves[arm][0][state.episode])}h0`);
    });
    buttons.forEach((button) => {
      button.disabled = !(button.dataset.press in curves);
      button.setAttribute("aria-pressed", on.has(button.dataset.press) && !button.disabled);
    });
  };

  const words = () => {
    const x = episode(state.episode), name = (arm) => buttons
      .find(({ dataset }) => dataset.press === arm).textContent.trim();
    const reversed = task.drifted.some(([start, end]) => x >= start && x < end);
    const levels = shown().map((arm) => [curves[arm][0][state.episode], name(arm)])
      .sort((a, b) => b[0] - a[0]).map(([level, label]) => `${label} ${live.number(level, 0)}`);
    return `Episode ${x}, motor ${reversed ? "reversed" : "right"}. `
      + (levels.length ? `Returns, the highest first: ${levels.join("; ")}.` : "No agent is switched on.");
  };

  const pick = ({ clientX }) => {
    const { left, width } = svg.getBoundingClientRect();
    const k = Math.round((((clientX - left) / width) * task.episodes - data.first) / data.every);
    state.set("episode", Math.min(Math.max(k, 0), slider.max));
    state.show();
  };
  ["pointerdown", "pointermove"].forEach((kind) => svg.addEventListener(kind, pick));

  const only = (arms) => { on.clear(); arms.forEach((arm) => on.add(arm)); };
  const flip = (arm) => () => { if (!on.delete(arm)) on.add(arm); };
  return {
    draw, words,
    text: (key, value) => String(episode(value)),
    changed: (key) => { if (key !== "episode") load(); },
    press: {
      ...Object.fromEntries(buttons.map(({ dataset }) => [dataset.press, flip(dataset.press)])),
      reset: () => only(data.opening),
    },
    answer: () => {
      only(data.twins);
      return task.answer;
    },
  };
});
