// The page: what is chosen stands in the address behind #, and everything is drawn from it.

const data = JSON.parse(document.getElementById("data").textContent);
const rows = data.rows, names = data.planners;
const at = (id) => document.getElementById(id);
const COSTS = { planning_s: ["planned", "Planning time"], makespan_s: ["success", "Makespan flown"], energy_j: ["success", "Energy flown"], flowtime_s: ["success", "Flowtime flown"] };
const state = { planners: names.map((_, i) => i), scene: -1, team: -1, knows: -1, first: 0, second: Math.min(1, names.length - 1), example: 0, drawn: "", sort: "", down: false };

function readState() {
  const given = new URLSearchParams(location.hash.slice(1));
  const index = (key, list, none) => (given.has(key) ? list.map(String).indexOf(given.get(key)) : none);
  state.scene = index("scene", data.scenes, -1);
  state.team = index("team", data.teams, -1);
  state.knows = index("knows", data.knowledge, -1);
  const chosen = given.has("planners") ? given.getAll("planners").map((n) => names.indexOf(n)).filter((i) => i >= 0) : [];
  state.planners = chosen.length ? [...new Set(chosen)].sort((a, b) => a - b) : names.map((_, i) => i);
  state.first = Math.max(0, index("first", names, 0));
  state.second = Math.max(0, index("second", names, Math.min(1, names.length - 1)));
  state.example = Math.max(0, Math.min(data.examples.length - 1, Number(given.get("example")) || 0));
  state.drawn = given.get("drawn") || "";
  state.sort = given.get("sort") || "";
  state.down = given.get("down") === "1";
}

function writeState() {
  const said = new URLSearchParams();
  if (state.scene >= 0) said.set("scene", data.scenes[state.scene]);
  if (state.team >= 0) said.set("team", data.teams[state.team]);
  if (state.knows >= 0) said.set("knows", data.knowledge[state.knows]);
  if (state.planners.length < names.length) state.planners.forEach((i) => said.append("planners", names[i]));
  said.set("first", names[state.first]);
  said.set("second", names[state.second]);
  if (state.example) said.set("example", state.example);
  if (state.drawn) said.set("drawn", state.drawn);
  if (state.sort) said.set("sort", state.sort);
  if (state.down) said.set("down", "1");
  history.replaceState(null, "", `#${said}`);
}

function options(id, texts, every) {
  if (every) at(id).append(html("option", { value: -1 }, every));
  texts.forEach((text, i) => at(id).append(html("option", { value: i }, String(text))));
}

const keepsScene = (scene, team, knows) => (state.scene < 0 || scene === state.scene) && (state.team < 0 || team === data.teams[state.team]) && (state.knows < 0 || knows === state.knows);
const kept = (i) => keepsScene(rows.scene[i], rows.team[i], rows.knows[i]);
const scenes = () => (state.scene < 0 ? data.scenes.map((_, i) => i) : [state.scene]);
const teams = () => (state.team < 0 ? data.teams : [data.teams[state.team]]);

// Runs asked, solved and left unasked, by planner and a key of rows.
function tally(key, keep) {
  const found = new Map();
  for (let i = 0; i < rows.planner.length; i++) {
    if (!keep(i)) continue;
    const name = `${rows.planner[i]} ${key(i)}`;
    let one = found.get(name);
    if (!one) found.set(name, (one = { asked: 0, success: 0, closed: 0 }));
    if (rows.asked[i]) {
      one.asked++;
      one.success += rows.success[i];
    } else one.closed++;
  }
  return found;
}

function point(at, planner, one, what) {
  const interval = wilson(one.success, one.asked), rate = one.success / one.asked;
  const closed = one.closed ? `; ${one.closed} not asked` : "";
  return { at, rate, interval, hollow: one.asked < data.few || one.closed > 0, words: `${names[planner]}, ${what}: ${percent(rate)} (${between(interval)}) of ${one.asked} runs${closed}` };
}

