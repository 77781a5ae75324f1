// The interactive figure. `data` is described in explorer.py. The address after # contains the state: every choice that is not
// the default. Arrays of numbers are flat: observer i at grid point j is at i * (number of grid points) + j.
const SCENARIO = "scenario", OBSERVER = "observer"; // x axes in addition to those of the study
const INK = "#1b1b1b", SOFT = "#6b6b6b", LINE = "#e4e4e4";
const byId = id => document.getElementById(id);
const finite = v => v !== null && v !== undefined && Number.isFinite(v);
const plural = (n, word) => `${n.toLocaleString("en")} ${word}${n === 1 ? "" : "s"}`;

function make(parent, tag, attributes = {}, text = null) {
  const svg = parent.namespaceURI.endsWith("svg") || tag === "svg";
  const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== null) node.textContent = text;
  parent.append(node);
  return node;
}

function number(v, digits = 4) {
  if (!finite(v)) return "-";
  if (v === 0) return "0";
  const power = Math.floor(Math.log10(Math.abs(v)) + 1e-12);
  if (power >= -4 && power < 6) return String(Number(v.toPrecision(Math.max(digits, power + 1))));
  const raised = [...String(power)].map(c => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("");
  return `${Number((v / 10 ** power).toPrecision(Math.min(digits, 3)))}·10${raised}`;
}

// Markers: polygons with corners on circles of one or two radii, as matplotlib draws them.
const star = (corners, turn, inner = 1, r = 1.15) => Array.from({length: corners}, (_, i) => {
  const angle = Math.PI * (2 * i / corners + turn), q = r * (i % 2 ? inner : 1);
  return `${(q * Math.sin(angle)).toFixed(2)},${(-q * Math.cos(angle)).toFixed(2)}`;
}).join("L");
const CROSS = ["-.4,-1.1L.4,-1.1L.4,-.4L1.1,-.4L1.1,.4L.4,.4L.4,1.1L-.4,1.1L-.4,.4L-1.1,.4L-1.1,-.4L-.4,-.4", 0];
const MARKERS = {
  o: star(24, 0, 1, 1), s: star(4, 0.25, 1, 1.3), "^": star(3, 0, 1, 1.3), v: star(3, 1, 1, 1.3), "<": star(3, -0.5, 1, 1.3),
  ">": star(3, 0.5, 1, 1.3), D: star(4, 0, 1, 1.3), h: star(6, 0), H: star(6, 1 / 6), p: star(5, 0), "*": star(10, 0, 0.45, 1.4), P: CROSS[0], X: CROSS[0],
  8: star(8, 0), d: "0,-1.3L.75,0L0,1.3L-.75,0",
};
function marker(parent, {marker: kind, colour}, x, y, r) {
  const turn = kind === "X" ? " rotate(45)" : "";
  const path = kind === "x" ? "M-1,-1L1,1M-1,1L1,-1" : `M${MARKERS[kind]}z`;
  return make(parent, "path", {d: path, transform: `translate(${x} ${y})${turn} scale(${r})`, fill: kind === "x" ? "none" : colour,
    stroke: colour, "stroke-width": kind === "x" ? 0.5 : 0.1});
}
const dashes = o => o.dash.map(d => d * 1.6).join(" ");

const data = byId("numbers") && JSON.parse(byId("numbers").textContent);
let state, points = [], active = null;

// ---- state ----
const scenario = () => data.scenarios[state.scenario];
const signal = () => scenario().signals[state.signal];
const series = (s = scenario(), g = signal()) => g?.series[state.metric];
const metric = () => data.metrics[state.metric];
const alike = s => s.signals.find(g => g.name === signal().name && g.unit === signal().unit && g.series[state.metric]);
const comparable = () => data.scenarios.filter(alike);
const axisOf = (s, name) => s.axes.findIndex(a => a.name === name);
const indexOf = (list, word, otherwise = 0) => { const i = list.indexOf(word); return i < 0 ? otherwise : i; };

function metrics() { return Object.keys(data.metrics).filter(m => signal().series[m]); }

function axes() {
  const several = comparable().length > 1 && comparable().length <= 40;
  return [...scenario().axes.map(a => a.name), ...(several ? [SCENARIO] : []), OBSERVER];
}

function read() { // the state, from the address
  const params = new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
  state = {hide: new Set((params.get("hide") ?? "").split(",").filter(Boolean)), at: {}};
  state.scenario = indexOf(data.scenarios.map(s => s.title), params.get("scenario"));
  state.signal = indexOf(scenario().signals.map(g => g.name), params.get("signal"), usual());
  choose({metric: params.get("metric"), x: params.get("x"), scale: params.get("scale"), show: params.get("show")});
  for (const a of scenario().axes) if (params.has(a.name)) state.at[a.name] = indexOf(a.words, params.get(a.name));
  draw();
  state.point = params.get("point");
  pick(state.point === null ? undefined : points.find(p => `${p.word} ${p.observer.name}` === state.point));
}

function usual() { return Math.max(0, scenario().signals.findIndex(g => g.series[data.metric])); }

function choose(changes) { // what is not possible falls back to the default
  Object.assign(state, changes);
  if (!signal()) state.signal = usual();
  if (!metrics().includes(state.metric)) state.metric = metrics().includes(data.metric) ? data.metric : metrics()[0];
  if (!axes().includes(state.x)) state.x = axes().length > 2 || comparable().length <= 12 ? axes()[0] : OBSERVER;
  if (!["log", "linear"].includes(state.scale)) state.scale = null;
  if (state.show !== "ratio" || !series().best) state.show = "value";
}

function write() { // the address, from the state
  const params = new URLSearchParams(), put = (name, value, usual) => { if (value && value !== usual) params.set(name, value); };
  put("scenario", scenario().title, data.scenarios[0].title);
  put("signal", signal().name, scenario().signals[usual()].name);
  put("metric", state.metric, data.metric);
  put("x", state.x, axes()[0]);
  put("show", state.show, "value");
  put("scale", state.scale, null);
  put("hide", [...state.hide].join(","), "");
  for (const a of hidden()) if (state.at[a.name]) params.set(a.name, a.words[state.at[a.name]]);
  put("point", state.point, null);
  history.replaceState(null, "", `#${params.toString() || "explore"}`);
}

function change(changes) {
  state.point = null;
  choose(changes);
  draw();
  write();
}

const hidden = () => data.alone ? [] : scenario().axes.filter(a => a.name !== state.x && a.words.length > 1);

// ---- points ----
function cellAt(s, x, i) { // the number of the grid point of a scenario with value i of axis x
  const wanted = s.axes.map(a => a.name === x ? i : indexOf(a.words, hereWord(a.name)));
  return s.cells.findIndex(cell => cell.every((v, k) => v === wanted[k]));
}
function hereWord(name) { const a = scenario().axes[axisOf(scenario(), name)]; return a && a.words[state.at[name] ?? 0]; }

function point(s, g, i, cell, x, word) { // an observer (its place in the scenario) at a grid point
  const r = g.series[state.metric], many = s.cells.length, k = i * many + cell;
  const at = name => Array.isArray(r[name]) ? r[name][k] : r[name];
  const best = r.best ? r.best[cell] : -1, least = best < 0 ? null : r.mean[best * many + cell];
  const p = {observer: data.observers[s.observers[i]], x, word, s, cell, value: at("mean"), low: at("low"), high: at("high"), n: at("n"),
    lost: s.lost ? s.lost[k] : 0, unit: r.unit, best: best < 0 ? null : data.observers[s.observers[best]], isBest: best === i,
    verdict: at("verdict"), p: at("p"), half: at("half"), band: r.band_low ? [at("band_low"), at("band_high")] : null};
  p.ratio = finite(least) && least > 0 && finite(p.value) ? p.value / least : null;
  [p.y, p.from, p.to] = state.show === "value" ? [p.value, p.low, p.high]
    : [p.ratio, ...(finite(p.half) && p.ratio ? [p.ratio * Math.exp(-p.half), p.ratio * Math.exp(p.half)] : [null, null])];
  return p;
}

function collect() { // all points of the figure, and the categories or values of its x axis
  const s = scenario(), out = [], add = (t, g, cell, x, word) => {
    if (cell < 0) return;
    t.observers.forEach((o, i) => { if (!state.hide.has(data.observers[o].name)) out.push(point(t, g, i, cell, x, word)); });
  };
  let words;
  if (state.x === SCENARIO) {
    words = comparable().map(t => t.title);
    comparable().forEach((t, x) => add(t, alike(t), cellAt(t, null, 0), x, t.title));
  } else if (state.x === OBSERVER) {
    add(s, signal(), cellAt(s, null, 0), 0, "");
    out.forEach((p, x) => { p.x = x; p.word = p.observer.name; });
    words = out.map(p => p.word);
  } else {
    const a = s.axes[axisOf(s, state.x)];
    words = a.words;
    words.forEach((word, i) => add(s, signal(), cellAt(s, state.x, i), a.values ? a.values[i] : i, word));
  }
  return [out.filter(p => p.value !== undefined && (finite(p.value) || p.n !== null)), words];
}

// ---- scales ----
function ticks(low, high, log) {
  const out = [];
  if (log && high / low > 3) {
    const steps = high / low > 1e3 ? [1] : high / low > 30 ? [1, 3] : high / low > 10 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 7];
    const each = Math.ceil(Math.log10(high / low) / 6);
    for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); e++)
      for (const step of steps) if (e % each === 0 && step * 10 ** e >= low && step * 10 ** e <= high) out.push(step * 10 ** e);
    return out;
  }
  const raw = (high - low) / 5, ten = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 2.5, 5, 10].find(m => m * ten >= raw) * ten;
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) out.push(Number((i * step).toPrecision(6)));
  return out;
}

