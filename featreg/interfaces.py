"""What a plugin is: Detector, Descriptor, Nearest, Matcher, Filter and Model, each as small as it can be.

A plugin is one class in one file. Its parameters are keywords with defaults, kept on the instance under their own
names (a frozen dataclass does both), so that they can be listed, checked, recorded and swept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import NoModelError
from featreg.types import BoolArray, Features, FloatArray, Image, IntArray, Matches, Searched

#: Reach of a plugin that states none, px: as much as the methods here that look around themselves most widely.
REACH = 96.0


class Plugin(ABC):  # noqa: B024  # its kinds have the abstract methods
    """What every plugin may say of itself beside its parameters; nothing of it has to be said."""

    #: Parameters that differ from their defaults where images are worked on in blocks, unless they are given.
    block_parameters: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    #: False where nothing is compiled at the first call, so that `featreg.warm_up` leaves the plugin out.
    compiled: ClassVar[bool] = True

    @property
    def parts(self) -> tuple[Plugin, ...]:
        """The plugins that this one is made of; their code decides its results too."""
        return ()


class Detector(Plugin):
    """Finds keypoints in one image."""

    #: Of one that can describe its points at once: its parameter that is set to False where a descriptor is asked for.
    describes: ClassVar[str | None] = None

    @abstractmethod
    def detect_features(self, image: Image) -> Features:
        """Return the keypoints of `image`, best first; empty where there are none.

        A detector that has a parameter `n_features` is given the pipeline's budget through it. Descriptors may be
        returned at once; the descriptor stage is then skipped.
        """

    def detect_places(self, image: Image) -> Features:
        """As `detect_features`, for callers who ask for the angles of those that they need, by `oriented`.

        Whoever takes time over angles leaves them out here. A class that overrides `detect_features` of one that does
        so overrides this too: `featreg.match` asks for places.
        """
        return self.detect_features(image)

    def oriented(self, image: Image, features: Features) -> Features:
        """Return some of the features of `detect_places` of an image with the angles that `detect_features` gives."""
        return features

    def for_pair(self, reference: Image, secondary: Image) -> Self:
        """Return the detector that finds keypoints alike in two images that are matched: itself, unless sizes decide.

        Whoever leaves something out of large images does so in both or in neither.
        """
        return self

    def searched(self, image: Image) -> Searched:
        """What `detect_features` looks for in an image, for the record; whoever leaves something out says it here."""
        return Searched()

    @property
    def reach(self) -> float:
        """How far from a keypoint pixels may lie that decide on it, px; no keypoint's `scale` is larger.

        Blocks of a scene are read so much larger than they are, or as the descriptor's or the matcher's reach asks.
        """
        return REACH

    def window_bytes(self, shape: tuple[int, int]) -> float:
        """Memory that finding keypoints in an image of (H, W) takes at most; 0 where that is a few maps of its size.

        Blocks of a scene are no larger than that they take little.
        """
        return 0.0

    def form(self) -> tuple[str, int] | None:
        """Norm and length (numbers or bytes) of the descriptors that it returns, if it can tell without an image."""
        return None

    def detect(self, array: NDArray[Any], mask: NDArray[Any] | None = None) -> list[Any]:
        """As OpenCV's `Feature2D.detect`: an array and an optional mask (non-zero = valid) in, `cv2.KeyPoint` out."""
        from featreg.io.images import image_or_none

        image = image_or_none(array, mask)
        return [] if image is None else self.detect_features(image).to_keypoints()


class Descriptor(Plugin):
    """Describes keypoints of one image."""

    @abstractmethod
    def describe_features(self, image: Image, features: Features) -> Features:
        """Return the features with `descriptors`; where rows were dropped or doubled, `index` names the rows given."""

    def reach_of(self, scale: float) -> float:
        """How far from a keypoint of this scale pixels may lie that decide on its description, px."""
        return max(REACH, 1.5 * scale)

    def form(self) -> tuple[str, int] | None:
        """Norm and length of a descriptor (numbers, or bytes of packed bits), if it can tell without an image."""
        return None

    def compute(self, array: NDArray[Any], keypoints: Any) -> tuple[list[Any], NDArray[Any] | None]:
        """As OpenCV's `Feature2D.compute`: an array and `cv2.KeyPoint`s in, the kept ones and descriptors out."""
        from featreg.io.images import image_or_none

        image = image_or_none(array)
        given = Features.from_keypoints(keypoints)
        if image is None or not len(given):
            return [], None
        described = self.describe_features(image, given)
        return described.to_keypoints(), described.descriptors if len(described) else None


class Nearest(Plugin):
    """Pairs the descriptors of two images."""

    @abstractmethod
    def match_features(self, reference: Features, secondary: Features) -> tuple[IntArray, FloatArray]:
        """Return ((M, 2) int64 rows of reference and secondary, (M,) float64 score, higher is better)."""


