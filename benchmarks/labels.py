"""How good the labels of optical-SAR pairs are, and how good `sar-dense` is on them, without trusting either.

    python benchmarks/labels.py [--pairs 40] [--seed 0] [--sure 1.5]

Corners: the label (the outline of a turned square), `sar-dense`, and the similarity at which the mutual information of
the intensities is highest, looked for from the label and from `sar-dense`. Where both searches, and those in two halves
of the pixels, end within `--sure` px of each other, the three are witnesses of their own: from a black rim, from the
directions of structure, from grey values. From the mean squares of their three differences follows the error of each
(the three-cornered hat): that of the label is (label-dense + label-information - dense-information) / 2. Errors in
common would be missed.

Halves: how far apart the models of two halves of the windows of `sar-dense` lie, which asks neither; half of it is
about the error of the model of all.

J. E. Gray, D. W. Allan, "A method for estimating the frequency stability of an individual oscillator", 28th Annual
Symposium on Frequency Control (1974) 243, DOI 10.1109/FREQ.1974.200027, of the hat. C. Studholme, D. L. G. Hill,
D. J. Hawkes, "An overlap invariant entropy measure of 3D medical image alignment", Pattern Recognition 32 (1999) 71,
DOI 10.1016/S0031-3203(98)00091-0, of normalised mutual information.
"""

from __future__ import annotations

import argparse
from copy import copy
from typing import Any

import cv2
import numpy as np
from measuring import DATA, machine, on_one_thread, table
from numpy.typing import NDArray
from optical_sar import known_pairs
from pair_protocol import KnownPair
from scipy.optimize import minimize

import featreg
from featreg.geometry import Affine, Similarity
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit

#: Standard deviation of the smoothing before grey values are compared, px of the secondary, and grey levels.
SMOOTH, LEVELS = 2.0, 24
#: First steps of the search: scale and turn as px at the rim of the secondary, shift in px.
FIRST_PX = 3.0
RESAMPLES = 2000
F64 = NDArray[np.float64]


def lattice(shape: tuple[int, ...]) -> F64:
    """(225, 2) points of a 15 x 15 grid over an image."""
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, 15), np.linspace(0, shape[0] - 1, 15))
    return np.column_stack([x.ravel(), y.ravel()])


def square_apart(one: Any, other: Any, pair: KnownPair) -> float:
    """Mean square distance of two models over what the secondary shows of the reference, px^2 of the secondary."""
    points = lattice(pair.reference.shape)
    there = one(points)
    shown = ((there >= 0) & (there <= np.array(pair.secondary.shape[::-1]) - 1)).all(axis=1)
    return float(((there[shown] - other(points[shown])) ** 2).sum(axis=1).mean())


