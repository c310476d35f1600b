// How the viewer is handled: reading tie points, zooming and moving, by mouse and by keys.

class Handling extends Painting {
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

  /** Two fingers went apart or together, and moved. */
  pinched({ factor, middle, by }) {
    if (!this.views) return;
    const side = this.at.mode === "matches" && this.views[1].holds(...middle) ? 1 : 0, view = this.views[side];
    view.x -= by[0] / view.zoom;
    view.y -= by[1] / view.zoom;
    view.enlarge(factor, ...middle);
    this.follow(side);
    this.draw();
  }

  listen() {
    const { canvas } = this;
    let drag = null;
    const fingers = new Fingers();
    const spot = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.views || event.button) return;
      const [u, v] = spot(event);
      fingers.down(event, [u, v]);
      if (fingers.two) {
        drag = null;
        return;
      }
      drag = { u, v, side: this.at.mode === "matches" && this.views[1].holds(u, v) ? 1 : 0, swipe: this.at.mode === "swipe" && !event.shiftKey && Math.abs(u - this.split * this.stage.clientWidth) < 24 };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const [u, v] = spot(event), pinch = fingers.moved(event, [u, v]);
      if (pinch) return this.pinched(pinch);
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
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => { drag = null; fingers.up(event); });
    canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; });
    canvas.addEventListener("wheel", (event) => {
      // The page scrolls until somebody has turned to the picture.
      if (document.activeElement !== canvas && !event.ctrlKey) {
        this.details.textContent = "To zoom by the wheel, click the picture first or hold Ctrl.";
        return;
      }
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