// The planner with the highest rate, and those that paired intervals do not tell from it.
function winner(keep) {
  const total = tally(() => "", keep), of = (p) => total.get(`${p} `);
  const there = state.planners.filter((p) => of(p));
  const open = there.filter((p) => of(p).closed === 0), shut = there.filter((p) => of(p).closed > 0);
  if (!open.length) return { shut, all: there };
  const best = open.reduce((a, b) => (of(b).success * of(a).asked > of(a).success * of(b).asked ? b : a));
  const held = byProblem(rows, best, keep), alike = [];
  if (of(best).success) {
    for (const other of open) {
      if (other === best) continue;
      if (newcombe(...counts(rows, held, byProblem(rows, other, keep)))[0] <= 0) alike.push(other);
    }
  }
  return { best, one: of(best), alike, shut, all: there };
}

function listed(planners, most = 3) {
  const first = planners.slice(0, most).map((p) => names[p]).join(", ");
  return planners.length > most ? `${first} and ${planners.length - most} more` : first;
}

function drawAnswer() {
  const list = at("answer"), flown = rows.success.some((x) => x);
  list.replaceChildren();
  const say = (strong, rest) => list.append(html("li", {}, html("b", {}, strong), rest));
  const won = winner(kept);
  if (won.best !== undefined && flown) {
    const { one } = won, alike = won.alike.length ? `; not told apart from it by paired comparison: ${listed(won.alike, 5)}` : won.all.length > 1 ? "; ahead of every other planner that was asked everything" : "";
    const shut = won.shut.length ? `. Not ranked, given up in some cells: ${listed(won.shut, 8)}` : "";
    say(names[won.best], ` succeeds most often: ${percent(one.success / one.asked)} (${between(wilson(one.success, one.asked))}) of ${one.asked} runs${alike}${shut}.`);
  } else if (!flown) say("No run has succeeded yet", ": nothing flown, or nothing arrived.");
  else say("No planner was asked everything", " chosen here: all were given up in some cells. See the scenes below.");
  for (const [cost, words] of [["planning_s", "plans fastest"], ["makespan_s", "arrives soonest"], ["energy_j", "needs least energy"]]) {
    const found = profile(rows, state.planners, cost, COSTS[cost][0], kept);
    if (found.lines.length < 2 || !found.problems) continue;
    const best = (line) => line.ratios.filter((r) => r === 1).length;
    const first = found.lines.reduce((a, b) => (best(b) > best(a) ? b : a));
    say(names[first.planner], ` ${words} most often: best on ${percent(best(first) / found.problems)} of ${found.problems} problems that all were asked.${found.leftOut.length ? ` Nothing known of ${listed(found.leftOut, 4)}.` : ""}`);
  }
}

function drawWinners() {
  const columns = teams(), table = html("table"), head = html("tr", {}, html("th", { class: "text" }, "scene"));
  if (columns.length > 1) head.append(html("th", { class: "text" }, "all teams"));
  for (const team of columns) head.append(html("th", { class: "text" }, `${team} robot${team === 1 ? "" : "s"}`));
  table.append(html("thead", {}, head));
  const body = html("tbody");
  for (const scene of scenes()) {
    const row = html("tr", {}, html("th", { class: "text", scope: "row" }, data.scenes[scene]));
    for (const team of columns.length > 1 ? [null, ...columns] : columns) {
      const won = winner((i) => kept(i) && rows.scene[i] === scene && (team === null || rows.team[i] === team));
      const cell = html("td");
      if (won.best === undefined) cell.append(won.all.length ? "all given up" : "–");
      else if (!won.one.success) cell.append("none succeeds", html("small", {}, `${won.one.asked} runs each`));
      else {
        const { one } = won, rate = one.success / one.asked, open = won.all.length - won.shut.length;
        const clear = won.alike.length === 0 || 2 * won.alike.length < open - 1;
        cell.style.background = `rgba(var(--good), ${(0.06 + 0.3 * rate).toFixed(2)})`;
        cell.append(html("b", {}, clear ? names[won.best] : "no clear winner"), `${clear ? "" : `${names[won.best]} `}${percent(rate)}${one.asked < data.few ? " *" : ""}`);
        if (won.alike.length) cell.append(html("small", {}, `≈ ${listed(won.alike, 2)}`));
      }
      row.append(cell);
    }
    body.append(row);
  }
  table.append(body);
  at("winners").replaceChildren(table);
  at("winners-note").textContent = `Success: every robot has a path and arrives. ≈: Newcombe's paired 95 % interval of the difference holds 0; no clear winner: so for half of the others or more. Planners given up in a cell are not ranked in it. *: fewer than ${data.few} runs.`;
}