class Information:
    """Normalised mutual information of a pair under a map reference -> secondary, on the secondary's pixels."""

    def __init__(self, pair: KnownPair) -> None:
        ratio = pair.reference.shape[1] / pair.secondary.shape[1]
        self.reference, self.secondary = (
            cv2.GaussianBlur(view.astype(np.float32), (0, 0), max(sigma, 0.5))
            for view, sigma in ((pair.reference, SMOOTH * ratio), (pair.secondary, SMOOTH))
        )
        seen = np.ones(pair.secondary.shape, np.bool_) if pair.secondary_mask is None else pair.secondary_mask
        self.seen = cv2.erode(seen.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        self.levels = [self.ranked(view) for view in (self.reference, self.secondary[self.seen])]

    @staticmethod
    def ranked(view: NDArray[Any]) -> F64:
        """Limits between grey levels that are equally frequent."""
        return np.asarray(np.quantile(view, np.linspace(0, 1, LEVELS + 1)[1:-1]), np.float64)

    def half(self, which: int) -> Information:
        """That of every other square of a chessboard."""
        part = copy(self)
        y, x = np.indices(self.seen.shape) // (len(self.seen) // 4)
        part.seen = self.seen & ((x + y) % 2 == which)
        return part

    def __call__(self, matrix: F64) -> float:
        size = self.secondary.shape[::-1]
        moved = cv2.warpAffine(self.reference, matrix, size, flags=cv2.INTER_LINEAR, borderValue=-1)
        good = self.seen & (moved >= 0)
        one, other = (
            np.searchsorted(limits, view[good])
            for limits, view in zip(self.levels, (moved, self.secondary), strict=True)
        )
        joint = np.bincount(one * LEVELS + other, minlength=LEVELS**2).reshape(LEVELS, LEVELS) / max(good.sum(), 1)

        def entropy(p: F64) -> float:
            return float(-(p[p > 0] * np.log(p[p > 0])).sum())

        return (entropy(joint.sum(axis=0)) + entropy(joint.sum(axis=1))) / max(entropy(joint), 1e-9)

    def highest(self, start: F64) -> tuple[float, F64]:
        """The highest value near a start, and the similarity that has it."""
        middle = np.array(self.secondary.shape[::-1]) / 2
        rim = float(max(middle))

        def moved(step: F64) -> F64:
            linear = np.array([[1 + step[0] / rim, -step[1] / rim], [step[1] / rim, 1 + step[0] / rim]])
            return np.column_stack([linear @ start[:, :2], linear @ (start[:, 2] - middle) + middle + step[2:]])

        simplex = np.vstack([np.zeros(4), FIRST_PX * np.eye(4)])

        def lost(step: F64) -> float:
            return -self(moved(step))

        options: Any = {"initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-7, "maxfev": 250}
        found: Any = minimize(lost, np.zeros(4), method="Nelder-Mead", options=options)
        return -float(found.fun), moved(found.x)


def halves(made: featreg.Registration, pair: KnownPair) -> float | None:
    """Root mean square distance of the models of two halves of the tie points, the colours of a chessboard."""
    here, there = made.matches.reference_xy, made.matches.secondary_xy
    board = (here // (max(pair.reference.shape) / 4)).sum(axis=1) % 2 == 0
    one, other = (irls(Similarity, here[half], there[half], scale_px=0.3, iterations=8)[0] for half in (board, ~board))
    if isinstance(one, FailedFit) or isinstance(other, FailedFit):
        return None
    return float(np.sqrt(square_apart(one, other, pair)))


def errors(squares: F64) -> F64:
    """Errors of label, dense and information from mean squares (label-dense, label-information, dense-information)."""
    ld, li, di = squares
    return np.sqrt(np.maximum(np.array([ld + li - di, ld + di - li, li + di - ld]) / 2, 0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sure", type=float, default=1.5, help="px between searches of one pair, at most")
    given = parser.parse_args()
    print(f"{machine()}; seed {given.seed}\n")
    apart, from_label, squares = [], [], []
    for pair in known_pairs([DATA / "optical_sar"], "outline", given.pairs):
        made = featreg.match(
            pair.reference, pair.secondary, method="sar-dense", model="similarity", seed=given.seed,
            secondary_mask=pair.secondary_mask,
        )  # fmt: skip
        if made.status != "ok" or made.model.matrix is None:
            continue
        label = Affine(pair.truth)
        from_label.append(square_apart(label, made.model, pair))
        half = halves(made, pair)
        if half is not None:
            apart.append(half)
        information = Information(pair)
        ends = [information.highest(start) for start in (pair.truth, made.model.matrix[:2])]
        best = Affine(max(ends, key=lambda end: end[0])[1])
        parts = [information.half(which).highest(best.matrix[:2])[1] for which in (0, 1)]
        others = [Affine(matrix) for matrix in (*(matrix for _, matrix in ends), *parts)]
        if max(square_apart(best, other, pair) for other in others) <= given.sure**2:
            corners = (label, made.model), (label, best), (made.model, best)
            squares.append([square_apart(first, second, pair) for first, second in corners])
    quartiles = [float(q) for q in np.quantile(np.sqrt(from_label), [0.25, 0.5, 0.75])] if from_label else ["-"] * 3
    middle = [float(q) for q in np.quantile(apart, [0.25, 0.5, 0.75])] if apart else ["-"] * 3
    print(
        table(
            ("px", "pairs", "quartile", "median", "quartile"),
            [["label to sar-dense", len(from_label), *quartiles], ["halves of sar-dense", len(apart), *middle]],
        )
    )
    if len(squares) < 3:
        print("\nthe mutual information is sure on fewer than three pairs: no corners")
        return
    values = np.array(squares)
    rng = np.random.default_rng(given.seed)
    drawn = np.array([errors(values[rng.integers(0, len(values), len(values))].mean(axis=0)) for _ in range(RESAMPLES)])
    between, own = np.sqrt(values.mean(axis=0)), errors(values.mean(axis=0))
    print(f"\n{len(values)} pairs with three corners; root mean squares, 95 % of the bootstrap over pairs\n")
    names = ("label to sar-dense", "label to information", "sar-dense to information")
    print(table(("difference", "px"), list(zip(names, between.tolist(), strict=True))))
    rows = [
        [name, float(value), "{:.2f} to {:.2f}".format(*np.quantile(column, [0.025, 0.975]))]
        for name, value, column in zip(("label", "sar-dense", "information"), own, drawn.T, strict=True)
    ]
    print(f"\n{table(('error of', 'px', 'interval'), rows)}")


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
