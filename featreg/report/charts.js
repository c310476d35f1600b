// Charts as SVG. A method has one colour, one dash and one marker throughout the page, so that none of them is
// needed to tell it from another; the numbers stand under each chart.

const DASHES = ["", "7 4", "2 4", "10 4 2 4", "1 0", "4 2", "12 3", "2 2"];
const MARKERS = [
  "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z", "M-4 -4H4V4H-4Z", "M0 -5L5 4H-5Z", "M0 -5L5 0L0 5L-5 0Z",
  "M0 5L5 -4H-5Z", "M-5 -1.5H-1.5V-5H1.5V-1.5H5V1.5H1.5V5H-1.5V1.5H-5Z", "M-4.5 -3L0 0L-4.5 3M4.5 -3L0 0L4.5 3", "M-5 -5L5 5M-5 5L5 -5",
];
const kindOf = (name) => Math.max(0, study.methods.indexOf(name));
// There are eight colours: the ninth method has the first one's, with another dash and another marker.
const dashOf = (k) => DASHES[(k + (k >> 3)) % 8];
const marker = (k, x, y, extra = {}) =>
  shape("path", { class: `mark c${k % 8}`, d: MARKERS[(k + 3 * (k >> 3)) % 8], transform: `translate(${x} ${y})`, ...extra });

/** The marker of a method in running text. */
const swatch = (k) =>
  shape("svg", { class: "swatch", viewBox: "-13 -6 26 12", "aria-hidden": "true" },
    shape("path", { class: `line c${k % 8}`, d: "M-13 0H13", "stroke-dasharray": dashOf(k) }), marker(k, 0, 0));

/** What tells a method from the others: of a sweep its own values, without the names of the parts. */
function shortName(name) {
  const common = (word) => study.methods.length > 1 && study.methods.every((other) => other.split(" ").includes(word));
  const own = name.split(" ").filter((word) => !common(word)).join(" ") || name;
  const bare = own.replace(/(^| )[\w-]+\.(?=[\w-]+=)/g, "$1");
  const short = own.length > 20 ? bare : own;
  return short.length > 24 ? `${short.slice(0, 11)}…${short.slice(-12)}` : short;
}

const legend = (names) =>
  el("ul", { class: "legend" }, ...names.map((name) => el("li", {}, swatch(kindOf(name)), name)));

/** Round values from low to high, about `count` of them. */
function ticks(low, high, count = 5) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough * 0.999);
  const found = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) found.push(Number(v.toPrecision(12)));
  return found;
}

/** 1, 2 and 5 of each power of ten from low to high. */
function logTicks(low, high) {
  const found = [];
  for (let p = Math.floor(Math.log10(low)); p <= Math.ceil(Math.log10(high)); p++)
    for (const f of [1, 2, 5]) if (f * 10 ** p >= low * 0.999 && f * 10 ** p <= high * 1.001) found.push(f * 10 ** p);
  const decades = found.filter((v) => Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-9);
  return decades.length >= 3 && found.length > 8 ? decades : found;
}

const W = 560, H = 340, LEFT = 62, RIGHT = 16, TOP = 12, BOTTOM = 44;

