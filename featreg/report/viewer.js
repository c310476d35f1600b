// One pair and one method at a time: tie points over both images, and the aligned pair in several ways.

const KEYS = "Arrow left and right step through the tie points, plus and minus zoom, 0 shows the whole image, W A S D move it.";

const READ = "Point at a tie point, or use the arrow keys, to read it.";

class Viewer extends Handling {
  constructor() {
    super();
    this.at = { pair: 0, method: study.entries[0]?.method ?? 0, seed: study.entries[0]?.seed ?? 0, mode: "matches", set: study.pairs.some((pair) => pair.truth) ? "scored" : "final" };
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
    this.details = el("output", { class: "point", "aria-live": "polite" }, READ);
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
          el("p", { class: "note", id: "viewer-keys" }, `Wheel and drag, or two fingers, zoom and move both images together. ${KEYS}`),
          el("p", { class: "downloads" }, pictureDownload(() => this.canvas, () => `${study.methods[this.at.method]}-${study.pairs[this.at.pair]?.name}-${this.at.mode}`, "Save this view as PNG"))),
        this.side),
      ...printButton(this));
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
      this.tip.hidden = true;
      this.details.textContent = READ;
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
      if (shown < total) parts.push(el("p", { class: "note" }, `${shown} of ${total} are on this page, scored and final ones first.`));
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
}

/** The mark of a kind of tie point beside its name. */
function markOf(kind) {
  const forms = { correct: ["circle", { cx: 6, cy: 6, r: 4 }], unknown: ["rect", { x: 2, y: 2, width: 8, height: 8, fill: "none" }], false: ["path", { d: "M2 2L10 10M2 10L10 2" }] };
  const [tag, attributes] = forms[{ accepted: "correct", rejected: "false" }[kind] ?? kind];
  return shape("svg", { class: `kind ${kind}`, viewBox: "0 0 12 12", "aria-hidden": "true" }, shape(tag, attributes));
}
