// Who wins where, in words and as a table, and two planners against each other.

function listed(planners, most = 3) {
  const first = planners.slice(0, most).map((p) => names[p]).join(", ");
  return planners.length > most ? `${first} and ${planners.length - most} more` : first;
}

function drawAnswer() {
  const list = at("answer"), some = selected(-1, -1, -1).rates.some((rates) => rates && rates[0] > 0);
  list.replaceChildren();
  const say = (strong, rest) => list.append(html("li", {}, html("b", {}, strong), rest));
  const won = winner(chosen());
  if (data.judged === "planned") say("Nothing has been flown yet", ": shares are of problems that were planned for every robot.");
  if (won.best !== undefined && some) {
    const { one } = won, alike = won.alike.length ? `; not told apart from it by paired comparison: ${listed(won.alike, 5)}` : won.all.length > 1 ? "; ahead of every other planner" : "";
    say(names[won.best], ` ${JUDGED} most often: ${percent(one.rate)} (${between(one.interval)}) of ${count(one.runs, "run")}${alike}.`);
  } else say("No run has succeeded", ".");
  for (const [cost, words] of [["planning_s", "plans fastest"], ["makespan_s", "arrives soonest"], ["energy_j", "needs least energy"]]) {
    const found = chosen().profiles[cost], lines = linesOf(found);
    if (lines.length < 2 || !found.problems) continue;
    const [planner, best] = lines.reduce((a, b) => (b[1] > a[1] ? b : a)), unknown = found.left_out.filter((p) => state.planners.includes(p));
    say(names[planner], ` ${words} most often: best on ${percent(best / found.problems)} of ${count(found.problems, "common problem")}.${unknown.length ? ` Nothing known of ${listed(unknown, 4)}.` : ""}`);
  }
}

function drawWinners() {
  const columns = teams(), table = html("table"), head = html("tr", {}, html("th", { class: "text" }, "scene"));
  if (columns.length > 1) head.append(html("th", { class: "text" }, "all teams"));
  for (const team of columns) head.append(html("th", { class: "text" }, count(team, "robot")));
  table.append(html("thead", {}, head));
  const body = html("tbody");
  for (const scene of scenes()) {
    const row = html("tr", {}, html("th", { class: "text", scope: "row" }, data.scenes[scene]));
    for (const team of columns.length > 1 ? [null, ...columns] : columns) {
      const won = winner(selected(scene, team === null ? -1 : data.teams.indexOf(team), state.information));
      const cell = html("td");
      if (won.best === undefined) cell.append("–");
      else if (!won.one.rate) cell.append("none", html("small", {}, `${count(won.one.runs, "run")} each`));
      else {
        const { one } = won, { rate } = one;
        const clear = won.alike.length === 0 || 2 * won.alike.length < won.all.length - 1;
        cell.style.background = `rgba(var(--good), ${(0.06 + 0.3 * rate).toFixed(2)})`;
        cell.append(html("b", {}, clear ? names[won.best] : "no clear winner"), `${clear ? "" : `${names[won.best]} `}${percent(rate)}${one.runs < data.few ? " *" : ""}`);
        if (won.alike.length) cell.append(html("small", {}, `≈ ${listed(won.alike, 2)}`));
      }
      row.append(cell);
    }
    body.append(row);
  }
  table.append(body);
  at("winners").replaceChildren(table);
  at("winners-note").textContent = `${data.judged === "success" ? "Success: every robot has a path and arrives." : "Share of problems planned for every robot."} ≈: Newcombe's paired 95 % interval of the difference holds 0; no clear winner: so for half of the others or more. *: fewer than ${data.few} runs.`;
}

function drawPair() {
  const pair = pairOf(chosen(), state.first, state.second), [x, y] = [names[state.first], names[state.second]];
  const { both, first, second, neither, difference, interval, p, ratios } = pair || { both: 0, first: 0, second: 0, neither: 0, ratios: [] };
  const n = both + first + second + neither, points = (value) => `${value > 0 ? "+" : ""}${(100 * value).toFixed(1)}`;
  const lines = [["problems of both", String(n)], [data.judged === "success" ? "both succeed" : "both plan for all robots", String(both)], [`only ${x}`, String(first)], [`only ${y}`, String(second)], ["neither", String(neither)]];
  if (n) lines.push([`difference of share (${data.judged}), percentage points`, `${points(difference)} (${points(interval[0])} to ${points(interval[1])})`], ["McNemar's exact p", p < 1e-4 ? p.toExponential(1) : p.toFixed(4)]);
  ["planning_s", "makespan_s", "energy_j"].forEach((cost, i) => {
    const found = ratios[i], label = `${COSTS[cost].toLowerCase()}, median ratio first / second`;
    lines.push([label, found ? `${short(found.median)} (${short(found.low)} to ${short(found.high)}), ${count(found.pairs, "problem")}${found.pairs < data.few ? ": too few" : ""}` : "–"]);
  });
  const few = n < data.few ? ` Only ${count(n, "problem")}: too few to say much.` : "";
  at("pair-words").textContent = state.first === state.second ? "Choose two different planners." : n === 0 ? `${x} and ${y} have no problem in common here.` : interval[0] > 0 ? `${x} ${JUDGED} more often than ${y} on the same problems.${few}` : interval[1] < 0 ? `${y} ${JUDGED} more often than ${x} on the same problems.${few}` : `${data.judged === "success" ? "Success" : "Planning"} does not tell ${x} and ${y} apart here.${few}`;
  const body = html("tbody");
  for (const [label, value] of lines) body.append(html("tr", {}, html("th", { class: "text", scope: "row" }, label), html("td", {}, value)));
  at("pair").replaceChildren(...(state.first === state.second ? [] : [html("table", {}, body)]));
}
