// The page: everything drawn, and drawn again at every choice.

function draw() {
  for (const id of ["scene", "team", "information", "first", "second", "example"]) at(id) && (at(id).value = state[id]);
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
  at("description").textContent = `${(about.description || "").replace(/[^.!?]$/, "$&.")} ${count(names.length, "planner")}, ${count(data.scenes.length, "scene")}, ${count(data.totals.problems, "problem")}, ${count(data.totals.runs, "run")}.`.trim();
  if (about.complete === false) {
    const pending = data.pending && data.judged === "success" ? ` Planned and not flown yet: ${count(data.pending, "run")}; rates count them as failed.` : "";
    at("state").textContent = `These results are not complete.${pending}`;
    at("state").hidden = false;
  }
  if (data.judged === "planned") for (const id of ["team-title", "density-title"]) at(id).textContent = at(id).textContent.replace("Success", "Share planned");
  document.querySelectorAll(".few").forEach((node) => (node.textContent = data.few));
  options("scene", data.scenes, "all");
  options("team", data.teams, "all");
  options("information", data.knowledge, "all");
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
  for (const id of ["scene", "team", "information", "first", "second", "example"]) {
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
