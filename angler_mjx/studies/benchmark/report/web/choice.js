// What is chosen: it stands in the address behind #, and everything is drawn from it.

const data = JSON.parse(document.getElementById("data").textContent);
const rows = data.rows, names = data.planners;
// Success, or whether all robots were planned for while nothing has been flown.
const hit = rows[data.judged], JUDGED = data.judged === "success" ? "succeeds" : "plans for all robots";
const at = (id) => document.getElementById(id);
const COSTS = { planning_s: ["planned", "Planning time"], makespan_s: ["success", "Makespan flown"], energy_j: ["success", "Energy flown"], flowtime_s: ["success", "Flowtime flown"] };
const state = { planners: names.map((_, i) => i), scene: -1, team: -1, information: -1, first: 0, second: Math.min(1, names.length - 1), example: 0, drawn: "", sort: "", down: false };

function readState() {
  const given = new URLSearchParams(location.hash.slice(1));
  const index = (key, list, none) => (given.has(key) ? list.map(String).indexOf(given.get(key)) : none);
  state.scene = index("scene", data.scenes, -1);
  state.team = index("team", data.teams, -1);
  state.information = index("information", data.knowledge, -1);
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
  if (state.information >= 0) said.set("information", data.knowledge[state.information]);
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

const keepsScene = (scene, team, information) => (state.scene < 0 || scene === state.scene) && (state.team < 0 || team === data.teams[state.team]) && (state.information < 0 || information === state.information);
const kept = (i) => keepsScene(rows.scene[i], rows.team[i], rows.information[i]);
const scenes = () => (state.scene < 0 ? data.scenes.map((_, i) => i) : [state.scene]);
const teams = () => (state.team < 0 ? data.teams : [data.teams[state.team]]);

// Runs that count, successes, and how many of them were given up, by planner and a key of rows.
function tally(key, keep) {
  const found = new Map();
  for (let i = 0; i < rows.planner.length; i++) {
    if (!keep(i)) continue;
    const name = `${rows.planner[i]} ${key(i)}`;
    let one = found.get(name);
    if (!one) found.set(name, (one = { runs: 0, success: 0, closed: 0 }));
    if (!rows.counted[i]) continue;
    one.runs++;
    one.success += hit[i];
    one.closed += !rows.asked[i];
  }
  return found;
}

function point(at, planner, one, what) {
  const interval = wilson(one.success, one.runs), rate = one.success / one.runs;
  const closed = one.closed ? `; ${one.closed} of them given up` : "";
  return { at, rate, interval, hollow: one.runs < data.few, words: `${names[planner]}, ${what}: ${percent(rate)} (${between(interval)}) of ${one.runs} runs${closed}` };
}

// The planner with the highest rate, and those that paired intervals do not tell from it.
function winner(keep) {
  const total = tally(() => "", keep), of = (p) => total.get(`${p} `);
  const all = state.planners.filter((p) => of(p)?.runs);
  if (!all.length) return { all };
  const best = all.reduce((a, b) => (of(b).success * of(a).runs > of(a).success * of(b).runs ? b : a));
  const held = byProblem(rows, best, keep), alike = [];
  if (of(best).success) {
    for (const other of all) {
      if (other === best) continue;
      if (newcombe(...counts(hit, held, byProblem(rows, other, keep)))[0] <= 0) alike.push(other);
    }
  }
  return { best, one: of(best), alike, all };
}
