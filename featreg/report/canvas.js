// Drawing on canvases: views of images that zoom and pan, tie points, aligned pictures.
// Points are in pixels of the images, the centre of the first pixel at (0, 0).

const COLOURS = { correct: "#00cda5", false: "#ff6b1a", accepted: "#00cda5", rejected: "#ff6b1a", unknown: "#f2f2f2" };
const RIM = "rgba(20,20,20,.85)";

/** Where a panel of a canvas shows an image: `x`, `y` in the panel's middle, `zoom` canvas pixels per image pixel. */
class View {
  constructor(size) {
    this.size = size;
    this.box = [0, 0, 1, 1];
    this.reset();
  }

  reset() {
    [this.x, this.y] = [(this.size[0] - 1) / 2, (this.size[1] - 1) / 2];
    this.zoom = Math.min(this.box[2] / this.size[0], this.box[3] / this.size[1]);
  }

  place(box) {
    const whole = Math.abs(this.zoom - Math.min(this.box[2] / this.size[0], this.box[3] / this.size[1])) < 1e-9;
    this.box = box;
    if (whole) this.reset();
  }

  get least() {
    return Math.min(this.box[2] / this.size[0], this.box[3] / this.size[1]);
  }

  screen(x, y) {
    const [left, top, width, height] = this.box;
    return [left + width / 2 + (x - this.x) * this.zoom, top + height / 2 + (y - this.y) * this.zoom];
  }

  image(u, v) {
    const [left, top, width, height] = this.box;
    return [this.x + (u - left - width / 2) / this.zoom, this.y + (v - top - height / 2) / this.zoom];
  }

  holds(u, v) {
    const [left, top, width, height] = this.box;
    return u >= left && u < left + width && v >= top && v < top + height;
  }

  /** Enlarge by a factor about a place on the screen. */
  enlarge(factor, u, v) {
    const [x, y] = this.image(u, v), before = this.zoom;
    this.zoom = Math.max(this.least * 0.5, Math.min(64, this.zoom * factor));
    const part = before / this.zoom;
    [this.x, this.y] = [x + (this.x - x) * part, y + (this.y - y) * part];
  }
}

/** Keep what is drawn within a view's panel. */
function clipped(context, view, draw) {
  context.save();
  context.beginPath();
  context.rect(...view.box);
  context.clip();
  draw();
  context.restore();
}

/** A picture that stands for `extent` pixels of its image. */
function drawPicture(context, canvas, extent, view, dim = 1) {
  const [x, y] = view.screen(-0.5, -0.5);
  context.imageSmoothingEnabled = view.zoom * (extent[0] / canvas.width) < 3;
  context.globalAlpha = dim;
  context.drawImage(canvas, x, y, extent[0] * view.zoom, extent[1] * view.zoom);
  context.globalAlpha = 1;
}

/** What to call a tie point: by the truth where there is one, else by whether it is among the final ones. */
function kindOfPoint(ties, k, truth) {
  const flags = ties.flags[k];
  if (!truth) return flags & FLAG.inlier ? "accepted" : "rejected";
  return flags & FLAG.judged ? (flags & FLAG.correct ? "correct" : "false") : "unknown";
}

/** Marks that differ in form as well as in colour: a dot is right, a cross is wrong, a square is not known. */
function drawMarks(context, kind, places, size = 3.2) {
  const path = new Path2D();
  for (const [u, v] of places) {
    if (kind === "correct" || kind === "accepted") {
      path.moveTo(u + size, v);
      path.arc(u, v, size, 0, 7);
    } else if (kind === "unknown") path.rect(u - size, v - size, 2 * size, 2 * size);
    else {
      path.moveTo(u - size, v - size);
      path.lineTo(u + size, v + size);
      path.moveTo(u - size, v + size);
      path.lineTo(u + size, v - size);
    }
  }
  const filled = kind === "correct" || kind === "accepted";
  context.lineJoin = "round";
  context.strokeStyle = RIM;
  context.lineWidth = filled ? 1.6 : 3.6;
  context.stroke(path);
  if (filled) {
    context.fillStyle = COLOURS[kind];
    context.fill(path);
  } else {
    context.strokeStyle = COLOURS[kind];
    context.lineWidth = 1.7;
    context.stroke(path);
  }
}