function drawRates() {
  const ticks = teams(), byTeam = tally((i) => `${rows.scene[i]} ${rows.team[i]}`, kept);
  at("by-team").replaceChildren(...scenes().map((scene) => ratesChart(data.scenes[scene], "robots", ticks.map(String), state.planners.map((planner) => ({
    planner,
    points: ticks.flatMap((team, i) => {
      const one = byTeam.get(`${planner} ${scene} ${team}`);
      return one && one.asked ? [point(i, planner, one, `${team} robots`)] : [];
    }),
  })))));
  const byBin = tally((i) => rows.bin[i], kept), { centres } = data.bins;
  const bins = centres.map((c, i) => i).filter((i) => state.planners.some((p) => byBin.has(`${p} ${i}`)));
  at("by-density").replaceChildren(ratesChart(state.scene < 0 ? "All scenes" : data.scenes[state.scene], "share of cells that are rock", bins.map((i) => `${(100 * centres[i]).toFixed(1)} %`), state.planners.map((planner) => ({
    planner,
    points: bins.flatMap((bin, i) => {
      const one = byBin.get(`${planner} ${bin}`);
      return one && one.asked ? [point(i, planner, one, `density ${(100 * centres[bin]).toFixed(1)} %`)] : [];
    }),
  }))));
}

function drawProfiles() {
  at("profiles").replaceChildren(...Object.entries(COSTS).map(([cost, [needs, title]]) => {
    const found = profile(rows, state.planners, cost, needs, kept);
    const figure = profileChart(`${title}: ${found.problems} common problems`, found, names);
    if (found.leftOut.length) figure.append(html("p", { class: "note" }, `Nothing known of: ${listed(found.leftOut, 14)}.`));
    return figure;
  }));
}

