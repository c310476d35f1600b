"""The adjustment of a network of pairs: one model for each image that agrees with all pairs as well as can be."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.geometry import Affine, Homography, Polynomial3, ResidualField, Rigid, Similarity, Translation
from featreg.geometry.base import DerivedModel
from featreg.interfaces import FailedFit, Model
from featreg.stacks.pairs import THROWN_OUT, StackPair
from featreg.types import FloatArray

#: A pair this many standard deviations off has half its weight (Geman and McClure), at the end; the adjustment begins
#: with so wide a limit that all count, and halves it, so that a wrong pair cannot pull the others to itself.
LIMIT = 3.0
#: Rounds at each limit, and nodes along each side of the reference from which the final models are made.
ROUNDS, DENSE = 2, 15
#: The same for residual fields: eight points in each of their 12 x 12 cells.
DENSE_FIELD = 36
#: Largest distance, px, of an affine map from the adjusted points for which it stands for them.
BENT_PX = 0.02


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What an adjustment found.

    Parameters
    ----------
    models : reference -> image, None where no trusted pair leads to the image
    standard_errors : px, of where each model maps points, along one axis, RMS over the image; NaN without a model
    pairs : with weights and misfits
    unit : variance of the disagreement of pairs over what their own covariances say
    """

    models: list[Model | None]
    standard_errors: FloatArray
    pairs: list[StackPair]
    unit: float


def adjust(
    pairs: Sequence[StackPair], count: int, reference: int, shape: tuple[int, int], kind: type[Model]
) -> Adjusted:
    """Adjust the models of all images at once.

    Parameters
    ----------
    pairs : of the stack; those that are not trusted are passed over
    count : how many images
    reference : number of the reference
    shape : (H, W) of the reference
    kind : class of the models

    Returns
    -------
    Adjusted

    Notes
    -----
    The unknowns are a correction of each image's model, linear in its own parameters (affine for models that have
    none), around what a path of the best pairs says. A pair i-k says at each of its nodes p in image i that
    M_k(M_i^-1(p)) = M_ik(p), with its covariance there; together its nodes weigh as much as the parameters they
    determine. Sparse least squares; weights of whole pairs by the Geman-McClure function of their Mahalanobis distance.

    Speckle errors of an image are the same in all its pairs, so they close exactly and no adjustment sees them: with
    f = `unit` below 1, the share 1 - f of a pair's variance belongs to its images and stays in the standard error,
    and only the share f is lessened by the network.

    References
    ----------
    Q.-Y. Zhou, J. Park, V. Koltun, "Fast global registration", ECCV 2016, DOI 10.1007/978-3-319-46475-6_47, section
    3.2, for the limit that is halved
    """
    trusted = [pair for pair in pairs if pair.model is not None]
    weights = np.ones(len(trusted))
    start = _paths(trusted, np.ones(len(trusted)), count, reference)
    grid = _grid(shape, DENSE_FIELD if kind is ResidualField else DENSE)
    bases = _Basis(kind, shape)
    corrections = np.zeros((count, bases.size))
    known = [i for i in range(count) if start[i] is not None and i != reference]
    column = {image: n for n, image in enumerate(known)}
    used = [n for n, pair in enumerate(trusted) if start[pair.first] is not None and start[pair.second] is not None]
    unit, limit = 1.0, np.inf
    distances = np.zeros(len(trusted))
    inverse: FloatArray = np.zeros((0, 0))
    if known:
        for step in range(40):
            equations = [_equations(trusted[n], start, corrections, bases) for n in used]
            distances[used] = [_mahalanobis(residual, root) for _, _, residual, root in equations]
            unit = _unit(distances[used], weights[used], bases.size, len(known))
            # A pair is not thrown out for a distance that its own covariance explains.
            spread = np.sqrt(np.maximum(distances[used] / (bases.size * max(unit, 1.0)), 0))
            if step % ROUNDS == 0:
                limit = max(LIMIT, spread.max()) if not np.isfinite(limit) else max(LIMIT, limit / 2)
            weights[used] = (limit**2 / (limit**2 + spread**2)) ** 2
            solution, inverse = _solved(equations, [trusted[n] for n in used], weights[used], column, bases.size)
            corrections[known] += solution
            if limit == LIMIT and np.abs(solution).max() < 1e-9:
                break
    equations = [_equations(trusted[n], start, corrections, bases) for n in used]
    misfits = {n: _rms(residual) for n, (_, _, residual, _) in zip(used, equations, strict=True)}
    made = [
        # What no trusted pair joins to the reference was contradicted by nothing: its weight stays 1.
        replace(pair, weight=float(weights[n]), misfit=misfits.get(n, float("nan")))
        for n, pair in enumerate(trusted)
    ]
    reached = _reached([pair for pair in made if pair.weight >= THROWN_OUT], reference)
    models: list[Model | None] = [None] * count
    errors = np.full(count, np.nan)
    for image in range(count):
        if image == reference:
            models[image], errors[image] = Affine(np.eye(3)[:2]), 0.0
        elif image in reached:
            here = start[image]
            if here is not None:
                models[image] = _fitted(kind, grid, here(grid) + bases.displacement(grid, corrections[image]))
                block = slice(column[image] * bases.size, (column[image] + 1) * bases.size)
                errors[image] = _error(inverse[block, block], unit, bases, grid, image, made)
    by_pair = {(pair.first, pair.second): pair for pair in made}
    return Adjusted(models, errors, [by_pair.get((p.first, p.second), p) for p in pairs], unit)


