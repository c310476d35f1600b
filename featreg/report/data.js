// The study, and the pictures and tie points that are unpacked only when somebody looks at them.

const study = JSON.parse(document.getElementById("study").textContent);

const FLAG = { inlier: 1, scored: 2, correct: 4, judged: 8, refined: 16 };
// The columns of packed tie points, in order: name and kind.
const COLUMNS = [
  ["rx", "u2"], ["ry", "u2"], ["sx", "u2"], ["sy", "u2"],
  ["dx", "f2"], ["dy", "f2"], ["error", "f2"], ["score", "f4"], ["lost", "u1"], ["flags", "u1"],
];

function bytesOf(id) {
  const text = atob(document.getElementById(id).textContent);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes;
}

function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return exponent ? sign * 2 ** (exponent - 25) * (1024 + fraction) : sign * 2 ** -24 * fraction;
}

/** The columns of `count` rows from bytes in planes: all lowest bytes of a column first, the highest last. */
function columnsOf(bytes, count) {
  const found = {};
  let at = 0;
  for (const [name, kind] of COLUMNS) {
    const width = Number(kind[1]);
    const values = kind[0] === "u" ? new Uint16Array(count) : new Float32Array(count);
    const bits = new DataView(new ArrayBuffer(4));
    for (let k = 0; k < count; k++) {
      let value = 0;
      for (let b = width - 1; b >= 0; b--) value = value * 256 + bytes[at + b * count + k];
      if (kind === "f2") value = half(value);
      if (kind === "f4") {
        bits.setUint32(0, value);
        value = bits.getFloat32(0);
      }
      values[k] = value;
    }
    found[name] = values;
    at += width * count;
  }
  return found;
}

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The tie points of an entry, in pixels. */
async function pointsOf(entry) {
  const given = entry.points;
  const packed = columnsOf(await inflate(bytesOf(given.blob)), given.shown);
  const [first, second] = given.origins;
  // The rows stand from top to bottom, and y is stored as the step from the one above.
  for (let k = 1; k < given.shown; k++) packed.ry[k] += packed.ry[k - 1];
  const place = (stored, step, origin) => Float64Array.from(stored, (value) => origin + step * value);
  return {
    count: given.shown,
    rx: place(packed.rx, given.steps[0], first[0]),
    ry: place(packed.ry, given.steps[0], first[1]),
    sx: place(packed.sx, given.steps[1], second[0]),
    sy: place(packed.sy, given.steps[1], second[1]),
    dx: packed.dx, dy: packed.dy, error: packed.error, score: packed.score, lost: packed.lost, flags: packed.flags,
  };
}

function decoded(id) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error("a picture of this page cannot be shown"));
    image.src = `data:image/webp;base64,${document.getElementById(id).textContent}`;
  });
}

/** A picture with its gray values: `size` and `extent` are in pixels of the image it stands for. */
async function pictureOf(given) {
  const image = await decoded(given.blob);
  const canvas = el("canvas", { width: image.naturalWidth, height: image.naturalHeight });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  const rgba = context.getImageData(0, 0, canvas.width, canvas.height).data;
  const gray = new Uint8Array(canvas.width * canvas.height);
  for (let k = 0; k < gray.length; k++) gray[k] = rgba[4 * k];
  return { canvas, gray, width: canvas.width, height: canvas.height, size: given.size, extent: given.extent };
}

/** Results of `make` by key, the latest `room` of them. */
function remembered(room, make) {
  const kept = new Map();
  return (key) => {
    const value = kept.get(key) ?? make(key);
    kept.delete(key);
    kept.set(key, value);
    if (kept.size > room) kept.delete(kept.keys().next().value);
    return value;
  };
}

const picturesOf = remembered(4, (pair) => Promise.all(study.pairs[pair].images.map(pictureOf)));
const tiesOf = remembered(12, (entry) => pointsOf(study.entries[entry]));

/** A map from the nodes of a lattice over an image of `size`: (x, y) -> [x, y], NaN where it is not known. */
function mapOf(lattice, size) {
  if (!lattice) return null;
  const [columns, rows, values] = lattice;
  const sx = (columns - 1) / Math.max(1, size[0] - 1), sy = (rows - 1) / Math.max(1, size[1] - 1);
  const nodes = Float64Array.from(values, (value) => (value === null ? NaN : value));
  return (x, y) => {
    const u = x * sx, v = y * sy;
    const i = Math.max(0, Math.min(columns - 2, Math.floor(u))), j = Math.max(0, Math.min(rows - 2, Math.floor(v)));
    const a = u - i, b = v - j, k = 2 * (j * columns + i), below = k + 2 * columns;
    const at = (n) =>
      (1 - b) * ((1 - a) * nodes[k + n] + a * nodes[k + 2 + n]) + b * ((1 - a) * nodes[below + n] + a * nodes[below + 2 + n]);
    return [at(0), at(1)];
  };
}

/** Where a map reaches a point, by Newton's method from `start`. */
function solve(map, target, start) {
  let [x, y] = start;
  for (let k = 0; k < 8; k++) {
    const [u, v] = map(x, y), [ux, vx] = map(x + 1, y), [uy, vy] = map(x, y + 1);
    const a = ux - u, b = uy - u, c = vx - v, d = vy - v, det = a * d - b * c;
    if (!Number.isFinite(det) || Math.abs(det) < 1e-9) break;
    const ex = target[0] - u, ey = target[1] - v;
    x += (d * ex - b * ey) / det;
    y += (a * ey - c * ex) / det;
    if (Math.abs(ex) + Math.abs(ey) < 1e-3) break;
  }
  return [x, y];
}
