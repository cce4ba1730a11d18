// The table of cells, and how it was made.

const MEASURES = { planning_s: "planning\ns", first_s: "first\ns", best_s: "best\ns", makespan_s: "makespan\ns", flowtime_s: "flowtime\ns", energy_j: "energy\nJ", plan_turn_rad: "turn\nrad", min_clearance_m: "clearance\nm", min_separation_m: "separation\nm", density: "density\n", path_ratio: "way /\nstraight", free_lines: "free\nlines" };
const COLUMNS = [
  ["planner", "planner\n", (c) => names[c.planner]], ["scene", "scene\n", (c) => data.scenes[c.scene]], ["preset", "preset\n", (c) => c.preset], ["team", "robots\n", (c) => c.team], ["information", "known of\nobst. / current", (c) => data.knowledge[c.information]],
  ["asked", "asked\n", (c) => c.asked], ["closed", "not\nasked", (c) => c.closed], ["success", "success\n", (c) => c.success], ["interval", "95 %\n", (c) => c.interval[0]], ["planned", "planned\n", (c) => c.planned], ["flown", "flown\n", (c) => c.flown],
  ...data.measures.map((name) => [name, MEASURES[name] || name, (c) => c[name]]),
];
const SHARE = new Set(["success", "planned", "flown"]), TEXT = new Set(["planner", "scene", "preset", "information"]);

function shown(key, value, cell) {
  if (SHARE.has(key)) return cell.asked ? percent(value) + (key === "success" && cell.asked < data.few ? " *" : "") : "–";
  if (key === "interval") return cell.asked ? between(cell.interval) : "–";
  return typeof value === "number" || value === null ? short(value) : value;
}

function drawCells() {
  const chosen = new Set(state.planners), focused = document.activeElement?.dataset?.key;
  const cells = data.cells.filter((c) => chosen.has(c.planner) && keepsScene(c.scene, c.team, c.information));
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
  const { about } = data, list = at("made"), { runs, asked, closed, no_room } = data.totals;
  const say = (name, text) => text && list.append(html("dt", {}, name), html("dd", {}, text));
  const pairs = (held) => (held && typeof held === "object" ? Object.entries(held).filter(([, v]) => v !== null).map(([k, v]) => `${k} ${typeof v === "object" ? JSON.stringify(v) : v}`).join(", ") : String(held ?? ""));
  say("command", about.command);
  say("created", about.created);
  say("host", pairs(about.host));
  say("versions", pairs(about.versions));
  say("deadline", about.deadline_s && `${about.deadline_s} s a problem`);
  say("runs asked", `${asked} of ${runs}`);
  say("not asked", closed ? `${count(closed, "run")}: their cells were given up after the first ${about.close_after ?? ""} problems all failed. They are taken to fail everywhere but in the table of cells.` : "none");
  if (no_room) say("left out", `${count(no_room, "run")} in worlds that cannot hold the team`);
  const given = data.cells.filter((c) => c.closed).map((c) => `${names[c.planner]} on ${data.scenes[c.scene]} with ${c.team} (${c.closed})`);
  say("cells given up", given.join("; "));
  for (const planner of about.planners || []) say(planner.label, `${planner.name ?? ""} ${JSON.stringify({ ...planner.settings, ...planner.online })}`);
}