function drawPair() {
  const [a, b] = [state.first, state.second].map((p) => byProblem(rows, p, kept));
  const [both, first, second, neither] = counts(rows, a, b), n = both + first + second + neither;
  const difference = (first - second) / n, interval = newcombe(both, first, second, neither);
  const points = (x) => `${x > 0 ? "+" : ""}${(100 * x).toFixed(1)}`, p = mcnemar(first, second);
  const lines = [["problems both were asked", String(n)], ["both succeed", String(both)], [`only ${names[state.first]}`, String(first)], [`only ${names[state.second]}`, String(second)], ["neither", String(neither)]];
  if (n) lines.push(["difference of success, percentage points", `${points(difference)} (${points(interval[0])} to ${points(interval[1])})`], ["McNemar's exact p", p < 1e-4 ? p.toExponential(1) : p.toFixed(4)]);
  for (const [cost, needs] of Object.entries({ planning_s: "planned", makespan_s: "success", energy_j: "success" })) {
    const found = ratioOf(rows, a, b, cost, needs), label = `${COSTS[cost][1].toLowerCase()}, median ratio first / second`;
    lines.push([label, found ? `${short(found.median)} (${short(found.low)} to ${short(found.high)}), ${found.pairs} problems${found.pairs < data.few ? ": too few" : ""}` : "–"]);
  }
  const few = n < data.few ? ` Only ${n} problems: too few to say much.` : "";
  const [x, y] = [names[state.first], names[state.second]];
  at("pair-words").textContent = state.first === state.second ? "Choose two different planners." : n === 0 ? `${x} and ${y} were asked no problem in common here.` : interval[0] > 0 ? `${x} succeeds more often than ${y} on the same problems.${few}` : interval[1] < 0 ? `${y} succeeds more often than ${x} on the same problems.${few}` : `Success does not tell ${x} and ${y} apart here.${few}`;
  const body = html("tbody");
  for (const [label, value] of lines) body.append(html("tr", {}, html("th", { class: "text", scope: "row" }, label), html("td", {}, value)));
  at("pair").replaceChildren(html("table", {}, body));
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

const MEASURES = { planning_s: "planning\ns", first_s: "first\ns", best_s: "best\ns", makespan_s: "makespan\ns", flowtime_s: "flowtime\ns", energy_j: "energy\nJ", plan_turn_rad: "turn\nrad", min_clearance_m: "clearance\nm", min_separation_m: "separation\nm", density: "density\n", path_ratio: "way /\nstraight", free_lines: "free\nlines" };
const COLUMNS = [
  ["planner", "planner\n", (c) => names[c.planner]], ["scene", "scene\n", (c) => data.scenes[c.scene]], ["preset", "preset\n", (c) => c.preset], ["team", "robots\n", (c) => c.team], ["knows", "known of\nobst. / current", (c) => data.knowledge[c.knows]],
  ["asked", "asked\n", (c) => c.asked], ["closed", "not\nasked", (c) => c.closed], ["success", "success\n", (c) => c.success / c.asked], ["interval", "95 %\n", (c) => wilson(c.success, c.asked)[0]], ["planned", "planned\n", (c) => c.planned / c.asked], ["flown", "flown\n", (c) => c.flown / c.asked],
  ...data.measures.map((name) => [name, MEASURES[name] || name, (c) => c[name]]),
];
const SHARE = new Set(["success", "planned", "flown"]), TEXT = new Set(["planner", "scene", "preset", "knows"]);

function shown(key, value, cell) {
  if (SHARE.has(key)) return cell.asked ? percent(value) + (key === "success" && cell.asked < data.few ? " *" : "") : "–";
  if (key === "interval") return cell.asked ? between(wilson(cell.success, cell.asked)) : "–";
  return typeof value === "number" || value === null ? short(value) : value;
}

function drawCells() {
  const chosen = new Set(state.planners), focused = document.activeElement?.dataset?.key;
  const cells = data.cells.filter((c) => chosen.has(c.planner) && keepsScene(c.scene, c.team, c.knows));
  const [key, , value] = COLUMNS.find(([k]) => k === state.sort) || [];
  if (key) {
    const absent = (v) => v === null || Number.isNaN(v);
    cells.sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      if (absent(x) || absent(y)) return absent(x) - absent(y);
      return (x < y ? -1 : x > y ? 1 : 0) * (state.down ? -1 : 1);
    });
  }
  const head = html("tr");
  for (const [k, label] of COLUMNS) {
    const arrow = k === key ? (state.down ? " ▾" : " ▴") : "", button = html("button", { type: "button", "data-key": k }, label + arrow);
    button.addEventListener("click", () => {
      state.down = state.sort === k ? !state.down : !TEXT.has(k);
      state.sort = k;
      writeState();
      drawCells();
    });
    const sorted = k === key ? { "aria-sort": state.down ? "descending" : "ascending" } : {};
    head.append(html("th", { scope: "col", class: TEXT.has(k) ? "text" : "", ...sorted }, button));
  }
  const body = html("tbody");
  for (const cell of cells) {
    const row = html("tr");
    for (const [k, , get] of COLUMNS) row.append(html("td", { class: TEXT.has(k) ? "text" : "" }, String(shown(k, get(cell), cell))));
    body.append(row);
  }
  at("cells").replaceChildren(html("table", {}, html("thead", {}, head), body));
  if (focused) at("cells").querySelector(`[data-key="${focused}"]`)?.focus();
}

