// What the canvas of the viewer shows: the views of `MODES`, drawn from the state that `Viewer` keeps.

const MODES = [
  ["matches", "Matches"], ["swipe", "Swipe"], ["flicker", "Flicker"],
  ["checker", "Checkerboard"], ["overlay", "Overlay"], ["residuals", "Residuals"],
];
// Screen pixels at which an arrow is cut.
const LONGEST_ARROW = 90;

class Painting {
  resize() {
    const width = this.stage.clientWidth;
    if (!width) return;
    const pictures = this.views && this.pictures, one = this.at.mode !== "matches", ratio = (size) => size[1] / size[0];
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
    // Another pair was chosen, and its pictures are on their way.
    if (!this.views) return;
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
}
