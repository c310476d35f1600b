// Elements, numbers as text, and signs that mean the same everywhere on the page.
// Text only ever enters the page as text: names in a study may hold anything.

const SVG = "http://www.w3.org/2000/svg";

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value === true) node.setAttribute(name, "");
    else node.setAttribute(name, value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

/** An HTML element; attributes named on... are listeners, children are nodes or text. */
const el = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);

/** An SVG element. */
const shape = (tag, attributes = {}, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

let made = 0;
/** An id that no other element has. */
const fresh = (stem) => `${stem}-${++made}`;

/** A number as text: fixed digits where they are given, else `count` that count, whole ones all. */
function number(value, digits = null, count = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (typeof value !== "number") return String(value);
  if (digits !== null) return value.toFixed(digits);
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  return size >= 1e5 || (size > 0 && size < 1e-3) ? value.toExponential(2) : String(Number(value.toPrecision(Math.max(count, Math.ceil(Math.log10(size))))));
}

const STATUS = { ok: ["✓", "ok"], unreliable: ["!", "unreliable"], failed: ["✕", "failed"] };

/** The status of a result, told by a sign and a word as well as by its colour. */
function badge(status) {
  const [sign, word] = STATUS[status] ?? ["", status];
  return el("span", { class: `badge ${status}` }, el("span", { "aria-hidden": "true" }, sign), ` ${word}`);
}

/** A choice of one of a few, as native radio buttons that look like one bar. */
function choice(legend, options, chosen, onchange) {
  const name = fresh("choice");
  const set = el("fieldset", { class: "segments" }, el("legend", {}, legend));
  options.forEach(([value, text, extra], k) => {
    const input = el("input", { type: "radio", name, value, checked: value === chosen });
    input.addEventListener("change", () => input.checked && onchange(value, k));
    // The button itself lies unseen over its label, so that whoever clicks or points meets a real one.
    set.append(el("label", { class: "segment" }, input, el("span", {}, extra ?? null, text)));
  });
  set.choose = (value) => {
    for (const input of set.querySelectorAll("input")) input.checked = input.value === String(value);
  };
  return set;
}

/** A labelled drop-down. */
function dropdown(text, options, chosen, onchange) {
  const select = el("select", { "aria-label": text });
  for (const [value, label] of options) select.append(el("option", { value, selected: String(value) === String(chosen) }, label));
  select.addEventListener("change", () => onchange(select.value));
  const label = el("label", { class: "field" }, el("span", {}, text), select);
  label.select = select;
  return label;
}

/** A labelled slider that shows its value. */
function slider(text, { min, max, step = 1, value, shown = (v) => String(v) }, oninput) {
  const output = el("output", {}, shown(value));
  const input = el("input", { type: "range", min, max, step, value });
  input.value = value;
  const say = () => {
    output.textContent = shown(Number(input.value));
    input.setAttribute("aria-valuetext", output.textContent);
  };
  input.addEventListener("input", () => {
    say();
    oninput(Number(input.value));
  });
  say();
  const label = el("label", { class: "field range" }, el("span", {}, text), input, output);
  label.input = input;
  label.set = (v) => {
    input.value = v;
    say();
  };
  return label;
}

/** A box to tick. */
function tick(text, checked, onchange, mark = null) {
  const input = el("input", { type: "checkbox", checked });
  input.addEventListener("change", () => onchange(input.checked));
  return el("label", { class: "tick" }, input, mark, text);
}

/** A section of the page with its heading. */
function section(id, title, ...children) {
  const heading = `${id}-heading`;
  return el("section", { id, "aria-labelledby": heading }, el("h2", { id: heading }, title), ...children);
}

/** Names and values under each other. */
function facts(entries) {
  const list = el("dl", { class: "facts" });
  for (const [name, value] of entries) list.append(el("dt", {}, name), el("dd", {}, value));
  return list;
}
