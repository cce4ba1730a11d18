// Maps from above: where robots failed, and example scenes.

const THEMED = { "#009e73": "--c2", "#7a4e12": "--c6", "#8a6fb0": "--moving", "#d55e00": "--c1", "#56b4e9": "--c5", "#e69f00": "--c4", "#333333": "--c7" };

function outcome(data, name) {
  const known = data.outcomes[name];
  const themed = known && THEMED[known.color.toLowerCase()];
  return { text: known ? known.text : name.replaceAll("_", " "), color: themed ? `var(${themed})` : known ? known.color : "var(--quiet)" };
}

function legend(entries) {
  const list = html("ul", { class: "legend" });
  for (const [color, text] of entries) list.append(html("li", {}, html("i", { style: `background:${color}` }), text));
  return list;
}

function round(low, high) {
  const step = [1, 2, 5, 10, 20, 50, 100, 200].find((s) => (high - low) / s <= 7) || 500, ticks = [];
  for (let at = Math.ceil(low / step) * step; at <= high; at += step) ticks.push([at, String(at)]);
  return ticks;
}

function ground(title, [x0, y0, x1, y1], label) {
  const width = WIDTH, across = width - MARGIN.left - MARGIN.right, scale = across / (x1 - x0);
  const height = MARGIN.top + MARGIN.bottom + scale * (y1 - y0);
  const x = (at) => MARGIN.left + scale * (at - x0), y = (at) => MARGIN.top + scale * (y1 - at);
  const [figure, drawn] = frame(title, { xlabel: "east, m", ylabel: "north, m", xticks: round(x0, x1), yticks: round(y0, y1), x, y, width, height, label });
  drawn.append(svg("rect", { class: "water", x: x(x0), y: y(y1), width: scale * (x1 - x0), height: scale * (y1 - y0) }));
  return { figure, drawn, x, y, scale };
}

// Dots of one outcome are one path: thousands of them cost nothing.
function failureMap(data, title, picked, bounds) {
  const { figure, drawn, x, y } = ground(title, bounds, `${title}: places of ${count(picked.length, "robot")} that failed`);
  const held = data.failures, paths = new Map();
  for (const i of picked) {
    const name = held.outcomes[held.outcome[i]];
    paths.set(name, `${paths.get(name) || ""}M${x(held.x[i]).toFixed(1)} ${y(held.y[i]).toFixed(1)}h0`);
  }
  for (const [name, d] of paths) {
    drawn.append(svg("path", { d, fill: "none", "stroke-linecap": "round", "stroke-width": picked.length > 400 ? 4 : 6, opacity: 0.6, style: `stroke:${outcome(data, name).color}` }));
  }
  return figure;
}

function line(points, x, y) {
  return points.map(([a, b], i) => `${i ? "L" : "M"}${x(a).toFixed(1)} ${y(b).toFixed(1)}`).join("");
}

function star(x, y, r) {
  const corners = [];
  for (let i = 0; i < 10; i++) {
    const reach = i % 2 ? 0.45 * r : r, angle = (Math.PI * i) / 5;
    corners.push(`${(x + reach * Math.sin(angle)).toFixed(1)},${(y - reach * Math.cos(angle)).toFixed(1)}`);
  }
  return corners.join(" ");
}

function exampleMap(example, way) {
  const [nx, ny] = [example.top.length, example.top[0].length], [ox, oy] = example.origin, cell = example.cell;
  const bounds = [ox, oy, ox + nx * cell, oy + ny * cell];
  const { figure, drawn, x, y, scale } = ground(way.planner, bounds, `${example.title}, planned by ${way.planner}`);
  example.top.forEach((column, i) => column.forEach((top, j) => {
    if (!top) return;
    const shade = 0.45 + (0.55 * top) / example.layers;
    drawn.append(svg("rect", { class: "rock", x: x(ox + i * cell), y: y(oy + (j + 1) * cell), width: cell * scale + 0.3, height: cell * scale + 0.3, opacity: shade.toFixed(2) }));
  }));
  for (const [px, py, radius, moves] of example.obstacles) {
    drawn.append(svg("circle", { cx: x(px), cy: y(py), r: radius * scale, opacity: 0.6, style: `fill:var(${moves ? "--moving" : "--still"})` }));
  }
  way.planned.forEach((planned, r) => {
    const group = svg("g", { class: `s${r % COLORS}` });
    const flown = way.flown[r] || [];
    group.append(svg("title", {}, `robot ${r}: ${way.outcome[r]}`));
    if (planned.length) group.append(svg("path", { class: "planned", d: line(planned, x, y) }));
    if (flown.length) group.append(svg("path", { class: "flown", d: line(flown, x, y) }));
    const [sx, sy] = example.start[r], [gx, gy] = example.goal[r];
    group.append(svg("circle", { class: "dot", cx: x(sx), cy: y(sy), r: 4 }));
    group.append(svg("polygon", { class: "dot", points: star(x(gx), y(gy), 7) }));
    if (flown.length && way.outcome[r] !== "reached") {
      const [ex, ey] = flown[flown.length - 1], [a, b] = [x(ex), y(ey)];
      group.append(svg("path", { d: `M${a - 5} ${b - 5}l10 10m0 -10l-10 10`, style: "stroke:var(--ink);stroke-width:2.4" }));
    }
    drawn.append(group);
  });
  return figure;
}