/** Axes with a scale for each: {x, y} map values to places in the drawing. */
function axes(root, { xs, ys, xlog = false, ylog = false, xtitle, ytitle }) {
  const scale = (range, log, from, to) => {
    const f = log ? Math.log : (v) => v;
    const [a, b] = [f(range[0]), f(range[1])];
    return (v) => from + ((f(v) - a) / (b - a || 1)) * (to - from);
  };
  const x = scale(xs, xlog, LEFT, W - RIGHT), y = scale(ys, ylog, H - BOTTOM, TOP);
  for (const v of (ylog ? logTicks : ticks)(...ys))
    root.append(shape("path", { class: "grid", d: `M${LEFT} ${y(v)}H${W - RIGHT}` }),
      shape("text", { class: "tickmark", x: LEFT - 8, y: y(v) + 4, "text-anchor": "end" }, number(v)));
  for (const v of (xlog ? logTicks : ticks)(...xs))
    root.append(shape("path", { class: "grid", d: `M${x(v)} ${TOP}V${H - BOTTOM}` }),
      shape("text", { class: "tickmark", x: x(v), y: H - BOTTOM + 18, "text-anchor": "middle" }, number(v)));
  root.append(
    shape("path", { class: "axis", d: `M${LEFT} ${TOP}V${H - BOTTOM}H${W - RIGHT}` }),
    shape("text", { class: "title", x: (LEFT + W - RIGHT) / 2, y: H - 6, "text-anchor": "middle" }, xtitle),
    shape("text", { class: "title", transform: `translate(15 ${(TOP + H - BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle" }, ytitle),
  );
  return { x, y };
}

const drawing = (label, width = W, height = H) =>
  shape("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });

/** A chart in a frame with its title. */
const figure = (title, note, ...parts) =>
  el("figure", { class: "card" }, el("figcaption", {}, el("h3", {}, title), note ? el("p", { class: "note" }, note) : null), ...parts);

function curveChart() {
  const names = study.methods.filter((name) => study.curves[name]);
  if (!names.length) return null;
  const root = drawing(`Mean matching accuracy of ${names.join(", ")}`);
  const count = study.curves[names[0]].length;
  const { x, y } = axes(root, { xs: [1, Math.max(2, count)], ys: [0, 1], xtitle: "distance from the truth within, px", ytitle: "share of matches" });
  for (const name of names) {
    const k = kindOf(name), line = study.curves[name];
    const group = shape("g", {}, shape("title", {}, name));
    group.append(shape("path", { class: `line c${k % 8}`, "stroke-dasharray": dashOf(k), d: line.map((v, i) => `${i ? "L" : "M"}${x(i + 1)} ${y(v)}`).join("") }));
    line.forEach((v, i) => group.append(marker(k, x(i + 1), y(v))));
    root.append(group);
  }
  const heads = ["method", ...study.curves[names[0]].map((_, i) => `${i + 1} px`)];
  const rows = names.map((name) => [name, ...study.curves[name].map((v) => number(v, 3))]);
  return figure("Mean matching accuracy", "share of the scored matches within a distance, mean over the pairs; a failed run counts as 0",
    root, legend(names), numbers("Mean matching accuracy", heads, rows));
}

const numeric = () => study.table.columns.filter((c) => c.name !== "seed" && study.table.rows.some((row) => typeof row[c.name] === "number"));
const columnOf = (name) => study.table.columns.find((c) => c.name === name);

/** Every run as a point of two metrics, usually accuracy against time. */
function scatterChart() {
  const columns = numeric();
  if (columns.length < 2) return null;
  const pick = (names) => names.find((name) => columns.some((c) => c.name === name));
  const state = { x: pick(["time_s", "act"]) ?? columns[0].name, y: pick(["precision", "ncm", "grid_rmse"]) ?? columns[1].name };
  const holder = el("div");
  const options = columns.map((c) => [c.name, titleOf(c)]);
  const draw = () => {
    const rows = study.table.rows.filter((row) => typeof row[state.x] === "number" && typeof row[state.y] === "number");
    const [cx, cy] = [columnOf(state.x), columnOf(state.y)];
    const label = `${titleOf(cy)} against ${titleOf(cx)} of ${rows.length} runs`;
    const root = drawing(label);
    if (!rows.length) return holder.replaceChildren(el("p", { class: "note" }, "no run has both values"));
    const range = (name) => {
      const values = rows.map((row) => row[name]);
      let [low, high] = [Math.min(...values), Math.max(...values)];
      const log = low > 0 && high / low > 20;
      if (log) return [[low / 1.2, high * 1.2], true];
      if (low >= 0 && high <= 1 && high > 0.6) return [[0, 1.04], false];
      const room = (high - low || Math.abs(high) || 1) * 0.06;
      return [[low >= 0 && low < 0.5 * high ? 0 : low - room, high + room], false];
    };
    const [[xs, xlog], [ys, ylog]] = [range(state.x), range(state.y)];
    const { x, y } = axes(root, { xs, ys, xlog, ylog, xtitle: titleOf(cx) + (xlog ? ", log" : ""), ytitle: titleOf(cy) + (ylog ? ", log" : "") });
    for (const row of rows)
      root.append(marker(kindOf(row.method), x(row[state.x]), y(row[state.y]), row.status === "ok" ? { "fill-opacity": 0.75 } : { "fill-opacity": 0, "stroke-opacity": 0.55 })
        .appendChild(shape("title", {}, `${row.method}, ${row.pair}: ${titleOf(cx)} ${number(row[state.x])}, ${titleOf(cy)} ${number(row[state.y])}, ${row.status ?? ""}`)).parentNode);
    holder.replaceChildren(root);
  };
  draw();
  return figure("Accuracy and time", "one mark for each run; hollow and faint where the result is not trusted",
    el("div", { class: "controls" },
      dropdown("across", options, state.x, (v) => { state.x = v; draw(); }),
      dropdown("up", options, state.y, (v) => { state.y = v; draw(); })),
    holder, legend(study.methods));
}

/** Means and their intervals, method by method. */
function intervalChart() {
  const table = study.table;
  const names = study.methods.filter((name) => table.intervals[name]);
  const columns = table.columns.filter((c) => names.some((name) => typeof table.intervals[name][c.name]?.[0] === "number"));
  if (!names.length || !columns.length) return null;
  const state = { metric: columns.find((c) => c.name === "precision")?.name ?? columns[0].name };
  const holder = el("div");
  const draw = () => {
    const column = columnOf(state.metric), step = 34, left = 150, right = 175, height = names.length * step + 50;
    const all = names.map((name) => table.intervals[name][state.metric] ?? [null, null, null]);
    const values = all.flat().filter((v) => v !== null);
    let [low, high] = [Math.min(...values), Math.max(...values)];
    const room = (high - low || Math.abs(high) || 1) * 0.08;
    [low, high] = [low >= 0 && low - room < 0 ? 0 : low - room, high + room];
    const root = drawing(`${titleOf(column)}: mean of each method with its interval`, W, height);
    const x = (v) => left + ((v - low) / (high - low)) * (W - left - right);
    for (const v of ticks(low, high, 4))
      root.append(shape("path", { class: "grid", d: `M${x(v)} 8V${height - 40}` }), shape("text", { class: "tickmark", x: x(v), y: height - 22, "text-anchor": "middle" }, number(v)));
    root.append(shape("text", { class: "title", x: (left + W - right) / 2, y: height - 5, "text-anchor": "middle" },
      titleOf(column) + (column.better ? `, ${column.better === "high" ? "more" : "less"} is better` : "")));
    names.forEach((name, i) => {
      const [mean, from, to] = all[i], y = 24 + i * step, k = kindOf(name);
      root.append(shape("text", { class: "label", x: left - 14, y: y + 4, "text-anchor": "end" }, shortName(name), shape("title", {}, name)));
      if (mean === null) return root.append(shape("text", { class: "tickmark", x: left, y: y + 4 }, "no value"));
      if (from !== null) root.append(shape("path", { class: `line c${k % 8}`, d: `M${x(from)} ${y}H${x(to)}M${x(from)} ${y - 6}V${y + 6}M${x(to)} ${y - 6}V${y + 6}` }));
      root.append(marker(k, x(mean), y), shape("text", { class: "value", x: W - right + 14, y: y + 4 }, spreadText(all[i])));
    });
    holder.replaceChildren(root);
  };
  draw();
  return figure(`Means and ${Math.round(100 * table.confidence)} % intervals`, "bootstrap over the pairs; no whisker where there are too few to say",
    el("div", { class: "controls" }, dropdown("metric", columns.map((c) => [c.name, titleOf(c)]), state.metric, (v) => { state.metric = v; draw(); })), holder);
}

const spreadText = ([mean, low, high]) =>
  mean === null || mean === undefined ? "–" : low === null || low === undefined ? number(mean, null, 3) : `${number(mean, null, 3)} [${number(low, null, 3)}, ${number(high, null, 3)}]`;

/** Where the time goes: mean seconds of each stage. */
function timeChart() {
  const stages = [...new Set(study.entries.flatMap((entry) => entry.timings.map(([name]) => name)))];
  const rows = study.methods.map((name, k) => {
    const runs = study.entries.filter((entry) => entry.method === k && entry.timings.length);
    return { name, runs: runs.length, of: stages.map((stage) => runs.reduce((sum, run) => sum + (run.timings.find(([s]) => s === stage)?.[1] ?? 0), 0) / (runs.length || 1)) };
  }).filter((row) => row.runs);
  if (!rows.length || !stages.length) return null;
  const step = 38, left = 150, right = 70, height = rows.length * step + 46;
  const longest = Math.max(...rows.map((row) => row.of.reduce((a, b) => a + b, 0))) || 1;
  // As many stages as there are colours; the shortest are drawn together.
  const ranked = stages.map((_, s) => s).sort((a, b) => Math.max(...rows.map((row) => row.of[b])) - Math.max(...rows.map((row) => row.of[a])));
  const own = stages.length > 8 ? ranked.slice(0, 7).sort((a, b) => a - b) : stages.map((_, s) => s);
  const names = own.map((s) => stages[s]).concat(stages.length > 8 ? ["others"] : []);
  const parts = (row) => own.map((s) => row.of[s]).concat(stages.length > 8 ? [row.of.reduce((sum, v, s) => sum + (own.includes(s) ? 0 : v), 0)] : []);
  const root = drawing("Mean time of each method by stage", W, height);
  const x = (v) => left + (v / longest) * (W - left - right);
  for (const v of ticks(0, longest, 4))
    root.append(shape("path", { class: "grid", d: `M${x(v)} 6V${height - 40}` }), shape("text", { class: "tickmark", x: x(v), y: height - 22, "text-anchor": "middle" }, number(v)));
  root.append(shape("text", { class: "title", x: (left + W - right) / 2, y: height - 5, "text-anchor": "middle" }, "seconds for one pair, mean"));
  rows.forEach((row, i) => {
    const y = 10 + i * step;
    let sum = 0;
    root.append(shape("text", { class: "label", x: left - 10, y: y + 17, "text-anchor": "end" }, shortName(row.name)));
    parts(row).forEach((seconds, s) => {
      const wide = x(sum + seconds) - x(sum);
      if (seconds > 0) {
        root.append(shape("rect", { class: `bar c${s % 8}`, x: x(sum), y, width: Math.max(0.5, wide), height: 24 },
          shape("title", {}, `${row.name}, ${names[s]}: ${number(seconds)} s`)));
        if (wide > 7 * names[s].length + 6) root.append(shape("text", { class: "inbar", x: x(sum) + wide / 2, y: y + 16, "text-anchor": "middle" }, names[s]));
      }
      sum += seconds;
    });
    root.append(shape("text", { class: "value", x: x(sum) + 6, y: y + 17 }, `${number(sum)} s`));
  });
  const key = el("ul", { class: "legend" }, ...names.map((stage, s) => el("li", {}, shape("svg", { class: "swatch", viewBox: "0 0 26 12", "aria-hidden": "true" }, shape("rect", { class: `bar c${s % 8}`, width: 26, height: 12 })), stage)));
  return figure("Time by stage", "mean over the runs that gave a result", root, key,
    numbers("Mean seconds by stage", ["method", ...stages, "all"], rows.map((row) => [row.name, ...row.of.map((v) => number(v)), number(row.of.reduce((a, b) => a + b, 0))])));
}

// Cividis, which the colour-blind see as others do.
const RAMP = [[0, 32, 77], [49, 68, 107], [102, 105, 112], [149, 143, 120], [203, 186, 105], [255, 234, 70]];
function rampColour(share) {
  const at = Math.max(0, Math.min(1, share)) * (RAMP.length - 1), k = Math.min(RAMP.length - 2, Math.floor(at));
  return RAMP[k].map((c, i) => Math.round(c + (at - k) * (RAMP[k + 1][i] - c)));
}

/** A sweep: one metric over two of the parameters, the others held or averaged. */
function heatMap() {
  const sweep = study.sweep;
  if (!sweep || !sweep.metrics.length) return null;
  const parameters = sweep.parameters, lengths = parameters.map(([, values]) => values.length);
  const state = { metric: 0, across: parameters.length > 1 ? 1 : 0, down: 0, held: parameters.map(() => "mean") };
  const holder = el("div"), rest = el("div", { class: "controls" });

  /** Mean of the metric where the given parameters have the given values; the others as they are held. */
  function valueAt(fixed) {
    let sum = 0, count = 0;
    sweep.metrics[state.metric][1].forEach((value, flat) => {
      if (value === null) return;
      let remaining = flat;
      for (let p = lengths.length - 1; p >= 0; p--) {
        const index = remaining % lengths[p];
        remaining = Math.floor(remaining / lengths[p]);
        const wanted = p in fixed ? fixed[p] : state.held[p];
        if (wanted !== "mean" && Number(wanted) !== index) return;
      }
      sum += value;
      count += 1;
    });
    return count ? sum / count : null;
  }

  function draw() {
    const { across, down } = state, [name] = sweep.metrics[state.metric], better = sweep.better[name];
    const one = across === down, columns = parameters[across][1], lines = one ? [""] : parameters[down][1];
    const cells = lines.map((_, j) => columns.map((_, i) => valueAt(one ? { [across]: i } : { [down]: j, [across]: i })));
    const known = cells.flat().filter((v) => v !== null);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const best = better === "high" ? high : better === "low" ? low : null;
    const left = one ? 20 : 120, wide = Math.min(110, (W - left - 10) / columns.length), tall = 42;
    const height = lines.length * tall + 62;
    const root = drawing(`${name} over ${parameters[across][0]}${one ? "" : ` and ${parameters[down][0]}`}`, W, height);
    cells.forEach((line, j) => {
      if (!one) root.append(shape("text", { class: "tickmark", x: left - 8, y: 8 + j * tall + 26, "text-anchor": "end" }, lines[j]));
      line.forEach((value, i) => {
        const x = left + i * wide, y = 8 + j * tall, share = high > low && value !== null ? (value - low) / (high - low) : 0.5;
        const rgb = rampColour(better === "low" ? 1 - share : share), dark = rgb[0] * 0.3 + rgb[1] * 0.59 + rgb[2] * 0.11 < 130;
        const rect = shape("rect", { class: value === null ? "cell none" : "cell", x: x + 1, y: y + 1, width: wide - 2, height: tall - 2, fill: value === null ? "none" : `rgb(${rgb})` });
        const is = value !== null && value === best;
        root.append(rect, shape("text", { class: "incell", x: x + wide / 2, y: y + 26, "text-anchor": "middle", fill: value === null ? "currentColor" : dark ? "#fff" : "#111" }, number(value) + (is ? " ★" : "")));
        if (is) root.append(shape("rect", { class: "bestcell", x: x + 1, y: y + 1, width: wide - 2, height: tall - 2 }));
      });
    });
    columns.forEach((text, i) => root.append(shape("text", { class: "tickmark", x: left + (i + 0.5) * wide, y: lines.length * tall + 26, "text-anchor": "middle" }, text)));
    root.append(shape("text", { class: "title", x: left + (columns.length * wide) / 2, y: height - 8, "text-anchor": "middle" }, parameters[across][0]));
    if (!one) root.append(shape("text", { class: "title", transform: `translate(14 ${8 + (lines.length * tall) / 2}) rotate(-90)`, "text-anchor": "middle" }, parameters[down][0]));
    const winners = better ? cells.flatMap((line, j) => line.map((value, i) => (value === best ? [i, j] : null)).filter(Boolean)) : [];
    const place = ([i, j]) => [`${parameters[across][0]} = ${columns[i]}`, one ? null : `${parameters[down][0]} = ${lines[j]}`].filter(Boolean).join(", ");
    holder.replaceChildren(root, winners.length ? el("p", { class: "note" }, `best ${name}: ${number(best)} at ${winners.slice(0, 3).map(place).join("; ")}${winners.length > 3 ? " and others" : ""}`) : "");
    rest.replaceChildren(...parameters.map(([text, values], p) => p === across || p === down ? null
      : dropdown(text, [["mean", "mean over all"], ...values.map((v, i) => [i, v])], state.held[p], (v) => { state.held[p] = v; draw(); })).filter(Boolean));
  }

  draw();
  const options = parameters.map(([text], p) => [p, text]);
  const choose = el("div", { class: "controls" }, dropdown("metric", sweep.metrics.map(([text], k) => [k, text]), 0, (v) => { state.metric = Number(v); draw(); }));
  if (parameters.length > 1) choose.append(
    dropdown("across", options, state.across, (v) => { state.across = Number(v); draw(); }),
    dropdown("down", options, state.down, (v) => { state.down = Number(v); draw(); }));
  return figure(`Sweep${sweep.method ? ` of ${sweep.method}` : ""}`, "brighter is better, or more where neither is; ★ the best", choose, rest, holder);
}