/** A ring around the point that is looked at. */
function drawRing(context, u, v) {
  for (const [colour, width] of [["#111", 5], ["#fff", 2]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.arc(u, v, 8, 0, 7);
    context.stroke();
  }
}

/** A note in a corner of a panel. */
function drawNote(context, text, view, right = false, bottom = false) {
  const [left, top, width, height] = view.box;
  context.font = "600 12px system-ui, sans-serif";
  const wide = context.measureText(text).width + 14;
  const x = right ? left + width - wide - 6 : left + 6, y = bottom ? top + height - 28 : top + 6;
  context.fillStyle = "rgba(12,14,18,.78)";
  context.fillRect(x, y, wide, 22);
  context.fillStyle = "#fff";
  context.textBaseline = "middle";
  context.fillText(text, x + 7, y + 11.5);
}

/** The secondary picture on the reference's grid, transparent where it has nothing: output[p] = secondary[map(p)]. */
function alignedPicture(reference, secondary, map) {
  const { width, height } = reference, pixels = new ImageData(width, height), out = new Uint32Array(pixels.data.buffer);
  const fx = reference.extent[0] / width, fy = reference.extent[1] / height;
  const gx = secondary.width / secondary.extent[0], gy = secondary.height / secondary.extent[1];
  const { gray, width: sw, height: sh } = secondary;
  // The map is evaluated on every eighth pixel and interpolated between: it has no finer detail than its lattice.
  const step = 8;
  for (let j = 0; j < height; j++) {
    const y = (j + 0.5) * fy - 0.5;
    for (let i0 = 0; i0 < width; i0 += step) {
      const [x0, y0] = map((i0 + 0.5) * fx - 0.5, y), [x1, y1] = map((i0 + step + 0.5) * fx - 0.5, y);
      for (let i = i0; i < Math.min(width, i0 + step); i++) {
        const part = (i - i0) / step;
        const u = (x0 + part * (x1 - x0) + 0.5) * gx - 0.5, v = (y0 + part * (y1 - y0) + 0.5) * gy - 0.5;
        if (!(u > -0.5 && v > -0.5 && u < sw - 0.5 && v < sh - 0.5)) continue;
        const a = Math.max(0, Math.min(sw - 2, Math.floor(u))), b = Math.max(0, Math.min(sh - 2, Math.floor(v)));
        const p = Math.max(0, Math.min(1, u - a)), q = Math.max(0, Math.min(1, v - b)), k = b * sw + a;
        const value = (1 - q) * ((1 - p) * gray[k] + p * gray[k + 1]) + q * ((1 - p) * gray[k + sw] + p * gray[k + sw + 1]);
        out[j * width + i] = 0xff000000 | (Math.round(value) * 0x010101);
      }
    }
  }
  return { canvas: canvasOf(pixels), pixels };
}

function canvasOf(pixels) {
  const canvas = el("canvas", { width: pixels.width, height: pixels.height });
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}

/** Reference magenta, secondary green: what agrees is gray or white. */
function overlaid(reference, aligned) {
  const pixels = new ImageData(reference.width, reference.height), from = aligned.pixels.data, to = pixels.data;
  for (let k = 0; k < reference.gray.length; k++) {
    to[4 * k] = to[4 * k + 2] = reference.gray[k];
    to[4 * k + 1] = from[4 * k + 3] ? from[4 * k + 1] : reference.gray[k] >> 1;
    to[4 * k + 3] = 255;
  }
  return canvasOf(pixels);
}

/** Arrows from each point along its residual, `gain` times enlarged. */
function drawArrows(context, kind, arrows) {
  const path = new Path2D();
  for (const [u, v, du, dv, cut] of arrows) {
    const length = Math.hypot(du, dv), head = Math.min(6, length / 2);
    path.moveTo(u, v);
    path.lineTo(u + du, v + dv);
    if (length < 3 || cut) continue;
    const cx = (du / length) * head, cy = (dv / length) * head;
    path.moveTo(u + du - cx + cy * 0.6, v + dv - cy - cx * 0.6);
    path.lineTo(u + du, v + dv);
    path.lineTo(u + du - cx - cy * 0.6, v + dv - cy + cx * 0.6);
  }
  context.setLineDash(kind === "false" || kind === "rejected" ? [5, 3] : []);
  for (const [colour, width] of [[RIM, 3.4], [COLOURS[kind], 1.6]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke(path);
  }
  context.setLineDash([]);
}
