// Tables that sort by any column, the best values marked.

const TEXT = new Set(["pair", "method", "status", "reason"]);

/** Which rows hold the best value of a column among rows of the same group. */
function bestRows(rows, column, groupOf) {
  const found = new Set();
  if (!column.better) return found;
  const groups = new Map();
  for (const row of rows) {
    const value = row[column.name];
    if (typeof value !== "number" || row.status === "failed") continue;
    const key = groupOf(row);
    if (!groups.has(key)) groups.set(key, []);
    groups.get(key).push(row);
  }
  for (const group of groups.values()) {
    if (group.length < 2) continue;
    const values = group.map((row) => row[column.name]);
    const best = column.better === "high" ? Math.max(...values) : Math.min(...values);
    for (const row of group) if (row[column.name] === best) found.add(row);
  }
  return found;
}

const titleOf = (column) => (column.title || column.name) + (column.unit ? ` (${column.unit})` : "");

function compared(a, b, name) {
  const x = a[name], y = b[name];
  const nothing = (v) => v === null || v === undefined || v === "";
  if (nothing(x) || nothing(y)) return nothing(x) - nothing(y);
  if (typeof x === "number" && typeof y === "number") return x - y;
  return String(x).localeCompare(String(y), "en", { numeric: true });
}

/**
 * A table that sorts by its headings.
 *
 * `cell(row, column)` may return a node or text in place of the value; `group(row)` says among which rows the best is
 * marked.
 */
function sortable({ caption, columns, rows, cell, group = () => "", search = false }) {
  const best = new Map(columns.map((column) => [column.name, bestRows(rows, column, group)]));
  const body = el("tbody");
  const status = el("p", { class: "hidden", "aria-live": "polite" });
  let order = { name: null, down: false };
  let wanted = "";
  const heads = columns.map((column) => {
    const better = column.better ? `; ${column.better === "high" ? "more" : "less"} is better` : "";
    const button = el(
      "button",
      { type: "button", title: (column.description || titleOf(column)) + better, onclick: () => sort(column) },
      titleOf(column),
      el("span", { class: "arrow", "aria-hidden": "true" }),
    );
    return el("th", { scope: "col", class: TEXT.has(column.name) ? null : "num", "aria-sort": "none" }, button);
  });

  function draw() {
    const shown = rows.filter((row) => !wanted || columns.some((c) => String(row[c.name] ?? "").toLowerCase().includes(wanted)));
    // Rows without a value come last in both directions.
    const empty = (row) => row[order.name] === null || row[order.name] === undefined || row[order.name] === "";
    const sorted = !order.name ? shown : [...shown].sort((a, b) => {
      const value = compared(a, b, order.name);
      return empty(a) || empty(b) || !order.down ? value : -value;
    });
    body.replaceChildren(
      ...sorted.map((row) =>
        el("tr", { class: row.status ?? null }, ...columns.map((column) => {
          const own = cell?.(row, column);
          const is = best.get(column.name).has(row);
          const star = is ? el("span", { class: "star", title: "best" }, " ★", el("span", { class: "hidden" }, " best")) : null;
          const text = own ?? (typeof row[column.name] === "number" ? number(row[column.name], column.digits) : String(row[column.name] ?? ""));
          return el("td", { class: [TEXT.has(column.name) ? column.name : "num", is ? "best" : ""].join(" ") }, text, star);
        })),
      ),
    );
    if (!sorted.length) body.append(el("tr", {}, el("td", { colspan: columns.length }, "nothing to show")));
    return sorted.length;
  }

  function sort(column) {
    const again = order.name === column.name;
    order = { name: column.name, down: again ? !order.down : column.better === "high" };
    columns.forEach((other, k) => heads[k].setAttribute("aria-sort", other !== column ? "none" : order.down ? "descending" : "ascending"));
    draw();
    status.textContent = `${caption}: sorted by ${titleOf(column)}, ${order.down ? "descending" : "ascending"}`;
  }

  draw();
  const table = el("table", {}, el("caption", {}, caption), el("thead", {}, el("tr", {}, ...heads)), body);
  const frame = el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption }, table);
  const field = el("input", { type: "search", placeholder: "pair, method, status …" });
  field.addEventListener("input", () => {
    wanted = field.value.trim().toLowerCase();
    status.textContent = `${draw()} rows`;
  });
  return el("div", { class: "table" }, search ? el("label", { class: "field" }, el("span", {}, "Filter rows"), field) : null, frame, status);
}

/** A table that only shows. */
function plainTable(caption, heads, rows) {
  return el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    el("table", { class: "plain" },
      el("caption", {}, caption),
      el("thead", {}, el("tr", {}, ...heads.map((text, k) => el("th", { scope: "col", class: k ? "num" : null }, text)))),
      el("tbody", {}, ...rows.map((row) => el("tr", {}, el("th", { scope: "row" }, row[0]), ...row.slice(1).map((text) => el("td", { class: "num" }, text))))),
    ));
}

/** The numbers behind a chart, folded away. */
const numbers = (caption, heads, rows) => el("details", { class: "numbers" }, el("summary", {}, "The numbers"), plainTable(caption, heads, rows));
