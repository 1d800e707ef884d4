"use strict";
// The ten rooms. The model is the package's MDP of the corridor and notebooks/pictures/instrument.py,
// compared over every setting by tests/test_figures.py.
live.rooms = {
  ROOMS: 10,
  TIE: 1e-9, // values that differ by no more are the same

  world(goal, gamma) {
    const r = Array.from({ length: 10 }, (_, s) => (s === goal ? [0, 0] : [-1, -1]));
    return { goal, gamma, r };
  },

  bellman(world, Q) {
    const best = Q.map((q) => Math.max(...q));
    return world.r.map((r, s) => r.map((reward, a) => {
      const next = s === world.goal ? s : Math.min(Math.max(s + (a ? 1 : -1), 0), 9);
      return reward + world.gamma * best[next];
    }));
  },

  residual(world, Q) {
    return live.rooms.bellman(world, Q).map((q, s) => q.map((y, a) => y - Q[s][a]));
  },

  optimum(world, tolerance = 1e-12) {
    let Q = world.r.map(() => [0, 0]), last = Infinity;
    for (;;) {
      const g = live.rooms.residual(world, Q), size = Math.max(...g.flat().map(Math.abs));
      if (!(size > tolerance * (1 - world.gamma) && size < last)) return Q;
      Q = Q.map((q, s) => q.map((x, a) => x + g[s][a]));
      last = size;
    }
  },

  drift(Q, goal) { // a finished episode is worth 0, whatever was learnt in that room
    return Q.map((q, s) => (s === goal ? [0, 0] : q));
  },

  boost(world, Q, target, lossOn, alpha) {
    const step = lossOn === "h" ? alpha : 1; // fitted to α h, the booster cancels α
    const mix = (a, b) => a.map((row, s) => row.map((x, i) => (1 - step) * x + step * b[s][i]));
    if (target === "live") {
      return live.rooms.optimum(
        { goal: world.goal, gamma: step * world.gamma, r: mix(Q, world.r) });
    }
    const g = live.rooms.residual(world, Q);
    return Q.map((q, s) => q.map((x, a) => x + step * g[s][a]));
  },

  way(q) { // what is greedy: −1 left, 1 right, 0 both
    return Math.abs(q[1] - q[0]) <= live.rooms.TIE ? 0 : Math.sign(q[1] - q[0]);
  },
};

