// Two views of two images that move together; a click in each makes a pair of points, which the server keeps.
// Points are in pixels, the centre of the first pixel at (0, 0).

const ROLES = ["reference", "secondary"];
const by = (id) => document.getElementById(id);
const canvases = [by("view-0"), by("view-1")];
const say = (text, bad = false) => {
  by("say").textContent = text;
  by("say").className = bad ? "bad" : "";
};

let state = null;
let views = null;
// The point that so far has one side only: {side, xy}, and where the other side is expected.
let pending = null, expected = null, chosen = -1;

async function ask(body) {
  const answer = await fetch(body ? "act" : "state", body ? { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) } : {});
  const said = await answer.json().catch(() => ({ error: "the server refused the request" }));
  if (!answer.ok) throw new Error(said.error ?? "the server refused the request");
  return said;
}

async function act(body, done) {
  try {
    state = await ask(body);
    say(`${done} ${state.points.length} points, saved in ${state.path}`);
  } catch (error) {
    say(error.message, true);
  }
  show();
}

// ---- views

const tiles = new Map();
function tile(side, level, column, row) {
  const key = `${ROLES[side]}/${level}/${column}/${row}`;
  let image = tiles.get(key);
  if (!image) {
    image = new Image();
    image.onload = draw;
    image.src = `tile/${key}`;
    if (tiles.size > 600) tiles.delete(tiles.keys().next().value);
    tiles.set(key, image);
  }
  return image.complete && image.naturalWidth ? image : null;
}

const least = (side) => {
  const { width, height } = state.images[side], box = canvases[side];
  return Math.min(box.clientWidth / width, box.clientHeight / height);
};

function whole() {
  views = state.images.map(({ width, height }, side) => ({ x: (width - 1) / 2, y: (height - 1) / 2, zoom: least(side) }));
}

const screen = (side, [x, y]) => [canvases[side].clientWidth / 2 + (x - views[side].x) * views[side].zoom, canvases[side].clientHeight / 2 + (y - views[side].y) * views[side].zoom];
const image = (side, [u, v]) => [views[side].x + (u - canvases[side].clientWidth / 2) / views[side].zoom, views[side].y + (v - canvases[side].clientHeight / 2) / views[side].zoom];

let following = 0;
/** Show in the other view what this one shows: by the prediction where there is one, else by the share of the image. */
async function follow(side) {
  if (!by("linked").checked) return draw();
  const other = 1 - side, here = views[side], turn = ++following;
  views[other].zoom = least(other) * (here.zoom / least(side));
  const from = state.images[side], to = state.images[other];
  if (!state.model) {
    views[other].x = ((here.x + 0.5) / from.width) * to.width - 0.5;
    views[other].y = ((here.y + 0.5) / from.height) * to.height - 0.5;
    return draw();
  }
  draw();
  const place = await predict(side, [here.x, here.y]);
  // The view may have moved on meanwhile.
  if (place && turn === following) [views[other].x, views[other].y] = place;
  draw();
}

async function predict(side, xy) {
  try {
    return (await ask({ action: "predict", role: ROLES[side], xy })).xy;
  } catch {
    return null;
  }
}

let waiting = 0;
function draw() {
  waiting ||= requestAnimationFrame(() => {
    waiting = 0;
    if (views) canvases.forEach(paint);
  });
}

function paint(canvas, side) {
  const dense = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * dense) || canvas.height !== Math.round(height * dense)) {
    canvas.width = Math.round(width * dense);
    canvas.height = Math.round(height * dense);
  }
  const context = canvas.getContext("2d");
  context.setTransform(dense, 0, 0, dense, 0, 0);
  context.clearRect(0, 0, width, height);
  const { zoom } = views[side], size = state.images[side];
  const level = Math.max(0, Math.floor(Math.log2(1 / (zoom * dense)) + 1e-6)), cover = state.tile * 2 ** level;
  const [left, top] = image(side, [0, 0]), [right, bottom] = image(side, [width, height]);
  context.imageSmoothingEnabled = zoom < 3;
  const [u, v] = screen(side, [-0.5, -0.5]);
  context.save();
  context.beginPath();
  context.rect(u, v, size.width * zoom, size.height * zoom);
  context.clip();
  for (let row = Math.max(0, Math.floor((top + 0.5) / cover)); row * cover < Math.min(bottom + 0.5, size.height); row++)
    for (let column = Math.max(0, Math.floor((left + 0.5) / cover)); column * cover < Math.min(right + 0.5, size.width); column++) {
      const made = tile(side, level, column, row), [a, b] = screen(side, [column * cover - 0.5, row * cover - 0.5]);
      if (made) context.drawImage(made, a, b, cover * zoom + 0.5, cover * zoom + 0.5);
    }
  context.restore();
  marks(context, side);
}

