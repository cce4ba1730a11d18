// Intervals, paired comparisons and profiles, as the report's Python modules have them.

const Z = 1.959963984540054;

function wilson(count, total) {
  if (total <= 0) return [0, 1];
  const share = count / total, scale = 1 + Z * Z / total;
  const centre = (share + Z * Z / (2 * total)) / scale;
  const half = Z * Math.sqrt(share * (1 - share) / total + Z * Z / (4 * total * total)) / scale;
  return [Math.max(0, centre - half), Math.min(1, centre + half)];
}

function newcombe(both, first, second, neither) {
  const n = both + first + second + neither;
  if (n === 0) return [-1, 1];
  const p1 = (both + first) / n, p2 = (both + second) / n;
  const [l1, u1] = wilson(both + first, n), [l2, u2] = wilson(both + second, n);
  const sides = (both + first) * (second + neither) * (both + second) * (first + neither);
  let cross = both * neither - first * second;
  if (cross > 0) cross = Math.max(cross - n / 2, 0);
  const phi = sides ? cross / Math.sqrt(sides) : 0;
  const joined = (x, y) => Math.sqrt(Math.max(x * x - 2 * phi * x * y + y * y, 0));
  return [p1 - p2 - joined(p1 - l1, u2 - p2), p1 - p2 + joined(u1 - p1, p2 - l2)];
}

function mcnemar(first, second) {
  const n = first + second;
  let term = -n * Math.LN2, tail = 0;
  for (let i = 0; i <= Math.min(first, second); i++) {
    tail += Math.exp(term);
    term += Math.log(n - i) - Math.log(i + 1);
  }
  return Math.min(1, 2 * tail);
}

// mulberry32 with a fixed seed, as in paired.py: one interval here and in comparisons.csv.
function generator(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function quantile(sorted, q) {
  const at = (sorted.length - 1) * q, low = Math.floor(at);
  const next = sorted[Math.min(low + 1, sorted.length - 1)];
  return sorted[low] + (at - low) * (next - sorted[low]);
}

function medianRatio(logs, worlds, resamples = 1000) {
  const n = logs.length;
  if (n === 0) return null;
  const order = logs.map((_, i) => i).sort((i, j) => logs[i] - logs[j]);
  const sorted = order.map((i) => logs[i]);
  const number = new Map([...new Set(worlds)].sort((x, y) => x - y).map((w, i) => [w, i]));
  const of = order.map((i) => number.get(worlds[i])), m = number.size;
  const random = generator(1), medians = [], times = new Int32Array(m);
  for (let k = 0; k < resamples; k++) {
    times.fill(0);
    for (let i = 0; i < m; i++) times[Math.floor(random() * m)]++;
    let total = 0;
    for (let i = 0; i < n; i++) total += times[of[i]];
    let seen = 0, low = NaN, i = 0;
    for (; i < n; i++) {
      seen += times[of[i]];
      if (Number.isNaN(low) && seen > Math.floor((total - 1) / 2)) low = sorted[i];
      if (seen > Math.floor(total / 2)) break;
    }
    medians.push((low + sorted[Math.min(i, n - 1)]) / 2);
  }
  medians.sort((x, y) => x - y);
  return {
    median: Math.exp(quantile(sorted, 0.5)),
    low: Math.exp(quantile(medians, 0.025)),
    high: Math.exp(quantile(medians, 0.975)),
    pairs: n,
  };
}

// Rows of one planner by problem; `keep` says which rows count.
function byProblem(rows, planner, keep) {
  const found = new Map();
  for (let i = 0; i < rows.planner.length; i++) {
    if (rows.planner[i] === planner && rows.counted[i] && keep(i)) found.set(rows.problem[i], i);
  }
  return found;
}

function counts(hit, a, b) {
  const found = [0, 0, 0, 0];
  for (const [problem, i] of a) {
    const j = b.get(problem);
    if (j !== undefined) found[(hit[i] ? 0 : 2) + (hit[j] ? 0 : 1)]++;
  }
  return found;
}

function ratioOf(rows, a, b, cost, needs) {
  const logs = [], worlds = [];
  for (const [problem, i] of a) {
    const j = b.get(problem);
    if (j === undefined || !rows[needs][i] || !rows[needs][j]) continue;
    const x = rows[cost][i], y = rows[cost][j];
    if (x > 0 && y > 0) {
      logs.push(Math.log(x / y));
      worlds.push(rows.world[i]);
    }
  }
  return medianRatio(logs, worlds);
}

// Profiles of a cost over the problems that count for all planners with a known cost.
function profile(rows, planners, cost, needs, keep) {
  const asked = planners.map((p) => [p, byProblem(rows, p, keep)]);
  const value = (i) => (rows[needs][i] && rows[cost][i] !== null ? rows[cost][i] : Infinity);
  const known = asked.filter(([, held]) => [...held.values()].some((i) => value(i) < Infinity));
  if (known.length === 0) return { lines: [], problems: 0, leftOut: planners };
  const common = [...known[0][1].keys()].filter((q) => known.every(([, held]) => held.has(q)));
  const lines = known.map(([planner]) => ({ planner, ratios: [] }));
  for (const problem of common) {
    const costs = known.map(([, held]) => value(held.get(problem)));
    const best = Math.min(...costs);
    costs.forEach((x, k) => {
      if (x < Infinity) lines[k].ratios.push(x === best ? 1 : x / best);
    });
  }
  for (const line of lines) line.ratios.sort((x, y) => x - y);
  const shown = new Set(known.map(([p]) => p));
  return { lines, problems: common.length, leftOut: planners.filter((p) => !shown.has(p)) };
}
