"use strict";
// The parabola of α: Eq. 8 on two samples. The model is closed_form_alpha and the squared residual,
// compared over every setting by tests/test_figures.py.
live.parabola = {
  booster(angle, length) { // h on two samples, at this angle to the residual
    const turn = (angle * Math.PI) / 180;
    return [length * Math.cos(turn), length * Math.sin(turn)];
  },
  sums(r, h) { // A and B of Eq. 8
    return [r[0] * h[0] + r[1] * h[1], h[0] * h[0] + h[1] * h[1]];
  },
  alpha(r, h) {
    const [A, B] = live.parabola.sums(r, h);
    return A / B;
  },
  loss(r, h, alpha) {
    return r.reduce((sum, x, i) => sum + (x - alpha * h[i]) ** 2, 0);
  },
};

live.figure("parabola", (root, state) => {
  const M = live.parabola, r = [1, 0], UNIT = 84, REACH = 3, HIGH = 3;
  const [left, right] = [...root.querySelectorAll("[data-plot]")].map((place) =>
    live.element(place, "svg", { viewBox: place.dataset.plot, "aria-hidden": "true" }));
  const line = (svg, kind) => live.element(svg, "path", { class: kind });
  const label = (svg, kind = "") => live.element(svg, "text", { class: kind });
  const put = (node, x, y, text) => {
    node.setAttribute("x", x);
    node.setAttribute("y", y);
    node.textContent = text;
  };

  // Left: the residual r, the booster h, the step α h, and what it leaves
  const O = [132, 150], at = ([x, y]) => [O[0] + UNIT * x, O[1] - UNIT * y];
  const arrow = (from, to, head = 9) => {
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]], size = Math.hypot(dx, dy);
    if (size < 2) return `M${from}`;
    const [ux, uy] = [dx / size, dy / size], wing = (s) =>
      [to[0] - head * (ux + s * uy * 0.5), to[1] - head * (uy - s * ux * 0.5)];
    return `M${from}L${to}M${wing(1)}L${to}L${wing(-1)}`;
  };
  const ray = line(left, "fitted thin"), rest = line(left, "axis thin"), whole = line(left, "frozen");
  const part = line(left, "fitted");
  const grip = live.element(left, "circle", { class: "grip", r: 11 });
  const [nameR, nameH, nameRest] = [label(left), label(left), label(left, "soft")];

  // Right: the squared residual over α
  const X = (alpha) => 20 + (300 * (alpha + REACH)) / (2 * REACH), Y = (loss) => 215 - (190 * loss) / HIGH;
  const band = live.element(right, "rect", { class: "band", y: Y(HIGH), height: Y(0) - Y(HIGH) });
  live.element(right, "path", { class: "axis", d: `M20,${Y(0)}H320M${X(0)},${Y(HIGH)}V${Y(0)}` });
  live.element(right, "path", { class: "axis thin", d: `M20,${Y(1)}H320` });
  const curve = line(right, "frozen");
  for (let alpha = -REACH; alpha <= REACH; alpha += 1) {
    put(label(right, "soft"), X(alpha) - (alpha < 0 ? 9 : 4), 232, live.number(alpha, 0));
  }
  put(label(right, "soft"), 24, Y(1) - 6, "without the booster");
  put(label(right, "soft"), X(0) + 5, 22, "Σ (r − αh)²");
  put(label(right, "soft"), 306, 208, "α");
  const best = live.element(right, "circle", { class: "best", r: 7 });
  const dot = live.element(right, "circle", { class: "dot", r: 8 });
  const nameBest = label(right);

  const now = () => {
    const h = M.booster(state.angle, state.length), [A, B] = M.sums(r, h);
    return { h, A, B, best: M.alpha(r, h), loss: M.loss(r, h, state.alpha) };
  };
  const draw = () => {
    const { h, best: top } = now(), tip = at(h), step = [state.alpha * h[0], state.alpha * h[1]];
    ray.setAttribute("d", `M${O}L${tip}`);
    whole.setAttribute("d", arrow(O, at(r)));
    part.setAttribute("d", arrow(O, at(step)));
    rest.setAttribute("d", arrow(at(step), at(r), 6));
    grip.setAttribute("cx", tip[0]);
    grip.setAttribute("cy", tip[1]);
    put(nameR, at(r)[0] - 4, O[1] + 18, "r");
    put(nameH, tip[0] + 14, tip[1] - 8, "h");
    put(nameRest, 6, 240, "Drag h. Dashed: what αh leaves of r");
    const edges = [X(Math.min(0, 2 * top)), X(Math.max(0, 2 * top))].map((x) => Math.min(Math.max(x, 20), 320));
    band.setAttribute("x", edges[0]);
    band.setAttribute("width", edges[1] - edges[0]);
    const points = [];
    for (let k = 0; k <= 120; k += 1) {
      const alpha = -REACH + (k * 2 * REACH) / 120, loss = M.loss(r, h, alpha);
      if (loss <= HIGH * 1.1) points.push(`${X(alpha).toFixed(1)},${Y(loss).toFixed(1)}`);
    }
    curve.setAttribute("d", `M${points.join("L")}`);
    best.setAttribute("cx", X(top));
    best.setAttribute("cy", Y(M.loss(r, h, top)));
    put(nameBest, Math.min(X(top) - 12, 290), Y(M.loss(r, h, top)) + (M.loss(r, h, top) > 0.4 ? 22 : -14), "A/B");
    dot.setAttribute("cx", X(state.alpha));
    dot.setAttribute("cy", Y(Math.min(M.loss(r, h, state.alpha), HIGH)));
  };

  const words = () => {
    const n = live.number, { A, B, best: top, loss } = now();
    const change = Math.abs(loss - 1) < 0.01 ? "about as much as without the booster"
      : loss < 1 ? `${n(100 * (1 - loss), 0)}\u00a0% less than without the booster`
        : `${n(100 * (loss - 1), 0)}\u00a0% more than without the booster`;
    const range = Math.abs(top) < 1e-9 ? "No α lowers it: h is at a right angle to r."
      : `Every α between 0 and 2A/B = ${n(2 * top)} lowers it.`;
    return `A = ${n(A)}, B = ${n(B)}: the best α is A/B = ${n(top)}, which leaves `
      + `${n(M.loss(r, M.booster(state.angle, state.length), top))} of 1. ${range} `
      + `With α = ${n(state.alpha)} the squared residual is ${n(loss)}, ${change}.`;
  };

  const hold = (value, input) => { // the nearest value that the slider has
    const { min, max, step } = root.querySelector(`[data-key="${input}"]`);
    const k = Math.round((Math.min(Math.max(value, min), max) - min) / step);
    return Number((Number(min) + k * step).toFixed(9));
  };
  const where = (svg, event) => {
    const point = new DOMPoint(event.clientX, event.clientY);
    return point.matrixTransform(svg.getScreenCTM().inverse());
  };
  const drag = (node, svg, move) => {
    node.addEventListener("pointerdown", (event) => {
      node.setPointerCapture(event.pointerId);
      move(where(svg, event));
      event.preventDefault();
    });
    node.addEventListener("pointermove", (event) => {
      if (node.hasPointerCapture(event.pointerId)) move(where(svg, event));
    });
  };
  // Without this a swipe to the right may leave the page: a browser takes it for "back".
  grip.addEventListener("touchstart", (event) => event.preventDefault(), { passive: false });
  drag(grip, left, (point) => {
    const x = (point.x - O[0]) / UNIT, y = (O[1] - point.y) / UNIT;
    state.set("angle", hold((Math.atan2(Math.max(y, 0), x) * 180) / Math.PI, "angle"));
    state.set("length", hold(Math.hypot(x, y), "length"));
    state.show();
  });
  right.classList.add("drag");
  drag(right, right, (point) => {
    state.set("alpha", hold(((point.x - 20) * 2 * REACH) / 300 - REACH, "alpha"));
    state.show();
  });
  const choose = (times) => () => state.set("alpha", hold(times * now().best, "alpha"));
  return {
    draw, words,
    text: (key, value) => (key === "angle" ? `${value}°` : live.number(value)),
    press: {
      best: choose(1), twice: choose(2), shrunk: choose(0.1),
      reset: () => [["angle", 60], ["length", 1], ["alpha", 1]].forEach(([key, value]) => state.set(key, value)),
    },
    answer: () => {
      state.set("angle", 135);
      state.set("alpha", hold(now().best, "alpha"));
      return { right: "negative", why: `A/B = ${live.number(now().best)}: Eq. 8 turns h around. `
        + "The paper says that every α is positive." };
    },
  };
});