function scaleOf(values, log, from, to, margin = 0.05) {
  const known = values.filter(v => finite(v) && (!log || v > 0)), f = log ? Math.log10 : v => v;
  let high = known.length ? Math.max(...known) : 1, low = known.length ? Math.min(...known) : log ? 0.1 : 0;
  if (log) low = Math.max(low, high / 1e12);
  else if (low > 0 && low < 2 * (high - low)) low = 0;
  const room = (f(high) - f(low)) * margin || (log ? 0.1 : Math.abs(high) / 2 || 1);
  const [a, b] = [f(low) - (low === 0 && !log ? 0 : room), f(high) + room];
  const place = v => from + (f(v) - a) / (b - a) * (to - from);
  return {place, low: log ? 10 ** a : a, high: log ? 10 ** b : b, log};
}

const title = () => metric().title.replace("{}", signal().name);
function valueLabel() {
  if (state.show === "ratio") return `${title()}, divided by that of the best [-]`;
  const unit = points[0]?.unit ?? series().unit;
  return `${title()} [${unit === "1" || unit === "" ? "-" : unit}]`;
}
function folded(text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines[lines.length - 1]} ${word}`.trim();
    if (widthOf(longer) > width && lines[lines.length - 1]) lines.push(word); else lines[lines.length - 1] = longer;
  }
  return lines;
}

// ---- the figure ----
function draw() {
  const svg = byId("plot"), width = Math.max(280, byId("figure").clientWidth), [all, words] = collect();
  points = all;
  const positive = points.every(p => !finite(p.y) || p.y > 0), signed = points.some(p => p.y < 0);
  const rate = state.show === "value" && (metric().expected !== null && points.every(p => !p.band) || /_rate$/.test(state.metric));
  const log = state.scale ? state.scale === "log" && !signed : positive && !rate;
  const shown = points.filter(p => finite(p.y) && (!log || p.y > 0));
  const axis = scenario().axes[axisOf(scenario(), state.x)], numeric = Boolean(axis && axis.values);
  const expected = state.show === "ratio" ? 1 : metric().expected;
  const ends = shown.flatMap(p => [p.y, p.from, p.to, ...(state.show === "value" && p.band || [])]);
  const drawn = {svg, width, words, axis, shown, log, expected, ends: expected === null ? ends : [...ends, expected]};
  svg.replaceChildren();
  const height = numeric ? lines(drawn) : rows(drawn);
  for (const [name, value] of Object.entries({width, height, viewBox: `0 0 ${width} ${height}`})) svg.setAttribute(name, value);
  svg.setAttribute("aria-label", `${valueLabel()} over ${axis ? axis.label : state.x}. Move the point with the arrow keys.`);
  controls(log);
  sync();
  notes(log);
  pick();
}

const pen = document.createElement("canvas").getContext("2d");
function widthOf(words) { pen.font = getComputedStyle(byId("plot")).font; return pen.measureText(words).width; } // in pixels

function text(parent, x, y, words, anchor = "start", colour = INK) {
  return make(parent, "text", {x, y, "text-anchor": anchor, fill: colour}, words);
}

function heading({svg, width}, over = "") {
  const parts = folded(valueLabel() + over, width - 8);
  parts.forEach((line, i) => text(svg, 2, 14 + 16 * i, line));
  return 16 * parts.length + 12;
}

function lines(d) { // over an axis of numbers: a line per observer
  const {svg, width} = d, top = heading(d), height = Math.round(Math.min(460, Math.max(300, width * 0.45))), bottom = height - 40;
  const y = scaleOf(d.ends, d.log, bottom, top), marks = ticks(y.low, y.high, d.log);
  const left = 10 + Math.max(...marks.map(v => widthOf(number(v))), 7), right = width - 14;
  const x = scaleOf(d.axis.values, d.axis.log, left + 8, right - 8, 0.0001);
  for (const v of marks) {
    make(svg, "line", {x1: left, x2: right, y1: y.place(v), y2: y.place(v), stroke: LINE});
    text(svg, left - 5, y.place(v) + 4, number(v), "end");
  }
  let free = -Infinity;
  d.words.map((word, i) => [d.axis.values[i], word]).sort((a, b) => a[0] - b[0]).forEach(([v, word]) => {
    const half = widthOf(word) / 2 + 4, at = Math.min(x.place(v), width - half);
    make(svg, "line", {x1: x.place(v), x2: x.place(v), y1: bottom, y2: bottom + 4, stroke: SOFT});
    if (at - half > free) { text(svg, at, bottom + 17, word, "middle"); free = at + half; }
  });
  make(svg, "line", {x1: left, x2: right, y1: bottom, y2: bottom, stroke: SOFT});
  text(svg, (left + right) / 2, bottom + 34, d.axis.label, "middle");
  if (d.expected !== null) make(svg, "line", {x1: left, x2: right, y1: y.place(d.expected), y2: y.place(d.expected), stroke: SOFT, "stroke-dasharray": "4 3"});
  let after = Math.min(new Set(d.shown.map(p => p.observer)).size, 8) - 1; // the first line is the widest: none hides another
  for (const o of data.observers) {
    const mine = d.shown.filter(p => p.observer === o).sort((a, b) => a.x - b.x);
    const group = make(svg, "g", {class: "series", "data-observer": o.name});
    for (const p of mine) [p.px, p.py] = [x.place(p.x), y.place(p.y)];
    if (mine.length > 1) make(group, "polyline", {points: mine.map(p => `${p.px},${p.py}`).join(" "), fill: "none", stroke: o.colour, "stroke-width": 1.3 + 0.3 * Math.max(after--, 0), "stroke-dasharray": dashes(o)});
    for (const p of mine) bar(group, p, v => [p.px, y.place(v)], d.log);
    for (const p of mine) marker(group, o, p.px, p.py, 3.6);
  }
  d.svg.dataset.layout = "lines";
  return height;
}

function rows(d) { // over words: a row per observer of each word
  const {svg, width} = d, single = state.x === OBSERVER, longest = Math.max(...d.words.map(widthOf), 7) + 12;
  const above = longest > 0.4 * width, left = above ? 8 : longest, right = width - 14, step = single ? 20 : 11;
  let y = heading(d, d.axis ? ` over ${d.axis.label}` : "") + 6;
  const top = y - 8, x = scaleOf(d.ends, d.log, left + 6, right - 10), body = make(svg, "g");
  for (const [i, word] of d.words.entries()) {
    const mine = points.filter(p => single ? p.word === word : p.x === i);
    if (above) { text(svg, left, y + 5, word); y += 18; }
    else text(svg, left - 8, y + (mine.length - 1) * step / 2 + 4, word, "end");
    for (const p of mine) {
      if (d.shown.includes(p)) {
        [p.px, p.py] = [x.place(p.y), y];
        const group = make(svg, "g", {class: "series", "data-observer": p.observer.name});
        bar(group, p, v => [x.place(v), p.py], d.log);
        marker(group, p.observer, p.px, p.py, 3.6);
      }
      y += step;
    }
    if (!single) make(body, "line", {x1: above ? left : 0, x2: right, y1: y, y2: y, stroke: LINE});
    y += single ? 0 : 10;
  }
  const bottom = y;
  let free = -Infinity;
  for (const v of ticks(x.low, x.high, d.log)) {
    const half = widthOf(number(v)) / 2 + 4, at = Math.min(x.place(v), width - half);
    make(body, "line", {x1: x.place(v), x2: x.place(v), y1: top, y2: bottom, stroke: LINE});
    if (at - half > free) { text(svg, at, bottom + 16, number(v), "middle"); free = at + half; }
  }
  if (d.expected !== null) make(body, "line", {x1: x.place(d.expected), x2: x.place(d.expected), y1: top, y2: bottom, stroke: SOFT, "stroke-dasharray": "4 3"});
  make(body, "line", {x1: left, x2: right, y1: bottom, y2: bottom, stroke: SOFT});
  d.svg.dataset.layout = "rows";
  return bottom + 26;
}

function bar(group, p, place, log) { // the interval of a point, and the band of a consistent filter
  const line = (low, high, look) => {
    if (!finite(low) || !finite(high) || log && low <= 0) return;
    const [[x1, y1], [x2, y2]] = [place(low), place(high)];
    make(group, "line", {x1, y1, x2, y2, ...look});
  };
  if (p.band && state.show === "value") line(...p.band, {stroke: "#bbbbbb", "stroke-width": 7, "stroke-opacity": 0.5});
  line(p.from, p.to, {stroke: p.observer.colour, "stroke-width": 1.4, class: "interval"});
}

// ---- words ----
const exact = p => p.n === 0 && !p.lost;  // not: all runs diverged
const losses = p => p.lost ? `${p.lost.toLocaleString("en")} of ${plural(p.n + p.lost, "run")}` : "";
const range = (low, high) => {
  const [a, b] = [number(low, 3), number(high, 3)];
  return finite(low) && finite(high) && a !== b ? ` (${a} to ${b})` : "";
};
// The value of an axis with its unit, that of each channel with its own; words have none, and a unit in words is left out.
const withUnit = (word, unit) => !unit || unit.includes(" ") || (/^[a-z]|, /.test(word) && !word.includes(": ")) ? word : `${word.replaceAll(", ", ` ${unit}, `)} ${unit}`;
const unitOf = p => p.unit === "1" || !p.unit ? "" : ` ${p.unit}`;
function valueOf(p) { return finite(p.value) ? `${number(p.value)}${range(p.low, p.high)}${unitOf(p)}` : "no value"; }
function ratioOf(p) {
  if (p.isBest || !p.ratio) return p.isBest ? "1" : "-";
  return `${number(p.ratio, p.ratio < 1.1 ? 4 : 3)}${finite(p.half) ? range(p.ratio * Math.exp(-p.half), p.ratio * Math.exp(p.half)) : ""}`;
}
function verdict(p) { // significance, or consistency
  if (p.band && finite(p.value) && finite(p.band[0])) return p.value > p.band[1] ? "optimistic" : p.value < p.band[0] ? "pessimistic" : "consistent";
  if (/^coverage/.test(state.metric) && finite(p.low)) return p.high < metric().expected ? "optimistic" : p.low > metric().expected ? "pessimistic" : "consistent";
  if (!p.best) return "";
  if (p.isBest) return "best";
  if (p.verdict === 2) return "diverges significantly more often";
  const size = finite(p.p) ? p.p < 0.001 ? ", p < 0.001" : `, p = ${number(p.p, 2)}` : "";
  if (p.verdict === 1) return size ? `significantly worse${size}` : exact(p) ? "worse (exact)" : "worse (no noise)";
  return size ? `not significantly worse${size}` : (p.ratio ? Math.abs(p.ratio - 1) < 1e-9 : p.value === 0) ? "equal" : "not tested";
}

function where(p) { // the grid point in words
  const fixed = p.s.axes.filter(a => a.name === state.x || a.words.length > 1 && !(data.alone && axisOf(p.s, state.x) >= 0));
  fixed.sort((a, b) => (b.name === state.x) - (a.name === state.x));
  return [p.s.title, ...fixed.map(a => a.label.replace(/^(.*?)(?: \[(.*)\])?$/, (_, name, unit) =>
    `${name}${/ of y\d/.test(name) ? ":" : ""} ${withUnit(a.words[p.s.cells[p.cell][axisOf(p.s, a.name)]], unit)}`))].join(", ");
}

function pick(p = points.findLast(q => q.isBest && q.px) ?? points.findLast(q => q.px), tip = false) { // show one point's numbers
  active = p ?? null;
  const table = byId("values"), box = byId("tip"), caption = byId("where");
  table.replaceChildren();
  box.hidden = !(tip && p);
  for (const node of document.querySelectorAll("#plot .series, #ring")) node.id === "ring" ? node.remove() : node.classList.remove("dim");
  if (!p) { caption.textContent = "Nothing to show: choose an observer."; return; }
  if (p.px) make(byId("plot"), "circle", {id: "ring", cx: p.px, cy: p.py, r: 7.5, fill: "none", stroke: INK});
  if (tip) for (const node of document.querySelectorAll("#plot .series")) node.classList.toggle("dim", node.dataset.observer !== p.observer.name);
  const ranks = q => [!q.isBest, q.verdict === 2, finite(q.value) ? q.value : Infinity];
  const here = points.filter(q => q.s === p.s && q.cell === p.cell).sort((a, b) => {
    const [u, v] = [ranks(a), ranks(b)], k = u.findIndex((_, i) => u[i] !== v[i]);
    return k < 0 ? 0 : (metric().ranked || k < 2 ? 1 : 0) * (u[k] - v[k]);
  });
  const compared = here.some(q => q.best), judged = here.some(q => verdict(q)), lost = here.some(q => q.lost);
  const same = here.every(q => q.n === p.n), many = exact(p) ? "exact values" : `${plural(p.n ?? 0, "run")}${here.length > 1 ? " each" : ""}`;
  caption.textContent = [where(p), ...(same ? [many] : [])].join(", ");
  const heads = ["observer", `${state.metric}${here.some(q => range(q.low, q.high)) ? " (95 % interval)" : ""}`, ...(same ? [] : ["runs"]), ...(lost ? ["diverged"] : []), ...(compared ? ["relative to the best"] : []),
    ...(judged ? [compared ? "significance" : "verdict"] : [])];
  const head = make(make(table, "thead"), "tr"), body = make(table, "tbody");
  for (const word of heads) make(head, "th", {scope: "col"}, word);
  for (const q of here) {
    const row = make(body, "tr", q === p ? {class: "active"} : {}), first = make(row, "td");
    make(first, "span", {class: "swatch", style: `background:${q.observer.colour}`});
    make(first, q.isBest || q.best && q.verdict === 0 ? "strong" : "span", {}, q.observer.name);
    const cells = [valueOf(q), ...(same ? [] : [exact(q) ? "exact" : String(q.n ?? 0)]), ...(lost ? [losses(q) || "none"] : []), ...(compared ? [ratioOf(q)] : []),
      ...(judged ? [verdict(q)] : [])];
    for (const [i, word] of cells.entries()) make(row, "td", {"data-of": heads[i + 1]}, word);
  }
  if (tip) showTip(box, p);
}

function showTip(box, p) {
  const runs = exact(p) ? "exact" : plural(p.n ?? 0, "run");
  const comparison = p.best && !p.isBest && p.ratio ? `${ratioOf(p)} times ${p.best.name}; ${verdict(p)}` : verdict(p);
  box.replaceChildren();
  make(box, "strong", {}, p.observer.name);
  for (const line of [where(p), `${valueOf(p)}, ${runs}`, comparison, p.lost && `${losses(p)} diverged`].filter(Boolean)) make(box, "div", {}, line);
  const frame = byId("figure").clientWidth;
  box.style.left = `${Math.max(0, Math.min(p.px + 12, frame - box.offsetWidth))}px`;
  box.style.top = `${p.py + 14}px`;
}

function notes(log) {
  const means = metric().means, out = [means.slice(0, 1).toUpperCase() + means.slice(1)], gone = points.filter(p => !finite(p.y)), zero = log ? points.filter(p => p.y <= 0 && finite(p.y)) : [];
  const everywhere = (list, o) => points.every(p => p.observer !== o || list.includes(p));
  const names = list => [...new Set(list.map(p => `${p.observer.name}${everywhere(list, p.observer) ? "" : ` at ${p.word}`}`))].join(", ");
  if (points.some(p => finite(p.low) && p.high > p.low)) out.push("Bars: 95 % intervals.");
  if (points.some(p => p.band)) out.push("Gray: 95 % of the means of a true covariance. Above it a filter is optimistic, below it pessimistic.");
  if (gone.length) out.push(`Not drawn, because no run has a value: ${names(gone)}.`);
  if (zero.length) out.push(`Not drawn, because the error is 0: ${names(zero)}. Choose the linear scale.`);
  if (points.some(p => p.lost)) out.push("Means are over the runs that did not diverge.");
  if (points.some(p => finite(p.p))) out.push("p: paired t-test with Holm's correction over all grid points and pairs; intervals are not corrected. Bold: the best, and observers that are not significantly worse.");
  if (series().best && state.hide.size) out.push("The best is that of all observers, also of those that are not shown.");
  byId("notes").textContent = out.filter(Boolean).map(part => part.replace(/[^.]$/, "$&.")).join(" ");
}

// ---- controls ----
function select(parent, label, options, chosen, changed, name) {
  if (options.length < 2) return;
  const box = make(make(parent, "label", {}, label), "select", {name});
  for (const [value, word, about] of options) {
    const group = about && ([...box.children].find(g => g.label === about) ?? make(box, "optgroup", {label: about}));
    make(group || box, "option", value === chosen ? {value, selected: ""} : {value}, word);
  }
  box.addEventListener("change", () => { changed(box.value); byId("controls").querySelector(`[name="${name}"]`)?.focus(); });
}

function controls(log) {
  const box = byId("controls"), s = scenario(), same = list => list.map(v => [v, v]);
  box.replaceChildren();
  if (state.x !== SCENARIO || comparable().length < data.scenarios.length) select(box, "scenario", same(data.scenarios.map(t => t.title)), s.title, v => change({scenario: data.scenarios.findIndex(t => t.title === v), signal: -1}), "scenario");
  select(box, "signal", same(s.signals.map(g => g.name)), signal().name, v => change({signal: s.signals.findIndex(g => g.name === v)}), "signal");
  select(box, "metric", metrics().map(m => [m, m, data.metrics[m].about]), state.metric, v => change({metric: v}), "metric");
  const label = name => s.axes.find(a => a.name === name)?.label ?? name;
  select(box, "over", axes().map(a => [a, label(a)]), state.x, v => change({x: v}), "x");
  for (const a of hidden()) select(box, a.label, same(a.words), a.words[state.at[a.name] ?? 0], v => { state.at[a.name] = a.words.indexOf(v); change({}); }, a.name);
  if (series().best) select(box, "show", [["value", "values"], ["ratio", "relative to the best"]], state.show, v => change({show: v}), "show");
  select(box, "scale", [["log", "logarithmic"], ["linear", "linear"]], log ? "log" : "linear", v => change({scale: v}), "scale");
}

function checks() {
  const box = byId("observers");
  for (const o of data.observers) {
    const label = make(box, "label"), input = make(label, "input", {type: "checkbox", name: o.name});
    const key = make(label, "svg", {width: 34, height: 14, viewBox: "0 0 34 14", "aria-hidden": "true", class: "key"});
    make(key, "line", {x1: 1, x2: 33, y1: 7, y2: 7, stroke: o.colour, "stroke-width": 1.7, "stroke-dasharray": dashes(o)});
    marker(key, o, 17, 7, 3.6);
    label.append(o.name);
    input.addEventListener("change", () => { input.checked ? state.hide.delete(o.name) : state.hide.add(o.name); change({}); });
  }
}
function sync() { // boxes of the observers, as the state says
  for (const input of document.querySelectorAll("#observers input")) {
  input.checked = !state.hide.has(input.name);
  input.parentNode.hidden = state.x !== SCENARIO && !scenario().observers.some(o => data.observers[o].name === input.name);
} }

// ---- pointer and keys ----
function nearest(event) {
  const frame = byId("plot").getBoundingClientRect(), [x, y] = [event.clientX - frame.x, event.clientY - frame.y];
  const far = p => Math.hypot(p.px - x, (p.py - y) * (byId("plot").dataset.layout === "rows" ? 4 : 1));
  return points.filter(p => p.px).reduce((best, p) => !best || far(p) < far(best) ? p : best, null);
}

function keep(p) { // an explicit choice of a point is in the address
  pick(p, true);
  state.point = `${p.word} ${p.observer.name}`;
  write();
}

function moved(key) { // the point to which an arrow leads
  const drawn = points.filter(p => p.px), by = ["ArrowRight", "ArrowDown"].includes(key) ? 1 : -1;
  if (!drawn.length) return null;
  if (byId("plot").dataset.layout === "rows") {
    const i = drawn.indexOf(active);
    return key === "Home" ? drawn[0] : key === "End" ? drawn[drawn.length - 1] : drawn[Math.min(Math.max(i + by, 0), drawn.length - 1)];
  }
  const along = ["ArrowLeft", "ArrowRight", "Home", "End"].includes(key);
  const line = drawn.filter(p => along ? p.observer === active.observer : p.x === active.x);
  line.sort((a, b) => along ? a.x - b.x : a.py - b.py);
  const i = line.indexOf(active);
  return key === "Home" ? line[0] : key === "End" ? line[line.length - 1] : line[Math.min(Math.max(i + by, 0), line.length - 1)];
}

function start() {
  const svg = byId("plot");
  byId("explore").hidden = false;
  for (const link of document.querySelectorAll(".scripted")) link.hidden = false;
  checks();
  svg.addEventListener("pointermove", event => { const p = nearest(event); if (p) pick(p, true); });
  svg.addEventListener("pointerdown", event => { const p = nearest(event); if (p) keep(p); });
  svg.addEventListener("pointerleave", () => pick(active ?? undefined));
  svg.addEventListener("blur", () => pick(active ?? undefined));
  svg.addEventListener("keydown", event => {
    if (event.key === "Escape") { pick(active ?? undefined); return; }
    if (!/^(Arrow(Left|Right|Up|Down)|Home|End)$/.test(event.key) || !active) return;
    event.preventDefault();
    const p = moved(event.key);
    if (p) keep(p);
  });
  byId("reset").addEventListener("click", () => { history.replaceState(null, "", "#explore"); read(); });
  addEventListener("hashchange", () => { if (location.hash.includes("=")) read(); });
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; const at = state.point; draw(); state.point = at; } });
  read();
  if (location.hash.includes("=")) byId("explore").scrollIntoView();
}
if (data) start();
