// Charts and maps of what is chosen.

function drawRates() {
  const ticks = teams(), byTeam = tally((i) => `${rows.scene[i]} ${rows.team[i]}`, kept);
  at("by-team").replaceChildren(...scenes().map((scene) => ratesChart(data.scenes[scene], "robots", ticks.map(String), state.planners.map((planner) => ({
    planner,
    points: ticks.flatMap((team, i) => {
      const one = byTeam.get(`${planner} ${scene} ${team}`);
      return one && one.runs ? [point(i, planner, one, `${team} robots`)] : [];
    }),
  })))));
  const byBin = tally((i) => rows.bin[i], kept), { centres } = data.bins;
  const bins = centres.map((c, i) => i).filter((i) => state.planners.some((p) => byBin.has(`${p} ${i}`)));
  at("by-density").replaceChildren(ratesChart(state.scene < 0 ? "All scenes" : data.scenes[state.scene], "share of cells that are rock", bins.map((i) => `${(100 * centres[i]).toFixed(1)} %`), state.planners.map((planner) => ({
    planner,
    points: bins.flatMap((bin, i) => {
      const one = byBin.get(`${planner} ${bin}`);
      return one && one.runs ? [point(i, planner, one, `density ${(100 * centres[bin]).toFixed(1)} %`)] : [];
    }),
  }))));
}

function drawProfiles() {
  at("profiles").replaceChildren(...Object.entries(COSTS).map(([cost, [needs, title]]) => {
    const found = profile(rows, state.planners, cost, needs, kept);
    if (!found.problems) return html("p", { class: "note" }, `${title}: no problem here is common to all chosen planners and has a known cost.`);
    const figure = profileChart(`${title}: ${found.problems} common problems`, found, names);
    if (found.leftOut.length) figure.append(html("p", { class: "note" }, `Nothing known of: ${listed(found.leftOut, 14)}.`));
    return figure;
  }));
}

function drawFailures() {
  const held = data.failures, chosen = new Set(state.planners), seen = new Set();
  const limits = data.scenes.map(() => [Infinity, Infinity, -Infinity, -Infinity]);
  const picked = data.scenes.map(() => []);
  held.row.forEach((row, i) => {
    const scene = rows.scene[row], box = limits[scene];
    box[0] = Math.min(box[0], held.x[i]); box[1] = Math.min(box[1], held.y[i]);
    box[2] = Math.max(box[2], held.x[i]); box[3] = Math.max(box[3], held.y[i]);
    if (!chosen.has(rows.planner[row]) || !kept(row)) return;
    picked[scene].push(i);
    seen.add(held.outcomes[held.outcome[i]]);
  });
  const panels = scenes().filter((s) => picked[s].length).map((s) => {
    const [x0, y0, x1, y1] = limits[s], half = Math.max(x1 - x0, y1 - y0, 2) * 0.53, x = (x0 + x1) / 2, y = (y0 + y1) / 2;
    return failureMap(data, `${data.scenes[s]}: ${picked[s].length}`, picked[s], [x - half, y - half, x + half, y + half]);
  });
  at("failures").replaceChildren(...panels);
  const note = at("failure-note"), every = held.every > 1 ? ` Every ${held.every}th of ${held.total} failures is kept in this page.` : "";
  note.replaceChildren(legend([...seen].sort().map((name) => [outcome(data, name).color, outcome(data, name).text])), panels.length ? `Centres of robots when they failed, from above.${every}` : "No failure in flight is known here.");
}

function drawExample() {
  const box = at("examples"), example = data.examples[state.example];
  if (!example) {
    box.replaceChildren(html("p", { class: "note" }, "No example was kept with these results."));
    return;
  }
  const ways = example.ways, select = at("example-planner");
  select.replaceChildren(html("option", { value: "" }, "the first four chosen"), ...ways.map((way) => html("option", { value: way.planner }, way.planner)));
  select.value = ways.some((way) => way.planner === state.drawn) ? state.drawn : "";
  const chosen = new Set(state.planners.map((p) => names[p]));
  const shown = select.value ? ways.filter((way) => way.planner === select.value) : ways.filter((way) => chosen.has(way.planner)).slice(0, 4);
  const how = (way) => {
    const arrived = way.outcome.filter((o) => o === "reached").length;
    return way.flown.some((f) => f.length) ? `${arrived} of ${way.outcome.length} robots arrived` : `not flown; ${way.planned.filter((p) => p.length).length} of ${way.planned.length} robots have a path`;
  };
  at("example-map").replaceChildren(...shown.map((way) => {
    const figure = exampleMap(example, way);
    figure.append(html("p", { class: "note" }, how(way)));
    return figure;
  }), html("p", { class: "note" }, "Disc: start. Star: goal. Dashed: planned. Thick: flown. Cross: failure. Stronger rock is higher; violet obstacles move, drawn where they begin."));
}