function cross(context, [u, v], colour, text, dashed = false) {
  context.setLineDash(dashed ? [3, 3] : []);
  for (const [ink, wide] of [["#111", 4], [colour, 1.8]]) {
    context.strokeStyle = ink;
    context.lineWidth = wide;
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(u + 3 * dx, v + 3 * dy);
      context.lineTo(u + 11 * dx, v + 11 * dy);
    }
    context.stroke();
  }
  context.setLineDash([]);
  context.font = "600 13px system-ui, sans-serif";
  context.lineWidth = 3.5;
  context.strokeStyle = "#111";
  context.strokeText(text, u + 9, v - 8);
  context.fillStyle = colour;
  context.fillText(text, u + 9, v - 8);
}

function marks(context, side) {
  state.points.forEach((point, k) => cross(context, screen(side, point[ROLES[side]]), k === chosen ? "#fff" : "#00e0b4", String(k + 1)));
  if (pending?.side === side) cross(context, screen(side, pending.xy), "#ffd23f", String(state.points.length + 1));
  else if (expected) cross(context, screen(side, expected), "#ffd23f", "expected", true);
  if (document.activeElement === canvases[side]) cross(context, [canvases[side].clientWidth / 2, canvases[side].clientHeight / 2], "#ffffff", "");
}

// ---- marking

async function mark(side, xy) {
  const { width, height } = state.images[side];
  if (!(xy[0] >= -0.5 && xy[1] >= -0.5 && xy[0] <= width - 0.5 && xy[1] <= height - 0.5)) return say("that lies outside the image", true);
  if (pending && pending.side !== side) {
    const pair = { [ROLES[side]]: xy, [ROLES[pending.side]]: pending.xy };
    pending = expected = null;
    return act({ action: "add", ...pair }, "Marked.");
  }
  pending = { side, xy };
  expected = null;
  show();
  say(`Now the same place in the ${ROLES[1 - side]}.`);
  const place = await predict(side, xy);
  // The point may have got its other side meanwhile, or have been dropped.
  if (pending?.xy !== xy) return;
  expected = place;
  if (expected) {
    const other = views[1 - side], [u, v] = screen(1 - side, expected), canvas = canvases[1 - side];
    if (u < 0 || v < 0 || u > canvas.clientWidth || v > canvas.clientHeight) [other.x, other.y] = expected;
    say(`Now the same place in the ${ROLES[1 - side]}: it is expected at the dashed cross.`);
  }
  draw();
}

function cancel() {
  pending = expected = null;
  say("");
  show();
}

function near(side, place) {
  let best = 12, found = -1;
  state.points.forEach((point, k) => {
    const [u, v] = screen(side, point[ROLES[side]]), d = Math.hypot(u - place[0], v - place[1]);
    if (d < best) [best, found] = [d, k];
  });
  return found;
}

canvases.forEach((canvas, side) => {
  let drag = null, pinch = null;
  const fingers = new Map();
  const spread = () => {
    const [[a, b], [c, d]] = [...fingers.values()];
    return { apart: Math.max(1, Math.hypot(c - a, d - b)), middle: [(a + c) / 2, (b + d) / 2] };
  };
  const spot = (event) => [event.offsetX, event.offsetY];
  canvas.addEventListener("pointerdown", (event) => {
    if (!views || event.button) return;
    const place = spot(event);
    fingers.set(event.pointerId, place);
    if (fingers.size === 2) {
      // Two fingers zoom and move; whatever the first had begun is no mark.
      drag = null;
      pinch = spread();
      return;
    }
    drag = { start: place, last: place, moved: false, point: near(side, place) };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (pinch && fingers.has(event.pointerId)) {
      fingers.set(event.pointerId, spot(event));
      const now = spread();
      views[side].x -= (now.middle[0] - pinch.middle[0]) / views[side].zoom;
      views[side].y -= (now.middle[1] - pinch.middle[1]) / views[side].zoom;
      zoom(side, now.apart / pinch.apart, now.middle);
      pinch = now;
      return;
    }
    if (!drag) return;
    const place = spot(event);
    drag.moved ||= Math.hypot(place[0] - drag.start[0], place[1] - drag.start[1]) > 4;
    if (!drag.moved) return;
    if (drag.point >= 0) state.points[drag.point][ROLES[side]] = image(side, place);
    else {
      if (pending && pending.side !== side) pending.moved = true;
      views[side].x -= (place[0] - drag.last[0]) / views[side].zoom;
      views[side].y -= (place[1] - drag.last[1]) / views[side].zoom;
      follow(side);
    }
    drag.last = place;
    draw();
  });
  const lifted = (event) => {
    fingers.delete(event.pointerId);
    if (fingers.size < 2) pinch = null;
  };
  canvas.addEventListener("pointerup", (event) => {
    lifted(event);
    if (!drag) return;
    const { moved, point } = drag, xy = image(side, spot(event));
    drag = null;
    if (!moved) mark(side, xy);
    else if (point >= 0) act({ action: "move", index: point, role: ROLES[side], xy }, "Moved.");
  });
  canvas.addEventListener("pointercancel", (event) => { lifted(event); drag = null; });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(side, Math.exp(-event.deltaY * 0.0015), spot(event));
  }, { passive: false });
  canvas.addEventListener("focus", draw);
  canvas.addEventListener("blur", draw);
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !views) return;
    const move = (dx, dy) => {
      if (pending && pending.side !== side) pending.moved = true;
      views[side].x += (dx * (event.shiftKey ? 1 : 40)) / views[side].zoom;
      views[side].y += (dy * (event.shiftKey ? 1 : 40)) / views[side].zoom;
      follow(side);
    };
    const middle = [canvas.clientWidth / 2, canvas.clientHeight / 2];
    const action = {
      ArrowLeft: () => move(-1, 0), ArrowRight: () => move(1, 0), ArrowUp: () => move(0, -1), ArrowDown: () => move(0, 1),
      "+": () => zoom(side, 1.3, middle), "=": () => zoom(side, 1.3, middle), "-": () => zoom(side, 1 / 1.3, middle),
      Enter: () => {
        // The view has come to where the point is expected: taking that would pull the truth towards the model.
        if (pending && pending.side !== side && !pending.moved) return say("Move the cross in the middle to the place with the arrows first: what is expected there is no measurement.", true);
        mark(side, [views[side].x, views[side].y]);
      }, Escape: cancel,
    }[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
});

