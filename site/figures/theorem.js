"use strict";
// Theorem 1 on one room with two doors, of which the second starts to pay 1. The model is the
// package's MDP.residual, compared over every setting by tests/test_figures.py.
live.theorem = {
  residual(Q, gamma) { // of Q's own targets, one for each door
    const best = Math.max(...Q);
    return Q.map((q, door) => door + gamma * best - q);
  },
  boosted(gamma, alpha, boosts) { // before and after each perfect booster
    let Q = [0, 0], fixed = live.theorem.residual(Q, gamma); // what is left of the first targets
    return Array.from({ length: boosts + 1 }, () => {
      const now = { fixed, own: live.theorem.residual(Q, gamma) };
      fixed = fixed.map((r) => r - alpha * r);
      Q = Q.map((q, door) => q + alpha * now.own[door]);
      return now;
    });
  },
  squares: (g) => g.reduce((sum, x) => sum + x * x, 0),
};

live.figure("theorem", (root, state, data) => {
  const M = live.theorem, HIGH = 2;
  const [left, right] = [...root.querySelectorAll("[data-plot]")].map((place) =>
    live.element(place, "svg", { viewBox: place.dataset.plot, "aria-hidden": "true" }));
  const KINDS = {
    fixed: ["frozen", ({ fixed }) => M.squares(fixed)],
    own: ["fitted", ({ own }) => M.squares(own)],
    largest: ["sup", ({ own }) => Math.max(...own.map(Math.abs))],
  };
  const text = (svg, x, y, words) => live.element(svg, "text", { x, y, class: "soft" }, words);

  // Left: the residuals at the doors
  const Y = (x) => 205 - 180 * x;
  live.element(left, "path", { class: "axis", d: `M25,${Y(0)}H265M25,${Y(1)}H265` });
  text(left, 8, Y(0) + 5, "0");
  text(left, 8, Y(1) + 5, "1");
  const bars = [0, 1].map((door) => {
    text(left, 45 + 120 * door, 225, ["pays 0", "pays 1 now"][door]);
    return ["fixed", "own"].map((kind, k) =>
      live.element(left, "rect", { class: `bar ${kind}`, x: 40 + 120 * door + 44 * k, width: 40 }));
  });
  text(left, 25, 244, "residual at each door");

  // Right: boost by boost
  const X = (m) => 25 + (295 * m) / data.boosts, Z = (x) => 205 - (180 * x) / HIGH;
  live.element(right, "path", { class: "axis", d: `M25,${Z(HIGH)}V${Z(0)}H320` });
  live.element(right, "path", { class: "axis thin", d: `M25,${Z(1)}H320` });
  for (let x = 0; x <= HIGH; x += 1) text(right, 8, Z(x) + 5, x);
  for (let m = 0; m <= data.boosts; m += 10) text(right, X(m) - 6, 222, m);
  text(right, 32, 14, "sum of squares; green: largest");
  text(right, 262, 238, "boosters");
  const drawn = Object.fromEntries(Object.entries(KINDS).map(([kind, [name]]) => [kind, {
    line: live.element(right, "path", { class: name }),
    dot: live.element(right, "circle", { class: `dot ${name}`, r: 6 }),
  }]));

  const path = () => M.boosted(state.gamma, state.alpha, data.boosts);
  const draw = () => {
    const found = path(), now = found[state.boosts];
    bars.forEach((pair, door) => pair.forEach((bar, k) => {
      const x = [now.fixed, now.own][k][door];
      bar.setAttribute("y", Y(x));
      bar.setAttribute("height", Y(0) - Y(x));
    }));
    Object.entries(KINDS).forEach(([kind, [, value]]) => {
      const { line, dot } = drawn[kind];
      line.setAttribute("d", `M${found.map((each, m) => `${X(m).toFixed(1)},${Z(value(each)).toFixed(1)}`).join("L")}`);
      dot.setAttribute("cx", X(state.boosts));
      dot.setAttribute("cy", Z(value(now)));
    });
  };

  const words = () => {
    const now = path()[state.boosts], { boosts, gamma, alpha } = state, n = live.number;
    const [fixed, own, largest] = Object.values(KINDS).map(([, value]) => value(now));
    const than = Math.abs(own - 1) < 0.005 ? "as at the start" : own > 1 ? "more than at the start" : "less than at the start";
    return `After ${boosts} booster${boosts === 1 ? "" : "s"} the sum of squares is ${n(fixed)} if the targets stay fixed. `
      + `With its own targets it is ${n(own)}, ${than}. The largest residual is ${n(largest)}, `
      + `the bound of T1-h: a factor of ${n(1 - alpha + alpha * gamma, 3)} for each booster.`;
  };

  const set = (values) => Object.entries(values).forEach(([key, value]) => state.set(key, value));
  return {
    draw, words,
    text: (key, value) => (key === "boosts" ? String(value) : live.number(value, key === "alpha" ? 1 : 2)),
    press: {
      one: () => state.step("boosts"),
      paper: () => set(data.paper),
      reset: () => set(data.opening),
    },
    answer: () => {
      set(data.asked);
      const sums = path().map(KINDS.own[1]), sum = sums[data.asked.boosts], top = sums.indexOf(Math.max(...sums));
      return { right: sum > 1.005 ? "larger" : sum < 0.995 ? "smaller" : "same", why: `It is ${live.number(sum)}, `
        + `and rises until booster ${top}. The door that pays raises the targets of both.` };
    },
  };
});