class Matcher(Plugin):
    """The one matcher interface: a pure source of tie points."""

    @property
    def complex_only(self) -> bool:
        """Whether both images must be complex."""
        return False

    @property
    def taken_for_granted(self) -> str:
        """What `match` takes for granted of the images, which `match_near` is told, in words; "" for nothing.

        It is said where a result that needed it cannot be trusted.
        """
        return ""

    @abstractmethod
    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return putative tie points; empty where there are none."""

    def match_near(self, reference: Image, secondary: Image, initial: Model, radius: float) -> Matches:
        """As `match`, of images of which it is known that `initial` aligns them to within a radius.

        Parameters
        ----------
        reference, secondary : the images
        initial : a model reference -> secondary
        radius : how far from it a point may lie, px of the secondary

        Notes
        -----
        For matchers that search: they need not look elsewhere. Whoever calls it drops tie points beyond the radius.
        """
        return self.match(reference, secondary)

    def searched_in(self, reference: Image, secondary: Image) -> tuple[Searched, Searched] | None:
        """Where `match` looks in either image, for the record; None from whoever does not tell.

        Whoever reduces images or leaves something out tells it, by the parameter's name as `featreg.match` takes it.
        """
        return None

    @property
    def reach(self) -> float:
        """How far from a tie point pixels may lie that decide on it, px; blocks of a scene are read so much larger."""
        return REACH


@dataclass(frozen=True, eq=False)
class FilterContext:
    """What a filter may know beside the matches.

    `reference_shape` and `secondary_shape` are (H, W) of what the matches lie in, images or the windows of a block;
    `model` is the class to be fitted; `rng` is the only source of randomness; `initial` is the model known beforehand,
    if any, in the same pixels as the matches. `pixel_ratio` (x, y) is the size on the ground of a pixel of the
    secondary over that of one of the reference, as far as anything tells it.
    """

    reference_shape: tuple[int, int]
    secondary_shape: tuple[int, int]
    model: type[Model]
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    initial: Model | None = None
    pixel_ratio: tuple[float, float] = (1.0, 1.0)


class Filter(Plugin):
    """Keeps the tie points that agree with each other."""

    #: True where the filter looks at neighbourhoods only, so that a scene may run it block by block.
    local: ClassVar[bool] = False

    @abstractmethod
    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        """Return an (M,) bool mask of the matches to keep."""


@dataclass(frozen=True)
class FailedFit:
    """What a fit returns when it cannot be made: falsy, and says why.

    Whoever uses it as a model all the same is told why there is none: a `NoModelError`, which is an `InputError` and an
    `AttributeError`.
    """

    reason: str

    def __bool__(self) -> Literal[False]:
        return False

    def __getattr__(self, name: str) -> NoReturn:
        # What begins with an underscore is asked for by protocols (copying, pickling, notebooks), not by people.
        if name.startswith("_"):
            raise AttributeError(name)
        raise NoModelError(f"there is no model, and so no '{name}': {self.__dict__.get('reason', '')}")

    def __call__(self, *args: Any, **options: Any) -> NoReturn:
        raise NoModelError(f"there is no model that could map points: {self.reason}")


class Model(ABC):
    """A geometric model reference -> secondary, in pixels."""

    #: Fewest points that determine the model.
    minimum: ClassVar[int]

    @classmethod
    @abstractmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the weighted least-squares model of (M, 2) points, or a `FailedFit` where there is none.

        `weights` (M,) multiply the squared residuals.
        """

    @abstractmethod
    def __call__(self, xy: ArrayLike) -> FloatArray:
        """Map (N, 2) reference points to the secondary image."""

    @property
    @abstractmethod
    def inverse(self) -> Model:
        """The model secondary -> reference."""

    @property
    @abstractmethod
    def parameters(self) -> Mapping[str, Any]:
        """Named values, enough to rebuild the model with ``type(model)(**parameters)``."""

    @property
    def matrix(self) -> FloatArray | None:
        """The (3, 3) homogeneous matrix, or None where the model has none."""
        return None

    def residuals(self, reference_xy: ArrayLike, secondary_xy: ArrayLike) -> FloatArray:
        """(M,) distances in pixels between the mapped reference points and the secondary points."""
        return np.asarray(np.hypot(*(self(reference_xy) - np.asarray(secondary_xy, np.float64)).T))

    def shift_at(self, xy: ArrayLike) -> FloatArray:
        """Return ``model(xy) - xy`` in pixels for one point (2,) or (N, 2); at the image centre for a rigid one."""
        at = np.asarray(xy, np.float64)
        return np.asarray(self(at.reshape(-1, 2)).reshape(at.shape) - at)

    if TYPE_CHECKING:
        # A property here would become the default of the fields of that name which frozen dataclasses below declare.

        @property
        def rotation_deg(self) -> float:
            """Counter-clockwise as seen, of a model that is a matrix; NaN for a reflection. Others raise."""

        @property
        def scale(self) -> float:
            """Square root of the magnification of areas, of a model that is a matrix. Others raise."""

    else:

        def __getattr__(self, name: str) -> NoReturn:
            kind = type(self).__name__
            if name in ("rotation_deg", "scale"):
                raise NoModelError(
                    f"a {kind} has no one '{name}', it differs from place to place: "
                    f"featreg.geometry.decompose(featreg.geometry.local_linear(model, (x, y))).{name} is that of one"
                )
            raise AttributeError(f"'{kind}' object has no attribute '{name}'", name=name, obj=self)
