// One pair and one method at a time: tie points over both images, and the aligned pair in several ways.

const MODES = [
  ["matches", "Matches"], ["swipe", "Swipe"], ["flicker", "Flicker"],
  ["checker", "Checkerboard"], ["overlay", "Overlay"], ["residuals", "Residuals"],
];
// Screen pixels at which an arrow is cut.
const LONGEST_ARROW = 90;
const KEYS = "Arrow left and right step through the tie points, plus and minus zoom, 0 shows the whole image, W A S D move it.";

class Viewer {
  constructor() {
    this.at = { pair: 0, method: study.entries[0]?.method ?? 0, seed: study.entries[0]?.seed ?? 0, mode: "matches", set: "scored" };
    this.shown = { correct: true, false: true, accepted: true, rejected: true, unknown: true };
    this.lines = null;
    this.gain = null;
    this.against = "model";
    this.split = 0.5;
    this.tiles = 8;
    this.phase = 0;
    this.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.chosen = -1;
    this.turn = 0;
    this.canvas = el("canvas", { class: "stage", tabindex: "0", role: "application", "aria-label": "Tie points", "aria-describedby": "viewer-keys" });
    this.details = el("output", { class: "point", "aria-live": "polite" }, "Point at a tie point, or use the arrow keys, to read it.");
    this.tip = el("div", { class: "tip", hidden: true, "aria-hidden": "true" });
    this.stage = el("div", { class: "frame" }, this.canvas, this.tip);
    this.controls = el("div", { class: "controls" });
    this.side = el("div", { class: "side" });
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.stage);
    setInterval(() => {
      if (this.at.mode !== "flicker" || !this.playing || document.hidden) return;
      this.phase = 1 - this.phase;
      this.draw();
    }, 600);
  }

  section() {
    this.heads = el("div", { class: "pickers" });
    this.modes = choice("View", MODES, this.at.mode, (mode) => this.go({ mode }));
    return section("pairs", "Pairs", this.heads, this.modes,
      el("div", { class: "viewer" },
        el("div", { class: "main" }, this.controls, this.stage, this.details,
          el("p", { class: "note", id: "viewer-keys" }, `Wheel and drag zoom and move both images together. ${KEYS}`)),
        this.side));
  }

  /** The entry on show; there may be none for this pair, method and seed. */
  get number() {
    const { pair, method, seed } = this.at;
    return study.entries.findIndex((entry) => entry.pair === pair && entry.method === method && entry.seed === seed);
  }

  get entry() {
    return study.entries[this.number] ?? null;
  }

  async go(change, scroll = false) {
    const before = { ...this.at };
    Object.assign(this.at, change);
    const seeds = study.entries.filter((entry) => entry.pair === this.at.pair && entry.method === this.at.method).map((entry) => entry.seed);
    if (seeds.length && !seeds.includes(this.at.seed)) this.at.seed = seeds[0];
    const { pair, method, seed, mode } = this.at;
    try {
      history.replaceState(null, "", `#pair=${pair}&method=${method}&seed=${seed}&view=${mode}`);
    } catch {
      // A page from disk may be refused it; the address is a convenience.
    }
    if (scroll) {
      document.getElementById("pairs").scrollIntoView();
      this.canvas.focus({ preventScroll: true });
    }
    if (pair !== before.pair) this.views = null;
    if (pair !== before.pair || method !== before.method || seed !== before.seed) {
      this.chosen = -1;
      this.aligned = this.ties = null;
      this.gain = this.lines = null;
    }
    await this.load();
  }

  async load() {
    const turn = ++this.turn;
    this.drawHeads();
    this.drawSide();
    const { entry } = this, pair = study.pairs[this.at.pair];
    this.stage.classList.add("busy");
    try {
      const [pictures, ties] = await Promise.all([
        pair?.images ? picturesOf(this.at.pair) : null,
        entry?.points ? tiesOf(this.number) : null,
      ]);
      // Another pair or method may have been chosen meanwhile.
      if (turn !== this.turn) return;
      this.pictures = pictures;
      this.ties = ties;
      this.problem = pair?.problem ?? "no pair";
    } catch (error) {
      if (turn !== this.turn) return;
      this.pictures = null;
      this.problem = error.message;
    }
    this.stage.classList.remove("busy");
    if (this.pictures) {
      this.sizes = this.pictures.map((picture) => picture.size);
      this.map = mapOf(entry?.lattice, this.sizes[0]);
      this.truth = mapOf(pair.lattice, this.sizes[0]);
      this.views ??= this.sizes.map((size) => new View(size));
    }
    if (this.ties) this.select();
    this.drawControls();
    this.resize();
    this.stage.dataset.ready = `${this.at.pair}/${this.at.method}/${this.at.mode}`;
  }

  /** Which tie points are on show, and their kinds. */
  select() {
    const { ties } = this, truth = Boolean(study.pairs[this.at.pair].truth);
    this.kinds = Array.from({ length: ties.count }, (_, k) => kindOfPoint(ties, k, truth));
    const wanted = { scored: FLAG.scored, final: FLAG.inlier, all: 0 }[this.at.set];
    this.rows = [];
    for (let k = 0; k < ties.count; k++)
      if ((ties.flags[k] & wanted) === wanted && this.shown[this.kinds[k]]) this.rows.push(k);
    this.lines ??= Math.min(1, Math.ceil(50 * Math.sqrt(60 / Math.max(1, this.rows.length))) / 50);
  }

  /** How many tie points a setting of the slider joins with lines: few can be told apart, so that it grows slowly. */
  joined(setting) {
    return Math.round(setting ** 2 * this.rows.length);
  }

  drawHeads() {
    const { pair, method, seed } = this.at;
    const names = study.pairs.map((p, k) => [k, `${k + 1}. ${p.name}`]);
    const turn = (by) => () => this.go({ pair: (pair + by + names.length) % names.length });
    const methods = study.methods.map((name, k) => {
      const entry = study.entries.find((e) => e.pair === pair && e.method === k && (e.seed === seed || e.method !== method));
      return [k, name, el("span", {}, swatch(k), entry && entry.status !== "ok" ? el("span", { class: `sign ${entry.status}`, title: entry.status }, STATUS[entry.status][0], el("span", { class: "hidden" }, ` ${entry.status}`)) : "")];
    });
    const seeds = [...new Set(study.entries.filter((e) => e.pair === pair && e.method === method).map((e) => e.seed))];
    const focused = this.heads.contains(document.activeElement) ? document.activeElement : null;
    const again = focused && [...this.heads.querySelectorAll("button,select,input")].indexOf(focused);
    this.heads.replaceChildren(
      el("div", { class: "controls" },
        dropdown("Pair", names, pair, (v) => this.go({ pair: Number(v) })),
        names.length > 1 ? el("button", { type: "button", class: "quiet", "aria-label": "Previous pair", onclick: turn(-1) }, "‹") : null,
        names.length > 1 ? el("button", { type: "button", class: "quiet", "aria-label": "Next pair", onclick: turn(1) }, "›") : null,
        seeds.length > 1 ? dropdown("Seed", seeds.map((v) => [v, v]), seed, (v) => this.go({ seed: Number(v) })) : null),
      choice("Method", methods, method, (value) => this.go({ method: Number(value) })));
    // Whoever chose with the keyboard stays where they were.
    if (focused) {
      const fields = [...this.heads.querySelectorAll("button,select,input")];
      (focused.type === "radio" ? fields.find((f) => f.type === "radio" && f.checked) : fields[again])?.focus();
    }
    this.modes.choose(this.at.mode);
  }

  drawControls() {
    const { mode } = this.at, { ties } = this, parts = [];
    const truth = Boolean(study.pairs[this.at.pair]?.truth);
    if (ties && (mode === "matches" || mode === "residuals")) {
      const counts = {};
      const wanted = { scored: FLAG.scored, final: FLAG.inlier, all: 0 }[this.at.set];
      for (let k = 0; k < ties.count; k++) if ((ties.flags[k] & wanted) === wanted) counts[this.kinds[k]] = (counts[this.kinds[k]] ?? 0) + 1;
      parts.push(dropdown("Points", [["scored", `scored (${this.entry.stage})`], ["final", "final tie points"], ["all", "all candidates"]], this.at.set,
        (set) => { this.at.set = set; this.select(); this.drawControls(); this.draw(); }));
      for (const kind of truth ? ["correct", "false", "unknown"] : ["accepted", "rejected"])
        if (kind !== "unknown" || counts.unknown)
          parts.push(tick(`${counts[kind] ?? 0} ${kind}`, this.shown[kind], (on) => { this.shown[kind] = on; this.select(); this.draw(); }, markOf(kind)));
    }
    if (mode === "matches" && ties)
      parts.push(slider("Lines", { min: 0, max: 1, step: 0.02, value: this.lines, shown: (v) => `${this.joined(v)} of ${this.rows.length}` }, (v) => { this.lines = v; this.draw(); }));
    if (mode === "swipe")
      parts.push(slider("Reference up to", { min: 0, max: 1, step: 0.01, value: this.split, shown: (v) => `${Math.round(100 * v)} %` }, (v) => { this.split = v; this.draw(); }));
    if (mode === "flicker") {
      const text = () => (this.playing ? "❚❚ Stop" : "▶ Play");
      const button = el("button", { type: "button", onclick: () => { this.playing = !this.playing; button.textContent = text(); } }, text());
      parts.push(button, el("button", { type: "button", onclick: () => { this.playing = false; button.textContent = text(); this.phase = 1 - this.phase; this.draw(); } }, "Switch once"));
    }
    if (mode === "checker")
      parts.push(slider("Tiles", { min: 2, max: 32, value: this.tiles, shown: (v) => `${v}` }, (v) => { this.tiles = v; this.draw(); }));
    if (mode === "residuals" && ties) {
      if (this.truth && this.map) parts.push(dropdown("Residual from", [["model", "the fitted model"], ["truth", "the truth"]], this.against, (v) => { this.against = v; this.gain = null; this.drawControls(); this.draw(); }));
      this.gain ??= this.usualGain();
      parts.push(slider("Enlarged", { min: 0, max: 10, step: 0.25, value: Math.log2(this.gain), shown: (v) => `${number(2 ** v, 2 ** v < 10 ? 1 : 0)} ×` }, (v) => { this.gain = 2 ** v; this.draw(); }));
    }
    if (mode === "overlay") parts.push(el("p", { class: "note" }, "Reference magenta, secondary green: what agrees is gray or white."));
    this.controls.replaceChildren(...parts);
  }

  drawSide() {
    const { entry } = this, pair = study.pairs[this.at.pair];
    if (!entry) return this.side.replaceChildren(el("p", { class: "notice" }, "This method was not run on this pair."));
    const parts = [el("p", {}, badge(entry.status))];
    const why = entry.failure || entry.reason;
    if (why) parts.push(el("p", { class: "why" }, why));
    if (entry.scores.length) parts.push(el("h3", {}, "Scores"), facts(entry.scores.map(([name, value]) => {
      const column = study.table.columns.find((c) => c.name === name);
      return [column ? titleOf(column) : name, number(value, column?.digits ?? null)];
    })));
    if (entry.points) {
      const { counts, shown, total } = entry.points;
      parts.push(el("h3", {}, "Tie points"), facts(entry.chain.map(([name, count], k) => [k && k < entry.chain.length - 1 ? `after ${name}` : name, number(count)])));
      if (pair.truth) parts.push(el("p", { class: "note" }, `${counts.correct} of ${counts.scored} at ${entry.stage} within ${number(study.threshold)} px. Truth: ${pair.truth}.`));
      if (shown < total) parts.push(el("p", { class: "note" }, `${shown} of ${total} are on this page, final and scored ones first.`));
      parts.push(el("h3", {}, "Model"), facts(entry.model));
    }
    if (entry.gates?.length) {
      const bound = (g) => [g.low !== null ? `≥ ${number(g.low)}` : "", g.high !== null ? `≤ ${number(g.high)}` : ""].filter(Boolean).join(", ");
      parts.push(el("details", {}, el("summary", {}, `Trust: ${entry.gates.filter((g) => g.passed).length} of ${entry.gates.length} gates passed`),
        el("ul", { class: "gates" }, ...entry.gates.map((g) => el("li", { title: g.meaning }, el("span", { class: `sign ${g.passed ? "ok" : "failed"}` }, g.passed ? "✓ " : "✕ ", el("span", { class: "hidden" }, g.passed ? "passed " : "failed ")), `${g.name}: ${number(g.value)} (${bound(g) || "no bound"})`)))));
    }
    if (entry.timings.length) parts.push(el("details", {}, el("summary", {}, `Time: ${number(entry.timings.reduce((sum, [, s]) => sum + s, 0))} s`), facts(entry.timings.map(([name, s]) => [name, `${number(s)} s`]))));
    this.side.replaceChildren(...parts);
  }

  resize() {
    const width = this.stage.clientWidth;
    if (!width) return;
    const pictures = this.pictures, one = this.at.mode !== "matches", ratio = (size) => size[1] / size[0];
    let height = 160;
    if (pictures) {
      const sizes = pictures.map((p) => p.size), half = (width - 8) / 2;
      height = one ? Math.min(width * ratio(sizes[0]), Math.max(420, 0.72 * innerHeight)) : Math.min(half * Math.max(ratio(sizes[0]), ratio(sizes[1])), Math.max(360, 0.72 * innerHeight));
      height = Math.max(160, Math.round(height));
      this.views[0].place(one ? [0, 0, width, height] : [0, 0, half, height]);
      this.views[1].place(one ? [0, 0, width, height] : [half + 8, 0, half, height]);
    }
    const dense = devicePixelRatio || 1;
    this.canvas.style.height = `${height}px`;
    if (this.canvas.width !== Math.round(width * dense) || this.canvas.height !== Math.round(height * dense)) {
      this.canvas.width = Math.round(width * dense);
      this.canvas.height = Math.round(height * dense);
    }
    this.dense = dense;
    this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.paint();
    });
  }

  paint() {
    const context = this.canvas.getContext("2d"), { mode } = this.at;
    context.setTransform(this.dense, 0, 0, this.dense, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.canvas.setAttribute("aria-label", this.label());
    if (!this.pictures) return this.say(context, this.problem || "…");
    if (mode === "matches") return this.paintMatches(context);
    if (mode === "residuals") return this.paintResiduals(context);
    if (!this.map) return this.say(context, "There is no model to align the images with.");
    this.aligned ??= alignedPicture(...this.pictures, this.map);
    this.paintAligned(context, mode);
  }

  label() {
    const pair = study.pairs[this.at.pair], name = study.methods[this.at.method], mode = MODES.find(([m]) => m === this.at.mode)[1];
    const count = this.rows && (this.at.mode === "matches" || this.at.mode === "residuals") ? `, ${this.rows.length} tie points` : "";
    return `${mode} of ${name} on ${pair?.name}${count}`;
  }

  say(context, text) {
    context.fillStyle = getComputedStyle(this.canvas).color;
    context.font = "15px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(text, this.stage.clientWidth / 2, 80, this.stage.clientWidth - 20);
    context.textAlign = "start";
  }

  paintMatches(context) {
    const [left, right] = this.views, { ties } = this;
    this.pictures.forEach((picture, side) => clipped(context, this.views[side], () => drawPicture(context, picture.canvas, picture.extent, this.views[side], 0.72)));
    if (!ties) return this.notes(context, ["reference", "secondary"]);
    const places = {}, lines = {};
    const every = this.rows.length / this.joined(this.lines);
    let next = every / 2;
    this.rows.forEach((k, n) => {
      const a = left.screen(ties.rx[k], ties.ry[k]), b = right.screen(ties.sx[k], ties.sy[k]), kind = this.kinds[k];
      const here = left.holds(...a), there = right.holds(...b);
      places[kind] ??= [[], []];
      if (here) places[kind][0].push(a);
      if (there) places[kind][1].push(b);
      if (n >= next) {
        next += every;
        if (here && there) (lines[kind] ??= []).push([...a, ...b]);
      }
    });
    for (const [kind, many] of Object.entries(lines)) {
      context.strokeStyle = COLOURS[kind];
      context.globalAlpha = Math.max(0.25, Math.min(0.8, 60 / many.length));
      context.setLineDash(kind === "false" || kind === "rejected" ? [5, 4] : []);
      context.lineWidth = 1;
      context.beginPath();
      for (const [u, v, s, t] of many) {
        context.moveTo(u, v);
        context.lineTo(s, t);
      }
      context.stroke();
    }
    context.globalAlpha = 1;
    context.setLineDash([]);
    const size = this.rows.length > 2500 ? 2.2 : 3.2;
    for (const [kind, both] of Object.entries(places))
      both.forEach((many, side) => clipped(context, this.views[side], () => drawMarks(context, kind, many, size)));
    if (this.chosen >= 0) {
      const k = this.chosen, a = left.screen(ties.rx[k], ties.ry[k]), b = right.screen(ties.sx[k], ties.sy[k]);
      for (const [colour, width] of [["#111", 4.5], ["#fff", 2]]) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.beginPath();
        context.moveTo(...a);
        context.lineTo(...b);
        context.stroke();
      }
      clipped(context, left, () => drawRing(context, ...a));
      clipped(context, right, () => drawRing(context, ...b));
    }
    this.notes(context, ["reference", "secondary"]);
  }

  notes(context, texts) {
    this.views.forEach((view, side) => drawNote(context, texts[side], view));
  }

  paintAligned(context, mode) {
    const [view] = this.views, [reference] = this.pictures, { canvas: aligned } = this.aligned, { extent } = reference;
    const first = () => drawPicture(context, reference.canvas, extent, view), second = () => drawPicture(context, aligned, extent, view);
    const [left, top, width, height] = view.box;
    clipped(context, view, () => {
      if (mode === "overlay") {
        this.aligned.overlay ??= overlaid(reference, this.aligned);
        drawPicture(context, this.aligned.overlay, extent, view);
      } else if (mode === "flicker") (this.phase ? second : first)();
      else if (mode === "swipe") {
        const at = left + this.split * width;
        second();
        context.save();
        context.beginPath();
        context.rect(left, top, at - left, height);
        context.clip();
        context.clearRect(left, top, width, height);
        first();
        context.restore();
        context.fillStyle = "#fff";
        context.fillRect(at - 1, top, 2, height);
        context.fillStyle = "#111";
        context.fillRect(at - 2, top, 1, height);
        context.fillRect(at + 1, top, 1, height);
      } else {
        first();
        const side = Math.max(...extent) / this.tiles;
        context.beginPath();
        for (let j = 0; j * side < extent[1]; j++)
          for (let i = (j + 1) % 2; i * side < extent[0]; i += 2) {
            const [u, v] = view.screen(i * side - 0.5, j * side - 0.5);
            context.rect(u, v, Math.min(side, extent[0] - i * side) * view.zoom, Math.min(side, extent[1] - j * side) * view.zoom);
          }
        context.clip();
        context.clearRect(left, top, width, height);
        second();
      }
    });
    const names = { swipe: ["reference", "secondary, aligned"], flicker: [this.phase ? "secondary, aligned" : "reference"], checker: ["reference and secondary in turn"], overlay: ["overlay"] }[mode];
    drawNote(context, names[0], view);
    if (names[1]) drawNote(context, names[1], view, true);
    const share = reference.canvas.width / extent[0];
    if (share < 0.99) drawNote(context, `shown at ${number(100 * share, 0)} % of full resolution`, view, false, true);
    if (this.entry?.status === "unreliable") drawNote(context, "! not to be trusted", view, true, true);
  }

  /** (dx, dy) px of a tie point from the model or from the truth. */
  residual(k) {
    const { ties } = this;
    if (this.against === "model" || !this.truth) return [ties.dx[k], ties.dy[k]];
    const x = ties.rx[k], y = ties.ry[k], [u, v] = this.truth(x, y);
    if (!this.map) return [ties.sx[k] - u, ties.sy[k] - v];
    // Through the model, whose residuals are stored finer than positions are.
    const [p, q] = this.map(x, y);
    return [ties.dx[k] + p - u, ties.dy[k] + q - v];
  }

  usualGain() {
    const lengths = this.rows.filter((k) => ["correct", "accepted"].includes(this.kinds[k])).map((k) => Math.hypot(...this.residual(k))).filter(Number.isFinite).sort((a, b) => a - b);
    const middle = lengths[lengths.length >> 1] || 1;
    return 2 ** Math.max(0, Math.min(10, Math.round(4 * Math.log2((0.03 * Math.max(...this.sizes[0])) / middle)) / 4));
  }

  paintResiduals(context) {
    const [view] = this.views, [reference] = this.pictures;
    clipped(context, view, () => drawPicture(context, reference.canvas, reference.extent, view, 0.6));
    if (!this.ties || !(this.map || this.truth)) return drawNote(context, this.ties ? "neither a model nor a truth" : "no tie points", view);
    const arrows = {}, scale = this.gain * view.zoom;
    for (const k of this.rows) {
      const [dx, dy] = this.residual(k), [u, v] = view.screen(this.ties.rx[k], this.ties.ry[k]);
      if (!Number.isFinite(dx) || !view.holds(u, v)) continue;
      // A wrong match would cross the whole picture and say no more than its direction does.
      const length = Math.hypot(dx, dy) * scale, cut = Math.min(1, LONGEST_ARROW / Math.max(length, 1e-9));
      (arrows[this.kinds[k]] ??= []).push([u, v, dx * scale * cut, dy * scale * cut, cut < 1]);
    }
    clipped(context, view, () => {
      for (const [kind, many] of Object.entries(arrows)) {
        drawArrows(context, kind, many);
        drawMarks(context, kind, many, 1.8);
      }
      if (this.chosen >= 0) drawRing(context, ...view.screen(this.ties.rx[this.chosen], this.ties.ry[this.chosen]));
    });
    drawNote(context, `residuals from the ${this.against === "truth" && this.truth ? "truth" : this.map ? "model" : "truth"}${Object.values(arrows).flat().some((a) => a[4]) ? "; arrows without a head are cut" : ""}`, view);
    const [left, top, , height] = view.box;
    const unit = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].findLast((u) => u * scale < 160) ?? 0.01;
    context.fillStyle = "rgba(12,14,18,.78)";
    context.fillRect(left + 6, top + height - 38, Math.max(90, unit * scale + 24), 32);
    context.fillStyle = context.strokeStyle = "#fff";
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(left + 16, top + height - 17);
    context.lineTo(left + 16, top + height - 13);
    context.lineTo(left + 16 + unit * scale, top + height - 13);
    context.lineTo(left + 16 + unit * scale, top + height - 17);
    context.stroke();
    context.textBaseline = "alphabetic";
    context.font = "600 12px system-ui, sans-serif";
    context.fillText(`${unit} px`, left + 16, top + height - 22);
  }

  /** What is known of a tie point, as (name, text). */
  about(k) {
    const { ties, entry } = this, kind = this.kinds[k], flags = ties.flags[k];
    const where = (x, y) => `${number(x, 2)}, ${number(y, 2)}`;
    let fate = flags & FLAG.inlier ? "final tie point" : "not final";
    if (flags & FLAG.refined) fate += ", made by refinement";
    else if (ties.lost[k]) fate = `dropped by ${entry.stages[ties.lost[k] - 1]}`;
    const lines = [["judged", `${kind}${kind === "correct" || kind === "false" ? ` (${number(ties.error[k], 2)} px from the truth)` : ""}`],
      ["reference", where(ties.rx[k], ties.ry[k])], ["secondary", where(ties.sx[k], ties.sy[k])]];
    if (!Number.isNaN(ties.dx[k])) lines.push(["residual", `${number(Math.hypot(ties.dx[k], ties.dy[k]), 2)} px from the model`]);
    return [...lines, ["score", number(ties.score[k])], ["stage", fate]];
  }

  choose(k, place = null) {
    if (k === this.chosen && !place) return;
    const changed = k !== this.chosen;
    this.chosen = k;
    if (changed) this.draw();
    this.tip.hidden = !place || k < 0;
    if (k < 0) return;
    const lines = this.about(k);
    if (changed) this.details.textContent = lines.map(([name, text]) => `${name} ${text}`).join(" · ");
    if (!place) return;
    if (changed || !this.tip.firstChild) this.tip.replaceChildren(facts(lines));
    const wide = this.tip.offsetWidth, tall = this.tip.offsetHeight;
    const left = place[0] + 16 + wide > this.stage.clientWidth ? place[0] - wide - 12 : place[0] + 16;
    const top = Math.max(4, Math.min(place[1] + 12, this.stage.clientHeight - tall - 4));
    this.tip.style.transform = `translate(${Math.max(4, left)}px, ${top}px)`;
  }

  /** The tie point on show nearest to a place on the canvas, -1 where none is near. */
  nearest(u, v) {
    const { ties, at } = this;
    if (!ties || !this.rows || (at.mode !== "matches" && at.mode !== "residuals")) return -1;
    const side = at.mode === "matches" && this.views[1].holds(u, v) ? 1 : 0;
    const [x, y] = this.views[side].image(u, v), xs = side ? ties.sx : ties.rx, ys = side ? ties.sy : ties.ry;
    let best = (12 / this.views[side].zoom) ** 2, found = -1;
    for (const k of this.rows) {
      const d = (xs[k] - x) ** 2 + (ys[k] - y) ** 2;
      if (d < best) [best, found] = [d, k];
    }
    return found;
  }

  /** Bring the other view to the homologous place after one of them moved. */
  follow(side) {
    if (this.at.mode !== "matches") return;
    const [a, b] = this.views, map = this.map ?? this.truth;
    const moved = this.views[side], other = this.views[1 - side];
    other.zoom = other.least * (moved.zoom / moved.least);
    const whole = moved.zoom <= moved.least * 1.001;
    if (!map || whole) {
      other.x = ((moved.x + 0.5) / moved.size[0]) * other.size[0] - 0.5;
      other.y = ((moved.y + 0.5) / moved.size[1]) * other.size[1] - 0.5;
      return;
    }
    const target = side ? solve(map, [b.x, b.y], [a.x, a.y]) : map(a.x, a.y);
    if (target.every(Number.isFinite)) [other.x, other.y] = target;
  }

  zoom(factor, u = null, v = null) {
    if (!this.views) return;
    const side = u !== null && this.at.mode === "matches" && this.views[1].holds(u, v) ? 1 : 0, view = this.views[side];
    const [left, top, width, height] = view.box;
    view.enlarge(factor, u ?? left + width / 2, v ?? top + height / 2);
    this.follow(side);
    this.draw();
  }

  listen() {
    const { canvas } = this;
    let drag = null;
    const spot = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.views || event.button) return;
      const [u, v] = spot(event);
      drag = { u, v, side: this.at.mode === "matches" && this.views[1].holds(u, v) ? 1 : 0, swipe: this.at.mode === "swipe" && !event.shiftKey && Math.abs(u - this.split * this.stage.clientWidth) < 24 };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const [u, v] = spot(event);
      if (!drag) return this.choose(this.nearest(u, v), [u, v]);
      if (drag.swipe) {
        this.split = Math.max(0, Math.min(1, u / this.stage.clientWidth));
        this.drawControls();
      } else {
        const view = this.views[drag.side];
        view.x -= (u - drag.u) / view.zoom;
        view.y -= (v - drag.v) / view.zoom;
        [drag.u, drag.v] = [u, v];
        this.follow(drag.side);
      }
      this.draw();
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { drag = null; });
    canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; });
    canvas.addEventListener("wheel", (event) => {
      // The page scrolls until somebody has turned to the picture.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), ...spot(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.views) return;
    const step = (by) => {
      if (!this.rows?.length) return;
      const at = this.rows.indexOf(this.chosen);
      const next = this.rows[(at < 0 ? (by > 0 ? 0 : this.rows.length - 1) : at + by + this.rows.length) % this.rows.length];
      const side = this.views[0], [u, v] = side.screen(this.ties.rx[next], this.ties.ry[next]);
      if (!side.holds(u, v)) {
        [side.x, side.y] = [this.ties.rx[next], this.ties.ry[next]];
        this.follow(0);
      }
      this.choose(next);
    };
    const move = (dx, dy) => {
      const [view] = this.views;
      view.x += (dx * 40) / view.zoom;
      view.y += (dy * 40) / view.zoom;
      this.follow(0);
      this.draw();
    };
    const swipe = this.at.mode === "swipe";
    const slide = (by) => { this.split = Math.max(0, Math.min(1, this.split + by)); this.drawControls(); this.draw(); };
    const actions = {
      ArrowRight: () => (swipe ? slide(0.02) : step(1)), ArrowLeft: () => (swipe ? slide(-0.02) : step(-1)),
      "+": () => this.zoom(1.3), "=": () => this.zoom(1.3), "-": () => this.zoom(1 / 1.3),
      0: () => { this.views.forEach((view) => view.reset()); this.draw(); },
      w: () => move(0, -1), s: () => move(0, 1), a: () => move(-1, 0), d: () => move(1, 0),
      " ": () => { if (this.at.mode === "flicker") { this.playing = false; this.phase = 1 - this.phase; this.drawControls(); this.draw(); } },
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

/** The mark of a kind of tie point beside its name. */
function markOf(kind) {
  const forms = { correct: ["circle", { cx: 6, cy: 6, r: 4 }], unknown: ["rect", { x: 2, y: 2, width: 8, height: 8, fill: "none" }], false: ["path", { d: "M2 2L10 10M2 10L10 2" }] };
  const [tag, attributes] = forms[{ accepted: "correct", rejected: "false" }[kind] ?? kind];
  return shape("svg", { class: `kind ${kind}`, viewBox: "0 0 12 12", "aria-hidden": "true" }, shape(tag, attributes));
}
