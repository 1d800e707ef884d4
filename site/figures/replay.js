"use strict";
// The replay's mass: where Eqs. 10 and 11 draw from as a drift ages. The model sums the package's
// RecencyReplay.probabilities() in closed form, compared over every setting by tests/test_figures.py.
live.replay = {
  // data: {capacity, gamma, offset, edges} from the package; bin k holds ages edges[k] … edges[k + 1] − 1
  mass(data, { mix, rate, exponent, fresh, q }) {
    const N = data.capacity, priority = (reward) =>
      (Math.abs(reward + data.gamma * q - q) + data.offset) ** exponent;
    const [pOld, pNew] = [priority(0), priority(1)];
    const time = (from, to) => // Σ exp(−rate · age)
      (Math.exp(-rate * from) * Math.expm1(-rate * (to - from))) / Math.expm1(-rate);
    const part = (p, from, to) =>
      (to > from ? mix * p * (to - from) + (1 - mix) * time(from, to) : 0);
    const total = part(pNew, 0, fresh) + part(pOld, fresh, N);
    const bins = data.edges.slice(1).map((to, k) => {
      const from = data.edges[k], cut = Math.min(Math.max(fresh, from), to);
      return [part(pOld, cut, to) / total, part(pNew, from, cut) / total]; // old, new
    });
    return { bins, old: part(pOld, fresh, N) / total, recency: ((1 - mix) * time(0, N)) / total };
  },
};

live.figure("replay", (root, state, data) => {
  const M = live.replay, TOP = 0.4;
  const percent = (x) => `${live.number(100 * x, 0)}\u00a0%`;
  const whole = (x) => x.toLocaleString("en");

  // Left: where the draws go, by age. The axis is one of bins, each wider than the one before
  const bars = data.edges.slice(1).map(() => {
    const bin = live.element(root.querySelector("[data-mass]"), "div", { class: "bin" });
    return ["old", "new"].map((kind) => live.element(bin, "div", { class: kind }));
  });
  const ticks = root.querySelector("[data-ticks]");
  data.ticks.forEach(([bin, age]) => live.element(
    ticks, "span", { style: `left: ${(100 * bin) / bars.length}%` }, whole(age)));

  // Right: the part of the draws that is old, while Q goes from the old value to the new one
  const svg = live.element(root.querySelector("[data-curve]"), "svg", { viewBox: "0 0 240 238", "aria-hidden": "true" });
  const X = (q) => 30 + 20 * q, Y = (share) => 200 - 180 * share;
  const text = (x, y, words, kind = "soft") => {
    const node = live.element(svg, "text", { x, y, class: kind }, words);
    return node;
  };
  live.element(svg, "path", { class: "axis", d: `M30,${Y(1)}V${Y(0)}H230` });
  const even = live.element(svg, "path", { class: "axis thin" });
  const curve = live.element(svg, "path", { class: "share" });
  const dot = live.element(svg, "circle", { class: "dot share", r: 7 });
  [[0, "0"], [0.5, "½"], [1, "1"]].forEach(([share, name]) => text(14, Y(share) + 5, name));
  [[0, "0"], [5, "5"], [10, "10"]].forEach(([q, name]) => text(X(q) - 5, 217, name));
  text(30, 234, "Q, from old to new");
  text(36, 12, "share of old data; dashed: even draws");

  const draw = () => {
    const { bins } = M.mass(data, state);
    bars.forEach((pair, k) => pair.forEach((bar, i) => {
      bar.style.height = `${100 * Math.min(bins[k][i] / TOP, 1)}%`;
      bar.style.borderWidth = bins[k][i] ? "" : "0";
    }));
    const points = Array.from({ length: 41 }, (_, k) =>
      `${X(k / 4)},${Y(M.mass(data, { ...state, q: k / 4 }).old).toFixed(2)}`);
    curve.setAttribute("d", `M${points.join("L")}`);
    dot.setAttribute("cx", X(state.q));
    dot.setAttribute("cy", Y(M.mass(data, state).old));
    const share = 1 - state.fresh / data.capacity;
    even.setAttribute("d", `M30,${Y(share)}H230`);
  };

  const words = () => {
    const { fresh, q } = state, { old, recency } = M.mass(data, state);
    const error = (reward) => live.number(Math.abs(reward + data.gamma * q - q), 1);
    return `${whole(fresh)} of the ${whole(data.capacity)} transitions are from after the drift. `
      + `Q is ${q}, so |δ| is ${error(0)} on old data and ${error(1)} on new. `
      + `Old data get ${percent(old)} of the draws; even draws would give them `
      + `${percent(1 - fresh / data.capacity)}. Recency makes ${percent(recency)} of the draws.`;
  };

  const set = (values) => Object.entries(values).forEach(([key, value]) => state.set(key, value));
  return {
    draw, words,
    text: (key, value) => (key === "fresh" ? whole(value) : String(value)),
    press: {
      older: () => state.step("fresh"),
      learn: () => state.step("q"),
      defaults: () => set(data.defaults),
      reset: () => set(data.opening),
    },
    answer: () => {
      set({ ...data.opening, q: 10 });
      const shares = data.rates.map((rate) => M.mass(data, { ...state, rate }).old);
      const least = Math.min(...shares);
      state.set("rate", data.rates[shares.indexOf(least)]);
      return { right: least < 0.5 ? "yes" : "no", why: `At best ${percent(least)} are old. A fast rate `
        + "leaves recency few draws; a slow one reaches back into the old world. β must fall, too." };
    },
  };
});