live.figure("rooms", (root, state) => {
  const M = live.rooms, SHOWN = 11;
  const stage = root.querySelector("[data-stage]");
  let world, Q, past; // past: the policy after each boost since the drift

  const ways = () => Q.map((q, s) => (s === world.goal ? null : M.way(q)));
  const correct = () => (world.goal === 0 ? -1 : 1);
  const remember = () => past.push(ways());
  const count = () => ways().filter((way) => way === correct()).length;
  const reset = (boosts = 0) => {
    Q = M.drift(M.optimum(M.world(9, state.gamma)), 0);
    world = M.world(0, state.gamma);
    past = [];
    remember();
    boost(boosts);
  };
  const boost = (times) => {
    for (let k = 0; k < times; k += 1) {
      Q = M.boost(world, Q, state.target, state.loss, state.alpha);
      remember();
    }
  };

  // The stage is built once; drawing only moves and names what is there
  const cells = (row, make) => Array.from({ length: M.ROOMS }, (_, s) => make(
    live.element(row, "div", { class: "cell" }), s));
  const row = (kind, label) => {
    const node = live.element(stage, "div", { class: `row ${kind}` });
    live.element(node, "div", { class: "head" }, label);
    return node;
  };
  const names = cells(row("names", ""), (cell) => cell);
  const values = row("bars", "0"), floor = live.element(values.firstChild, "span");
  const bars = cells(values, (cell) => [0, 1].map((a) => {
    const lane = live.element(cell, "div", { class: "lane" });
    live.element(lane, "div", { class: "tag" }, "←→"[a]);
    return ["q", "rest"].map((kind) => live.element(lane, "div", { class: kind }));
  }));
  const lines = Array.from({ length: SHOWN }, () => {
    const node = row("past", "");
    return { head: node.firstChild, cells: cells(node, (cell) => cell) };
  });
  names.forEach((cell, s) => cell.addEventListener("click", () => pick(s)));
  bars.forEach((lanes, s) => lanes[0][0].parentNode.parentNode
    .addEventListener("click", () => pick(s)));
  const pick = (s) => { state.set("room", s); state.show(); };

  const draw = () => {
    const g = M.residual(world, Q), deepest = (1 - state.gamma ** 11) / (1 - state.gamma);
    const height = (x) => `${100 * Math.min(x / deepest, 1)}%`;
    floor.textContent = live.number(-deepest, 1);
    names.forEach((cell, s) => {
      cell.textContent = s === world.goal ? "goal" : s;
      cell.classList.toggle("goal", s === world.goal);
      cell.classList.toggle("picked", s === state.room);
    });
    bars.forEach((lanes, s) => lanes.forEach(([q, rest], a) => {
      const ended = s === world.goal, value = ended ? 0 : -Q[s][a];
      const target = ended ? 0 : -(Q[s][a] + g[s][a]);
      q.style.height = height(value);
      rest.style.top = height(Math.min(value, target));
      rest.style.height = height(Math.abs(target - value));
      rest.style.visibility = Math.abs(target - value) > M.TIE ? "visible" : "hidden";
      q.parentNode.style.visibility = ended ? "hidden" : "visible";
    }));
    const first = Math.max(0, past.length - SHOWN);
    lines.forEach((line, k) => {
      const then = past[first + k];
      line.head.textContent = then ? first + k : "";
      line.cells.forEach((cell, s) => {
        const way = then ? then[s] : null;
        cell.textContent = way === null ? "" : "←=→"[way + 1];
        cell.className = `cell${way === null ? "" : way === correct() ? " right" : " wrong"}`;
      });
    });
    root.querySelector("[data-room]").textContent = about(state.room, g);
  };

  const about = (s, g) => {
    if (s === world.goal) return `Room ${s} is the goal: the episode ends there.`;
    const n = live.number, best = M.optimum(world)[s];
    const next = M.boost(world, Q, state.target, state.loss, state.alpha)[s];
    return [0, 1].map((a) => `${a ? "Right" : "Left"}: Q\u00a0${n(Q[s][a])}, residual\u00a0${n(g[s][a])}, `
      + `next\u00a0h\u00a0${n((next[a] - Q[s][a]) / state.alpha)}, Q*\u00a0${n(best[a])}`).join("\n");
  };

  const words = () => {
    const g = M.residual(world, Q), boosts = past.length - 1;
    const rooms = Q.map((_, s) => s).filter((s) => s !== world.goal);
    const left = rooms.filter((s) => Math.max(...g[s].map(Math.abs)) > M.TIE);
    const best = M.optimum(world);
    const hidden = rooms.filter((s) => !left.includes(s)
      && Math.max(...Q[s].map((x, a) => Math.abs(x - best[s][a]))) > M.TIE);
    const where = (list) => `room${list.length > 1 ? "s" : ""} ${live.list(list)}`;
    return `The goal moved to room ${world.goal}. After ${boosts} boost${boosts === 1 ? "" : "s"}, `
      + `${count()} of 9 rooms go the right way. `
      + (left.length ? `There is a residual in ${where(left)}.` : "No residual is left.")
      + (hidden.length ? ` In ${where(hidden)} it is 0, and Q is wrong.` : "");
  };

  return {
    draw, words,
    spoken: (key) => (key === "room"
      ? `${state.room}. ${about(state.room, M.residual(world, Q))}` : undefined),
    text: (key, value) => (key === "room" ? String(value) : live.number(value, key === "alpha" ? 1 : 2)),
    changed: (key) => {
      if (key === null) reset(5); // how the figure opens
      if (key === "gamma") reset();
    },
    press: {
      one: () => boost(1),
      ten: () => boost(10),
      drift: () => {
        world = M.world(9 - world.goal, state.gamma);
        Q = M.drift(Q, world.goal);
        past = [];
        remember();
      },
      reset: () => reset(),
    },
    answer: () => {
      [["target", "live"], ["loss", "h"], ["alpha", 1]].forEach(([key, value]) => state.set(key, value));
      reset(1);
      return { right: String(count()), why: `It is ${count()}: the booster’s target contains the `
        + "booster, so its only fixed point is the new Q*. Now fit h with α below 1." };
    },
  };
});
