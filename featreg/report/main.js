// The page put together, its theme and its address.

const content = document.getElementById("content");
const table = study.table;
const viewer = study.entries.length ? new Viewer() : null;

function verdict() {
  const count = (status) => study.entries.filter((entry) => entry.status === status).length;
  const seeds = new Set(study.entries.map((entry) => entry.seed)).size;
  const many = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;
  const parts = [`${many(study.pairs.length, "pair")} × ${many(study.methods.length, "method")}${seeds > 1 ? ` × ${seeds} seeds` : ""}: `, badge("ok"), ` ${count("ok")}`];
  for (const status of ["unreliable", "failed"]) if (count(status)) parts.push(" ", badge(status), ` ${count(status)}`);
  document.getElementById("verdict").append(...parts);
}

/** Methods by their means, from the intervals. */
function summaryTable() {
  const names = Object.keys(table.intervals);
  if (!names.length) return null;
  const metrics = table.columns.filter((c) => names.some((name) => table.intervals[name][c.name]?.[0] !== undefined && table.intervals[name][c.name][0] !== null));
  const rows = names.map((method) => ({ method, ...Object.fromEntries(metrics.map((c) => [c.name, table.intervals[method][c.name]?.[0] ?? null])) }));
  return sortable({
    caption: `Mean of each method [${Math.round(100 * table.confidence)} % interval]`,
    columns: [{ name: "method", description: "method" }, ...metrics],
    rows,
    cell: (row, column) => {
      if (column.name === "method") return el("span", {}, swatch(kindOf(row.method)), row.method);
      const [mean, low, high] = table.intervals[row.method][column.name] ?? [null, null, null];
      if (mean === null) return "–";
      const text = number(mean, column.digits === null ? null : Math.min(3, column.digits || 1));
      return low === null ? text : el("span", {}, text, el("span", { class: "interval" }, ` [${number(low, null, 3)}, ${number(high, null, 3)}]`));
    },
  });
}

function differenceTable() {
  const names = Object.keys(table.differences);
  const metrics = table.columns.filter((c) => names.some((name) => typeof table.differences[name][c.name]?.[0] === "number"));
  if (!names.length || !metrics.length) return null;
  const text = ([mean, low, high] = [null, null, null]) => {
    if (mean === null) return "–";
    const sign = mean > 0 ? "+" : "", clear = low !== null && (low > 0 || high < 0);
    return `${sign}${spreadText([mean, low, high])}${clear ? " *" : ""}`;
  };
  return el("details", { class: "numbers" }, el("summary", {}, `Paired differences from ${table.baseline || "the first method"}`),
    plainTable(`Mean difference from ${table.baseline}; * its interval leaves out zero`, ["method", ...metrics.map(titleOf)],
      names.map((name) => [name, ...metrics.map((c) => text(table.differences[name][c.name]))])));
}

function runsTable() {
  if (!table.rows.length) return null;
  const index = (row) => study.entries.findIndex((e) => study.pairs[e.pair].name === row.pair && study.methods[e.method] === row.method && (row.seed === undefined || row.seed === null || e.seed === row.seed));
  return sortable({
    caption: "Every run",
    columns: table.columns,
    rows: table.rows,
    search: table.rows.length > 8,
    group: (row) => row.pair,
    cell: (row, column) => {
      if (column.name === "status" && row.status) return badge(row.status);
      if (column.name === "method") return el("span", {}, swatch(kindOf(row.method)), row.method);
      if (column.name === "reason" && row.reason) return el("span", { class: "clamp", title: row.reason }, row.reason);
      if (column.name !== "pair") return null;
      const entry = study.entries[index(row)];
      return entry ? el("a", { href: "#pairs", onclick: (event) => { event.preventDefault(); viewer.go({ pair: entry.pair, method: entry.method, seed: entry.seed }, true); } }, row.pair) : null;
    },
  });
}