class _Basis:
    """Displacements that the parameters of a kind of model make, in coordinates from -1 to 1 over the reference."""

    def __init__(self, kind: type[Model], shape: tuple[int, int]) -> None:
        self.size = {Translation: 2, Rigid: 3, Similarity: 4}.get(kind, 6)
        self.centre = (np.array(shape[::-1]) - 1) / 2
        self.scale = max(shape) / 2

    def at(self, xy: FloatArray) -> FloatArray:
        """(N, 2, P) displacement, px, for each unit of a parameter."""
        x, y = ((xy - self.centre) / self.scale).T
        out = np.zeros((len(xy), 2, 6))
        out[:, 0, 0] = out[:, 1, 1] = 1
        if self.size < 6:
            out[:, 0, 2], out[:, 1, 2] = y, -x
            out[:, 0, 3], out[:, 1, 3] = x, y
        else:
            out[:, 0, 2], out[:, 0, 3], out[:, 1, 4], out[:, 1, 5] = x, y, x, y
        return out[:, :, : self.size]

    def displacement(self, xy: FloatArray, parameters: FloatArray) -> FloatArray:
        return np.asarray(self.at(xy) @ parameters)


def _equations(
    pair: StackPair, start: Sequence[Model | None], corrections: FloatArray, bases: _Basis
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of one pair: derivatives by the first image's parameters and by the second's (N, 2, P), residual (N, 2), and the
    inverse covariance (N, 2, 2), so scaled that all nodes together count as the parameters do."""
    first, second, model = start[pair.first], start[pair.second], pair.model
    if first is None or second is None or model is None:
        raise ValueError("a pair outside the network has no equations")
    # Where the reference shows what a node shows; the correction of the first image moves it.
    back = first.inverse(pair.nodes)
    moved = pair.nodes + bases.displacement(back, corrections[pair.first])
    residual = second(back) + bases.displacement(back, corrections[pair.second]) - model(moved)
    step = 0.5
    linear = np.stack([model(moved + e) - model(moved - e) for e in (np.array([step, 0]), np.array([0, step]))], -1)
    inverse = np.asarray(np.linalg.inv(pair.covariance) * (bases.size / (2 * len(pair.nodes))), np.float64)
    basis = bases.at(back)
    return -linear @ basis, basis, residual, inverse


def _mahalanobis(residual: FloatArray, inverse: FloatArray) -> float:
    return float(np.einsum("ni,nij,nj->", residual, inverse, residual))


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt((residual**2).sum(axis=1).mean()))


def _unit(distances: FloatArray, weights: FloatArray, size: int, images: int) -> float:
    """Variance factor that the pairs show beyond what determines the models; 1 in a network without loops."""
    redundant = float(weights.sum()) - images
    return 1.0 if redundant < 0.5 else max(float(weights @ distances) / (size * redundant), 1e-4)


def _solved(
    equations: Sequence[tuple[FloatArray, FloatArray, FloatArray, FloatArray]],
    pairs: Sequence[StackPair],
    weights: FloatArray,
    column: dict[int, int],
    size: int,
) -> tuple[FloatArray, FloatArray]:
    """Steps of the parameters (images, P), and the inverse of the normal matrix."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    count = len(column) * size
    normal = sparse.lil_matrix((count, count))
    right = np.zeros(count)
    for (first, second, residual, inverse), pair, weight in zip(equations, pairs, weights, strict=True):
        sides = [(column[i], d) for i, d in ((pair.first, first), (pair.second, second)) if i in column]
        for row, derivative in sides:
            part = slice(row * size, (row + 1) * size)
            weighted = weight * np.einsum("nap,nab->npb", derivative, inverse)
            right[part] -= np.einsum("npb,nb->p", weighted, residual)
            for other, partner in sides:
                block = np.einsum("npb,nbq->pq", weighted, partner)
                where = slice(other * size, (other + 1) * size)
                normal[part, where] = normal[part, where].toarray() + block
    matrix = normal.tocsc()
    solution = np.asarray(spsolve(matrix, right)).reshape(-1, size)
    # The unknowns are few: six for an image.
    return solution, np.asarray(np.linalg.pinv(matrix.toarray(), hermitian=True), np.float64)


def _error(
    covariance: FloatArray, unit: float, bases: _Basis, grid: FloatArray, image: int, pairs: Sequence[StackPair]
) -> float:
    basis = bases.at(grid)
    network = np.einsum("nap,pq,naq->na", basis, covariance, basis).mean()
    own = [
        np.trace(p.covariance, axis1=1, axis2=2).mean() / 2 for p in pairs if p.used and image in (p.first, p.second)
    ]
    typical = 1 / np.mean([1 / v for v in own]) if own else 0.0
    return float(np.sqrt(max(1 - unit, 0) * typical + unit * network))


def _paths(pairs: Sequence[StackPair], weights: FloatArray, count: int, reference: int) -> list[Model | None]:
    """For each image a model by the path of fewest pairs from the reference, the more certain where there are two."""
    models: list[Model | None] = [None] * count
    models[reference] = Affine(np.eye(3)[:2])
    ranked = sorted(pairs, key=lambda p: (float(np.trace(p.covariance, axis1=1, axis2=2).mean()), p.first, p.second))
    todo = deque([reference])
    while todo:
        image = todo.popleft()
        here = models[image]
        for pair in ranked:
            if image not in (pair.first, pair.second) or pair.model is None or here is None:
                continue
            other = pair.second if image == pair.first else pair.first
            if models[other] is None:
                step = pair.model if image == pair.first else pair.model.inverse
                models[other] = composed(here, step)
                todo.append(other)
    return models


def composed(first: Model, second: Model) -> Model:
    """Return `first`, then `second`, as one model."""
    a, b = first.matrix, second.matrix
    if a is not None and b is not None and (a[2, :2] == 0).all() and (b[2, :2] == 0).all():
        return Affine((b @ a)[:2])
    return Chain(first, second)


@dataclass(frozen=True, eq=False)
class Chain(DerivedModel):
    """One model after the other, as they are: a model of another kind could not follow both."""

    first: Model
    second: Model

    def __call__(self, xy: ArrayLike) -> FloatArray:
        return self.second(self.first(xy))

    @property
    def inverse(self) -> Model:
        return Chain(self.second.inverse, self.first.inverse)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"first": self.first, "second": self.second}


def _fitted(kind: type[Model], here: FloatArray, there: FloatArray) -> Model:
    """The model of a kind through points that are exact; a freer one where it cannot follow them.

    A residual field follows anything as far as its cells are fine enough, and no other kind follows it better.
    """
    for candidate in (kind, Affine, Homography, Polynomial3):
        model = candidate.from_estimate(here, there)
        if not isinstance(model, FailedFit) and (
            candidate in (ResidualField, Polynomial3) or float(np.max(model.residuals(here, there))) <= BENT_PX
        ):
            return model
    raise ValueError("no model follows the adjusted points")


def _reached(pairs: Sequence[StackPair], reference: int) -> set[int]:
    """Images that pairs lead to."""
    seen, grown = {reference}, True
    while grown:
        grown = False
        for pair in pairs:
            if (pair.first in seen) != (pair.second in seen):
                seen |= {pair.first, pair.second}
                grown = True
    return seen


def _grid(shape: tuple[int, int], side: int) -> FloatArray:
    x, y = (np.linspace(0, n - 1, side) for n in shape[::-1])
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