function drawMade() {
  const { about } = data, list = at("made"), asked = rows.asked.reduce((a, b) => a + b, 0), closed = rows.asked.length - asked;
  const say = (name, text) => text && list.append(html("dt", {}, name), html("dd", {}, text));
  const pairs = (held) => (held && typeof held === "object" ? Object.entries(held).map(([k, v]) => `${k} ${typeof v === "object" ? JSON.stringify(v) : v}`).join(", ") : String(held ?? ""));
  say("command", about.command);
  say("created", about.created);
  say("host", pairs(about.host));
  say("versions", pairs(about.versions));
  say("deadline", about.deadline_s && `${about.deadline_s} s a problem`);
  say("runs asked", `${asked} of ${rows.asked.length}`);
  say("not asked", closed ? `${closed} runs: their cells were given up after the first problems all failed. They count in no rate.` : "none");
  const given = data.cells.filter((c) => c.closed).map((c) => `${names[c.planner]} on ${data.scenes[c.scene]} with ${c.team} (${c.closed})`);
  say("cells given up", given.join("; "));
  for (const planner of about.planners || []) say(planner.label, `${planner.name ?? ""} ${JSON.stringify(planner.settings ?? {})}`);
}

function draw() {
  for (const id of ["scene", "team", "knows", "first", "second", "example"]) at(id) && (at(id).value = state[id]);
  document.querySelectorAll("#planners input").forEach((box, i) => (box.checked = state.planners.includes(i)));
  at("chosen").textContent = `(${state.planners.length} of ${names.length})`;
  for (const part of [drawAnswer, drawWinners, drawRates, drawProfiles, drawPair, drawFailures, drawExample, drawCells]) part();
  document.body.dataset.ready = "yes";
}

function light(planner) {
  document.querySelectorAll("svg.chart").forEach((chart) => {
    const lines = [...chart.querySelectorAll(".series")];
    lines.forEach((one) => one.classList.toggle("on", one.dataset.planner === String(planner)));
    chart.classList.toggle("lit", planner !== null && lines.some((one) => one.classList.contains("on")));
  });
}

function begin() {
  const { about } = data;
  at("name").textContent = about.name || "Benchmark";
  at("description").textContent = `${about.description || ""} ${names.length} planner${names.length === 1 ? "" : "s"}, ${data.scenes.length} scene${data.scenes.length === 1 ? "" : "s"}, ${new Set(rows.problem).size} problems, ${rows.asked.length} runs.`.trim();
  if (about.complete === false) {
    at("state").textContent = "These results are not complete.";
    at("state").hidden = false;
  }
  document.querySelectorAll(".few").forEach((node) => (node.textContent = data.few));
  options("scene", data.scenes, "all");
  options("team", data.teams, "all");
  options("knows", data.knowledge, "all");
  options("first", names);
  options("second", names);
  options("example", data.examples.map((one) => one.title));
  names.forEach((name, i) => {
    const box = html("input", { type: "checkbox" }), label = html("label", {}, box, swatch(i), name);
    box.addEventListener("change", () => {
      const chosen = state.planners.includes(i) ? state.planners.filter((p) => p !== i) : [...state.planners, i];
      state.planners = chosen.length ? chosen.sort((a, b) => a - b) : names.map((_, p) => p);
      writeState();
      draw();
    });
    for (const event of ["mouseenter", "focusin"]) label.addEventListener(event, () => light(i));
    for (const event of ["mouseleave", "focusout"]) label.addEventListener(event, () => light(null));
    at("planners").append(label);
  });
  for (const id of ["scene", "team", "knows", "first", "second", "example"]) {
    at(id).addEventListener("change", () => {
      state[id] = Number(at(id).value);
      writeState();
      draw();
    });
  }
  at("example-planner").addEventListener("change", () => {
    state.drawn = at("example-planner").value;
    writeState();
    draw();
  });
  at("everything").addEventListener("click", () => {
    history.replaceState(null, "", "#");
    readState();
    draw();
  });
  if (matchMedia("(max-width: 620px)").matches) at("planner-box").open = false;
  addEventListener("hashchange", () => {
    readState();
    draw();
  });
  readState();
  drawMade();
  draw();
}

begin();