function troubles() {
  const found = study.entries.filter((entry) => entry.status !== "ok");
  if (!found.length) return null;
  const item = (entry) => el("li", {}, badge(entry.status), ` ${study.methods[entry.method]} on ${study.pairs[entry.pair].name}: `, el("span", { class: "why" }, entry.failure || entry.reason || "no reason given"));
  const failed = found.filter((entry) => entry.status === "failed"), rest = found.filter((entry) => entry.status !== "failed");
  const list = (title, entries) => entries.length ? el("details", { open: entries.length <= 6 }, el("summary", {}, `${entries.length} ${title}`), el("ul", { class: "troubles" }, ...entries.map(item))) : null;
  return section("failures", "Failures and refusals", list("failed", failed), list("not to be trusted", rest));
}

function footnotes() {
  const card = (title, entries) => entries.length ? el("div", { class: "card" }, el("h3", {}, title), el("dl", { class: "notes" }, ...entries.flatMap(([name, lines]) => [name ? el("dt", {}, name) : null, ...lines.map((line) => el("dd", {}, line))]))) : null;
  const parts = [card("Protocol", study.protocol), card("Machine and versions", study.machine)];
  const metrics = table.columns.filter((c) => c.description);
  if (metrics.length) parts.push(card("Columns", metrics.map((c) => [titleOf(c), [c.description + (c.better ? `; ${c.better === "high" ? "more" : "less"} is better` : "")]])));
  return parts.some(Boolean) ? section("protocol", "Protocol", el("div", { class: "cards" }, ...parts.filter(Boolean))) : null;
}

function theme() {
  const button = document.getElementById("theme"), order = ["auto", "light", "dark"];
  let kept = "auto";
  try {
    kept = localStorage.getItem("featreg-theme") ?? "auto";
  } catch {
    // No storage: the choice lasts as long as the page.
  }
  const show = (name) => {
    kept = name;
    if (name === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = name;
    button.textContent = `${{ auto: "◐", light: "☀", dark: "☾" }[name]} ${name}`;
    button.setAttribute("aria-label", `Theme: ${name}. Change it`);
    viewer?.canvas.isConnected && viewer.draw();
  };
  button.addEventListener("click", () => {
    show(order[(order.indexOf(kept) + 1) % order.length]);
    try {
      localStorage.setItem("featreg-theme", kept);
    } catch {
      // As above.
    }
  });
  show(order.includes(kept) ? kept : "auto");
}

function start() {
  theme();
  verdict();
  const tables = [summaryTable(), differenceTable(), runsTable()].filter(Boolean);
  const charts = [heatMap(), intervalChart(), timeChart(), curveChart(), scatterChart()].filter(Boolean);
  chartDownloads(charts);
  const sections = [
    tables.length ? section("results", "Results", el("p", { class: "note" }, "★ marks the best of its column, among the methods on the same pair; – stands for a mean that would leave out pairs the method gave up; headings sort. Why a result is not trusted stands whole under Failures and refusals."), tableDownloads(), ...tables) : null,
    charts.length ? section("charts", "Charts", el("div", { class: "cards charts" }, ...charts)) : null,
    viewer?.section() ?? el("p", { class: "notice" }, "The study holds no results."),
    troubles(),
    footnotes(),
  ].filter(Boolean);
  content.append(...sections);
  const nav = document.getElementById("nav");
  for (const part of sections) if (part.id) nav.append(el("a", { href: `#${part.id}` }, part.querySelector("h2").textContent));
  if (!viewer) return;
  const asked = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  const within = (value, count) => (Number.isInteger(Number(value)) && value >= 0 && value < count ? Number(value) : undefined);
  const wish = { pair: within(asked.pair, study.pairs.length), method: within(asked.method, study.methods.length), mode: MODES.some(([m]) => m === asked.view) ? asked.view : undefined };
  if (asked.pair !== undefined) wish.seed = Number(asked.seed) || 0;
  // Pictures are unpacked when the viewer comes near the window, so that the table is there at once.
  const given = Object.fromEntries(Object.entries(wish).filter(([, value]) => value !== undefined));
  new IntersectionObserver((seen, observer) => {
    if (!seen.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    viewer.go(viewer.turn ? {} : given);
  }, { rootMargin: "400px" }).observe(viewer.stage);
  viewer.drawHeads();
  viewer.drawSide();
  if (asked.pair !== undefined) document.getElementById("pairs").scrollIntoView();
}

start();
document.documentElement.dataset.usable = Math.round(performance.now());
