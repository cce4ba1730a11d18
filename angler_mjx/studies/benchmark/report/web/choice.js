// What is chosen: it stands in the address behind #, and everything is drawn from it.

const data = JSON.parse(document.getElementById("data").textContent);
const names = data.planners;
// Success, or whether all robots were planned for while nothing has been flown.
const JUDGED = data.judged === "success" ? "succeeds" : "plans for all robots";
const at = (id) => document.getElementById(id);
const COSTS = { planning_s: "Planning time", makespan_s: "Makespan flown", energy_j: "Energy flown", flowtime_s: "Flowtime flown" };
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
const scenes = () => (state.scene < 0 ? data.scenes.map((_, i) => i) : [state.scene]);
const teams = () => (state.team < 0 ? data.teams : [data.teams[state.team]]);

// Statistics are computed beforehand; a choice of scene, team and information selects them.
const NOTHING = { rates: [], ranking: [], bins: {}, profiles: {}, pairs: {} };

function selected(scene, team, information) {
  const index = (chosen, list) => (list.length > 1 ? chosen : -1);
  return data.selections[`${index(scene, data.scenes)} ${index(team, data.teams)} ${index(information, data.knowledge)}`] || NOTHING;
}

const chosen = () => selected(state.scene, state.team, state.information);
const rateOf = ([rate, low, high, runs, closed]) => ({ rate, interval: [low, high], runs, closed });

// Two planners on the same problems, or null without a common one. A pair is stored once.
function pairOf(selection, a, b) {
  const stored = selection.pairs[a < b ? `${a} ${b}` : `${b} ${a}`];
  if (!stored) return null;
  const [both, first, second, neither, difference, low, high, p, ...ratios] = stored, turned = a > b;
  const ratio = (held) => {
    if (!held) return null;
    const [median, least, most, pairs] = held;
    return turned ? { median: 1 / median, low: 1 / most, high: 1 / least, pairs } : { median, low: least, high: most, pairs };
  };
  return {
    both, neither, p, first: turned ? second : first, second: turned ? first : second, ratios: ratios.map(ratio),
    difference: turned ? -difference : difference, interval: turned ? [-high, -low] : [low, high],
  };
}

function point(at, planner, one, what) {
  const closed = one.closed ? `; ${one.closed} of them given up` : "";
  return { at, rate: one.rate, interval: one.interval, hollow: one.runs < data.few, words: `${names[planner]}, ${what}: ${percent(one.rate)} (${between(one.interval)}) of ${count(one.runs, "run")}${closed}` };
}

// The planner with the highest rate, and those that paired intervals do not tell from it.
function winner(selection) {
  const all = selection.ranking.filter((p) => state.planners.includes(p));
  if (!all.length) return { all };
  const [best, ...others] = all, one = rateOf(selection.rates[best]);
  const apart = (other) => pairOf(selection, best, other)?.interval[0] > 0;
  return { best, one, all, alike: one.rate ? others.filter((other) => !apart(other)).sort((a, b) => a - b) : [] };
}
