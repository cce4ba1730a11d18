// Charts in SVG: axes, series with intervals, steps.

const NS = (() => {
  const box = document.createElement("div");
  box.innerHTML = "<svg></svg>";
  return box.firstChild.namespaceURI;
})();
const COLORS = 8, DASHES = ["", "6 4"];

function svg(name, given = {}, ...inside) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(given)) node.setAttribute(key, value);
  node.append(...inside);
  return node;
}

function html(name, given = {}, ...inside) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(given)) node.setAttribute(key, value);
  node.append(...inside);
  return node;
}

const percent = (share) => `${(100 * share).toFixed(share > 0.995 && share < 1 ? 1 : 0)} %`;
const between = ([low, high]) => `${(100 * low).toFixed(0)} to ${(100 * high).toFixed(0)} %`;
const count = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;
const short = (x) => (x === null || x === undefined || Number.isNaN(x) ? "–" : String(Number(x.toPrecision(3))));

// Colours repeat after eight planners: the others have dashes and open squares.
function look(planner) {
  return { color: `s${planner % COLORS}`, dash: DASHES[Math.floor(planner / COLORS) % 2], again: planner >= COLORS };
}

function mark(x, y, planner, hollow) {
  const { again } = look(planner), kind = hollow ? "dot hollow" : "dot";
  if (again) return svg("rect", { class: kind, x: x - 3, y: y - 3, width: 6, height: 6 });
  return svg("circle", { class: kind, cx: x, cy: y, r: 3.3 });
}

function swatch(planner) {
  const { color, dash } = look(planner);
  const drawn = svg("svg", { viewBox: "0 0 34 14", "aria-hidden": "true", class: color });
  drawn.append(svg("path", { class: "way", d: "M1 7H33", "stroke-dasharray": dash }), mark(17, 7, planner, false));
  return drawn;
}

// A frame with axes. x, y map values to places.
function frame(title, { xlabel, ylabel, xticks, yticks, x, y, width, height, label }) {
  const { left, right, top, bottom } = MARGIN;
  const drawn = svg("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
  for (const [value, text] of yticks) {
    drawn.append(svg("line", { class: "grid", x1: left, x2: width - right, y1: y(value), y2: y(value) }));
    drawn.append(svg("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, text));
  }
  for (const [value, text] of xticks) {
    drawn.append(svg("line", { class: "grid", x1: x(value), x2: x(value), y1: top, y2: height - bottom }));
    drawn.append(svg("text", { x: x(value), y: height - bottom + 15, "text-anchor": "middle" }, text));
  }
  drawn.append(svg("path", { class: "axis", d: `M${left} ${top}V${height - bottom}H${width - right}` }));
  drawn.append(svg("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle" }, xlabel));
  drawn.append(svg("text", { x: 0, y: 6, "text-anchor": "start" }, ylabel));
  return [html("figure", {}, html("h3", {}, title), drawn), drawn];
}

const MARGIN = { left: 46, right: 10, top: 18, bottom: 38 };
const SHARES = [0, 0.2, 0.4, 0.6, 0.8, 1].map((s) => [s, `${Math.round(100 * s)} %`]);
const WIDTH = 420, HEIGHT = 270, AXIS = 364;
const up = (share) => MARGIN.top + (1 - share) * (HEIGHT - MARGIN.top - MARGIN.bottom);

// Success over classes that stand side by side. series: [{planner, points: [{at, rate, interval, words, hollow}]}].
function ratesChart(title, xlabel, ticks, series) {
  const span = (WIDTH - MARGIN.left - MARGIN.right) / Math.max(ticks.length, 1);
  const x = (at) => MARGIN.left + span * (at + 0.5);
  const label = `${title}: success over ${xlabel}; the numbers stand in the table of cells`;
  const [figure, drawn] = frame(title, {
    xlabel, ylabel: data.judged, xticks: ticks.map((text, i) => [i, text]), yticks: SHARES, x, y: up, width: WIDTH, height: HEIGHT, label,
  });
  series.forEach(({ planner, points }, k) => {
    const { color, dash } = look(planner);
    const shift = (0.62 * span * (k - (series.length - 1) / 2)) / Math.max(series.length, 3);
    const group = svg("g", { class: `series ${color}`, "data-planner": planner });
    const path = points.map((p, i) => `${i ? "L" : "M"}${(x(p.at) + shift).toFixed(1)} ${up(p.rate).toFixed(1)}`).join("");
    group.append(svg("path", { class: "way", d: path, "stroke-dasharray": dash, opacity: 0.75 }));
    for (const p of points) {
      const at = x(p.at) + shift;
      const point = svg("g", {}, svg("title", {}, p.words));
      point.append(svg("line", { class: "whisker", x1: at, x2: at, y1: up(p.interval[0]), y2: up(p.interval[1]) }));
      point.append(mark(at, up(p.rate), planner, p.hollow));
      group.append(point);
    }
    drawn.append(group);
  });
  return figure;
}

const RATIOS = [1, 1.02, 1.05, 1.1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100, 1000, 1e4];

// Steps of profiles over a logarithmic ratio.
function profileChart(title, found, lines) {
  const most = found.end;
  const across = WIDTH - MARGIN.left - MARGIN.right;
  const x = (ratio) => MARGIN.left + (across * Math.log(ratio)) / Math.log(most);
  let ticks = RATIOS.filter((r) => r <= most * 1.001);
  for (let near = true; near; ) {
    near = false;
    ticks = ticks.filter((r, i) => {
      const crowded = !near && i > 0 && x(r) - x(ticks[i - 1]) < 26;
      near = near || crowded;
      return !crowded;
    });
  }
  const [figure, drawn] = frame(title, {
    xlabel: "cost over that of the best planner", ylabel: "share of problems", xticks: ticks.map((r) => [r, String(r)]),
    yticks: SHARES, x, y: up, width: WIDTH, height: HEIGHT, label: title,
  });
  for (const [planner, best, solved, positions, heights] of lines) {
    const { color, dash } = look(planner), share = (count) => count / found.problems;
    let path = best ? "" : `M${x(1)} ${up(0)}`;
    positions.forEach((position, i) => {
      const at = MARGIN.left + (across * position) / AXIS, height = up(share(heights[i])).toFixed(1);
      path += path ? `H${at.toFixed(1)}V${height}` : `M${x(1)} ${height}`;
    });
    const group = svg("g", { class: `series ${color}`, "data-planner": planner });
    group.append(svg("title", {}, `${names[planner]}: best on ${percent(share(best))}, solves ${percent(share(solved))}`));
    group.append(svg("path", { class: "way", d: `${path}H${WIDTH - MARGIN.right}`, "stroke-dasharray": dash }));
    drawn.append(group);
  }
  return figure;
}