function zoom(side, factor, place) {
  const view = views[side], [x, y] = image(side, place), before = view.zoom;
  view.zoom = Math.max(least(side) * 0.5, Math.min(64, view.zoom * factor));
  const part = before / view.zoom;
  [view.x, view.y] = [x + (view.x - x) * part, y + (view.y - y) * part];
  follow(side);
}

// ---- the list

const told = (value) => (value === null ? "–" : value.toFixed(2));
const cell = (text, name = "") => Object.assign(document.createElement("td"), { textContent: text, className: name });

function show() {
  const given = state.points.map((point) => point.left_out ?? -1), worst = Math.max(...given);
  by("points").replaceChildren(...state.points.map((point, k) => {
    const row = document.createElement("tr"), button = Object.assign(document.createElement("button"), { type: "button", textContent: "Delete" });
    button.setAttribute("aria-label", `Delete point ${k + 1}`);
    button.addEventListener("click", () => act({ action: "delete", index: k }, "Deleted."));
    const last = document.createElement("td");
    last.append(button);
    const poor = given.length > 4 && given[k] === worst && worst > 1;
    row.append(cell(String(k + 1)), ...ROLES.map((role) => cell(point[role].map((v) => v.toFixed(2)).join(", "))),
      cell(told(point.residual)), cell(told(point.left_out) + (poor ? " (worst)" : ""), poor ? "worst" : ""), last);
    row.addEventListener("pointerenter", () => { chosen = k; draw(); });
    row.addEventListener("pointerleave", () => { chosen = -1; draw(); });
    return row;
  }));
  const known = state.points.map((point) => point.residual).filter((v) => v !== null);
  const rms = known.length ? Math.sqrt(known.reduce((sum, v) => sum + v * v, 0) / known.length) : null;
  by("fit").textContent = state.model ? `${state.model.kind}${state.model.given ? " as given" : ""}${rms === null ? "" : `, RMS ${rms.toFixed(2)} px`}` : "two points more and the next is predicted";
  by("undo").disabled = !state.undo;
  by("redo").disabled = !state.redo;
  by("cancel").disabled = !pending;
  draw();
}

by("undo").addEventListener("click", () => act({ action: "undo" }, "Undone."));
by("redo").addEventListener("click", () => act({ action: "redo" }, "Redone."));
by("cancel").addEventListener("click", cancel);
by("whole").addEventListener("click", () => { whole(); draw(); });
addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey)) return;
  const again = event.key === "y" || (event.key === "Z" && event.shiftKey), back = event.key === "z";
  if (!again && !back) return;
  event.preventDefault();
  act({ action: again ? "redo" : "undo" }, again ? "Redone." : "Undone.");
});
new ResizeObserver(draw).observe(canvases[0]);

ask().then((first) => {
  state = first;
  whole();
  by("file").textContent = `saved after every step in ${state.path}`;
  state.images.forEach(({ name, width, height }, side) => { by(`name-${side}`).textContent = `${ROLES[side]}: ${name}, ${width} × ${height}`; });
  say("Click a place in one image, then the same place in the other.");
  show();
  document.documentElement.dataset.ready = "1";
}, (error) => say(error.message, true));
