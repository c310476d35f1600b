// Two fingers on a picture: they zoom it and move it.

/** Fingers that rest on a canvas. */
class Fingers {
  constructor() {
    this.at = new Map();
  }

  down(event, spot) {
    this.at.set(event.pointerId, spot);
  }

  up(event) {
    this.at.delete(event.pointerId);
  }

  /** Whether two fingers are down, so that nothing is dragged by one. */
  get two() {
    return this.at.size === 2;
  }

  /** A finger moved: by which factor the two went apart, their middle, and by how much that moved; null for one. */
  moved(event, spot) {
    if (!this.at.has(event.pointerId)) return null;
    const before = this.spread();
    this.at.set(event.pointerId, spot);
    const after = this.spread();
    if (!before || !after) return null;
    return { factor: after.apart / Math.max(before.apart, 1), middle: after.middle, by: [after.middle[0] - before.middle[0], after.middle[1] - before.middle[1]] };
  }

  spread() {
    if (!this.two) return null;
    const [[a, b], [c, d]] = [...this.at.values()];
    return { apart: Math.hypot(c - a, d - b), middle: [(a + c) / 2, (b + d) / 2] };
  }
}
