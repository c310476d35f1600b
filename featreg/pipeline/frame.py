"""What the geography of two images says of a mirror, a stretch, a zoom or a turn, taken out before they are compared.

The secondary is resampled into a frame that differs from the reference by a shift, as far as the geography tells.
Features are compared, the model is fitted and judged there; tie points and model are then given in the secondary's own
pixels. Where geography says nothing of the kind, nothing is resampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.geometry import Affine, Rigid, Similarity, Translation, decompose
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray, Image, Matches, read_only

if TYPE_CHECKING:
    from featreg.geolocation import Transfer

#: Every method holds a turn by so many degrees, a ratio of the two scales and a zoom by so much as they are: up to
#: these the secondary's own samples are compared.
TURN_DEG, STRETCH, ZOOM = 10.0, 1.1, 1.25
#: Most pixels of a resampled secondary, in those of both images, before only the reference's surroundings are kept.
MOST_TIMES = 2.0
#: Nodes along each side of the lattice on which the overlap is looked for.
NODES = 17
#: A model class that cannot follow the frame's map to so many px cannot be given in the secondary's own pixels.
HELD_PX = 1e-3
#: What two map grids state beside a shift is taken out for a model class that misses it by more, px.
MISSED_PX = 0.5
#: Classes that cannot hold every linear map: seen through a frame, they are affine.
NARROW = (Translation, Rigid, Similarity)


@dataclass(frozen=True, eq=False)
class Frame:
    """A pixel grid on which the secondary looks as the reference does.

    Parameters
    ----------
    affine : (2, 3) map from the frame's pixels to those of the secondary
    shape : (H, W) of the frame
    """

    affine: FloatArray
    shape: tuple[int, int]

    @property
    def linear(self) -> FloatArray:
        """(2, 2) linear part: the geography's reference -> secondary."""
        return self.affine[:, :2]

    def to_secondary(self, xy: FloatArray) -> FloatArray:
        """Map (N, 2) points of the frame to the secondary."""
        return np.asarray(xy @ self.linear.T + self.affine[:, 2])

    def from_secondary(self, xy: FloatArray) -> FloatArray:
        """Map (N, 2) points of the secondary to the frame."""
        return np.asarray((xy - self.affine[:, 2]) @ np.linalg.inv(self.linear).T)

    def resampled(self, image: Image) -> Image:
        """The amplitude of an image on the frame; a pixel is valid where more than half of what it rests on is."""
        import cv2

        mask = image.mask.astype(np.float32)
        values: NDArray[np.float32] = image.amplitude * mask
        # What shrinks is smoothed first, along each axis as much as it shrinks.
        across, down = (0.5 * math.sqrt(max(float(n) ** 2 - 1, 0.0)) for n in np.hypot(*self.linear.T))
        if max(across, down) > 0.1:
            # A kernel of one pixel, as a width near 0 gives, leaves its axis as it is.
            values, mask = (
                np.asarray(cv2.GaussianBlur(a, (0, 0), max(across, 1e-3), sigmaY=max(down, 1e-3)), np.float32)
                for a in (values, mask)
            )
        size = self.shape[1], self.shape[0]
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        weights = cv2.warpAffine(mask, self.affine, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        good = weights > 0.5
        if image.all_valid:
            cubic = cv2.warpAffine(values, self.affine, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
            values = np.asarray(cubic, np.float32)
        else:
            linear = cv2.warpAffine(values, self.affine, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
            values = np.divide(linear, weights, out=np.zeros_like(linear), where=good)
        pixels = np.where(good, np.maximum(values, 0), 0).astype(np.float32)
        return Image(read_only(pixels), read_only(good), None, image.name, image.source_dtype, "amplitude")

    def back(self, matches: Matches) -> Matches:
        """Tie points of the reference and the frame as those of the reference and the secondary."""
        part = decompose(self.linear)
        covariance, rotation, ratio = matches.covariance, matches.rotation, matches.scale_ratio
        if covariance is not None:
            covariance = self.linear @ covariance @ self.linear.T
        # Behind a mirror a turn is no turn.
        turn = math.radians(part.rotation_deg) if math.isfinite(part.rotation_deg) else None
        return replace(
            matches,
            secondary_xy=self.to_secondary(matches.secondary_xy),
            covariance=covariance,
            rotation=None if rotation is None or turn is None else rotation + turn,
            scale_ratio=None if ratio is None else ratio * part.scale,
        )

    def model_back(self, model: Model, shape: tuple[int, int]) -> Model | FailedFit:
        """The model reference -> secondary of one reference -> frame; `shape` is that of the reference.

        Of the same class, or affine where that class does not hold what the frame takes out.
        """
        nodes = _nodes(shape)
        there = self.to_secondary(model(nodes))
        if isinstance(model, NARROW) and not _misses(type(model), nodes, there) <= HELD_PX:
            return Affine.from_estimate(nodes, there)
        return type(model).from_estimate(nodes, there)

    def held_by(self, kind: type[Model], shape: tuple[int, int]) -> bool:
        """Whether a model of a class, fitted in the frame, can be given in the secondary's own pixels."""
        nodes = _nodes(shape)
        return issubclass(kind, NARROW) or _misses(kind, nodes, self.to_secondary(nodes)) <= HELD_PX


def _misses(kind: type[Model], xy: FloatArray, there: FloatArray) -> float:
    """How far the best model of a class is from points (N, 2) that others (N, 2) go to, px; inf where none is made."""
    model = kind.from_estimate(xy, there)
    return math.inf if isinstance(model, FailedFit) else float(model.residuals(xy, there).max())


def stated_frame(reference: Image, secondary: Image, kind: type[Model] = Affine) -> Frame | None:
    """The frame of two images by their own geography; None where they state none, or nothing that must be taken out.

    That is what features cannot be compared through, and what a class `kind` of models does not hold.
    """
    if reference.geolocation is None or secondary.geolocation is None:
        return None
    from featreg.geolocation import ConstantHeight, Transfer, ground_level, sensor_of

    try:
        sensors = [sensor_of(image.geolocation, image.shape, image.name) for image in (reference, secondary)]
        transfer = Transfer(sensors[0], sensors[1], ConstantHeight(ground_level(*sensors)[0]))
        nodes = _nodes(reference.shape)
        there = transfer(nodes)
    except (InputError, np.linalg.LinAlgError):
        return None
    size = np.array(secondary.shape[::-1]) - 1
    inside = np.isfinite(there).all(axis=1) & (there >= 0).all(axis=1) & (there <= size).all(axis=1)
    if not inside.any():
        return None
    centre = nodes[inside].mean(axis=0)
    linear = linear_at(transfer, centre)
    if linear is None:
        linear = beyond(kind, transfer, centre, reference.shape)
    if linear is None:
        return None
    frame = frame_of(linear, secondary.shape)
    most = MOST_TIMES * (reference.mask.size + secondary.mask.size)
    if frame.shape[0] * frame.shape[1] > most:
        around = frame.from_secondary(transfer(centre[None]))[0] - centre
        frame = _cropped(frame, around, reference.shape)
    return frame


def beyond(kind: type[Model], transfer: Transfer, xy: FloatArray, shape: tuple[int, int]) -> FloatArray | None:
    """(2, 2) linear part at a point (2,) of what two map grids state, where a class of models does not hold it.

    Parameters
    ----------
    kind : the class
    transfer : between two images; those that are no map grids do not state their shape exactly
    xy : the point
    shape : (H, W) of the reference
    """
    from featreg.geolocation.geotransform import GeotransformSensor

    sensors = transfer.reference, transfer.secondary
    if not issubclass(kind, NARROW) or not all(isinstance(sensor, GeotransformSensor) for sensor in sensors):
        return None
    linear, nodes = _linear(transfer, xy), _nodes(shape)
    return None if linear is None or _misses(kind, nodes, nodes @ linear.T) <= MISSED_PX else linear


def linear_at(model: Callable[[FloatArray], FloatArray], xy: FloatArray) -> FloatArray | None:
    """(2, 2) linear part of a map at a point (2,) over 8 px, where it must be taken out; else None."""
    linear = _linear(model, xy)
    if linear is None:
        return None
    part = decompose(linear)
    plain = np.linalg.det(linear) > 0 and abs(part.rotation_deg) <= TURN_DEG
    return None if plain and part.anisotropy <= STRETCH and 1 / ZOOM <= part.scale <= ZOOM else linear


def _linear(model: Callable[[FloatArray], FloatArray], xy: FloatArray) -> FloatArray | None:
    """(2, 2) linear part of a map at a point (2,) over 8 px; None where it has none."""
    steps = np.array([[4.0, 0.0], [-4.0, 0.0], [0.0, 4.0], [0.0, -4.0]])
    right, left, below, above = model(xy + steps)
    linear = np.column_stack([right - left, below - above]) / 8
    return None if not np.isfinite(linear).all() or abs(np.linalg.det(linear)) < 1e-6 else linear


def frame_of(linear: FloatArray, shape: tuple[int, int]) -> Frame:
    """The frame on which an image of (H, W) is seen as a linear part says; its first pixel lies on whole pixels."""
    height, width = shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)
    there = corners @ np.linalg.inv(linear).T
    low, high = there.min(axis=0), there.max(axis=0)
    origin = np.rint(linear @ low)
    columns, rows = (math.ceil(n - 1e-6) + 1 for n in high - low)
    return Frame(np.column_stack([linear, origin]), (rows, columns))


def _cropped(frame: Frame, offset: FloatArray, shape: tuple[int, int]) -> Frame:
    """The part of a frame around an image of (H, W) that lies at an offset, half its size more on every side."""
    size = np.array(shape[::-1], np.float64)
    low = np.maximum(np.floor(offset - 0.5 * size), 0)
    high = np.minimum(np.ceil(offset + 1.5 * size), np.array(frame.shape[::-1]))
    columns, rows = (max(int(n), 1) for n in high - low)
    return Frame(np.column_stack([frame.linear, frame.to_secondary(low[None])[0]]), (rows, columns))


def _nodes(shape: tuple[int, int]) -> FloatArray:
    """(N, 2) nodes of a lattice over an image of (H, W)."""
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, NODES), np.linspace(0, shape[0] - 1, NODES))
    return np.column_stack([x.ravel(), y.ravel()])
