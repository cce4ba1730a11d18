// Charts and maps of what is chosen.

function series(selections, words) {
  return state.planners.map((planner) => ({
    planner,
    points: selections.flatMap((rates, i) => (rates?.[planner] ? [point(i, planner, rateOf(rates[planner]), words[i])] : [])),
  }));
}

function drawRates() {
  const shown = teams(), ofTeam = (scene) => shown.map((team) => selected(scene, data.teams.indexOf(team), state.information).rates);
  at("by-team").replaceChildren(...scenes().map((scene) => ratesChart(data.scenes[scene], "robots", shown.map(String), series(ofTeam(scene), shown.map((team) => count(team, "robot"))))));
  const { bins } = chosen(), numbers = Object.keys(bins).filter((bin) => state.planners.some((p) => bins[bin][p]));
  const centres = numbers.map((bin) => `${(100 * data.centres[bin]).toFixed(1)} %`);
  at("by-density").replaceChildren(ratesChart(state.scene < 0 ? "All scenes" : data.scenes[state.scene], "share of cells that are rock", centres, series(numbers.map((bin) => bins[bin]), centres.map((text) => `density ${text}`))));
}

const linesOf = (found) => (found?.lines || []).filter(([planner]) => state.planners.includes(planner));

function drawProfiles() {
  at("profiles").replaceChildren(...Object.entries(COSTS).map(([cost, title]) => {
    const found = chosen().profiles[cost], lines = linesOf(found);
    if (!lines.length) return html("p", { class: "note" }, `${title}: no problem here is common to all planners and has a known cost.`);
    const figure = profileChart(`${title}: ${count(found.problems, "common problem")}`, found, lines), unknown = found.left_out.filter((p) => state.planners.includes(p));
    if (unknown.length) figure.append(html("p", { class: "note" }, `Nothing known of: ${listed(unknown, 14)}.`));
    return figure;
  }));
}

function drawFailures() {
  const held = data.failures, planners = new Set(state.planners), seen = new Set();
  const limits = data.scenes.map(() => [Infinity, Infinity, -Infinity, -Infinity]);
  const picked = data.scenes.map(() => []);
  held.cell.forEach((index, i) => {
    const cell = data.cells[index], { scene } = cell, box = limits[scene];
    box[0] = Math.min(box[0], held.x[i]); box[1] = Math.min(box[1], held.y[i]);
    box[2] = Math.max(box[2], held.x[i]); box[3] = Math.max(box[3], held.y[i]);
    if (!planners.has(cell.planner) || !keepsScene(scene, cell.team, cell.information)) return;
    picked[scene].push(i);
    seen.add(held.outcomes[held.outcome[i]]);
  });
  const panels = scenes().filter((s) => picked[s].length).map((s) => {
    const [x0, y0, x1, y1] = limits[s], half = Math.max(x1 - x0, y1 - y0, 2) * 0.53, x = (x0 + x1) / 2, y = (y0 + y1) / 2;
    return failureMap(data, `${data.scenes[s]}: ${picked[s].length}`, picked[s], [x - half, y - half, x + half, y + half]);
  });
  at("failures").replaceChildren(...panels);
  const note = at("failure-note"), every = held.every > 1 ? ` One in ${held.every} of ${held.total} failures is kept in this page.` : "";
  note.replaceChildren(legend([...seen].sort().map((name) => [outcome(data, name).color, outcome(data, name).text])), panels.length ? `Centres of robots when they failed, from above.${every}` : "No failure in flight is known here.");
}

function drawExample() {
  const box = at("examples"), example = data.examples[state.example];
  if (!example) {
    box.replaceChildren(html("p", { class: "note" }, "No example was kept with these results."));
    return;
  }
  const { paths } = example, select = at("example-planner");
  select.replaceChildren(html("option", { value: "" }, "the first four chosen"), ...paths.map((way) => html("option", { value: way.planner }, way.planner)));
  select.value = paths.some((way) => way.planner === state.drawn) ? state.drawn : "";
  const chosen = new Set(state.planners.map((p) => names[p]));
  const shown = select.value ? paths.filter((way) => way.planner === select.value) : paths.filter((way) => chosen.has(way.planner)).slice(0, 4);
  const how = (way) => {
    const arrived = way.outcome.filter((o) => o === "reached").length;
    return way.flown.some((f) => f.length) ? `${arrived} of ${count(way.outcome.length, "robot")} arrived` : `not flown; a path for ${way.planned.filter((p) => p.length).length} of ${count(way.planned.length, "robot")}`;
  };
  at("example-map").replaceChildren(...shown.map((way) => {
    const figure = exampleMap(example, way);
    figure.append(html("p", { class: "note" }, how(way)));
    return figure;
  }), html("p", { class: "note" }, "Disc: start. Star: goal. Dashed: planned. Thick: flown. Cross: failure. Stronger rock is higher; violet obstacles move, drawn where they begin."));
}
