"""The one place that knows where OpenCV 4.10 to 5 keeps what, and how its positions differ from ours.

OpenCV 5 moved BRISK, KAZE, AKAZE and AGAST to `cv2.xfeatures2d`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.interop.family import DESCRIBE, NORMALISE, File, Option, Row, option
from featreg.sar.normalise import to_uint8
from featreg.types import BoolArray, Features, FloatArray, Image

ALGORITHMS = (
    "AKAZE", "ALIKED", "ANNIndex", "AffineFeature", "AgastFeatureDetector", "BEBLID", "BRISK", "BoostDesc",
    "BriefDescriptorExtractor", "DAISY", "DISK", "FREAK", "FastFeatureDetector", "GFTTDetector",
    "HarrisLaplaceFeatureDetector", "KAZE", "LATCH", "LUCID", "LightGlueMatcher", "MSDDetector", "MSER", "ORB", "SIFT",
    "SURF", "SimpleBlobDetector", "StarDetector", "TBMR", "TEBLID", "VGG",
)  # fmt: skip
#: Shortest side of an image that every algorithm handles, px.
MIN_SIDE = 16
CURE = "pip install opencv-contrib-python-headless"


def resolve(name: str) -> Callable[..., Any] | str:
    """Return OpenCV's create function of an algorithm ("ORB", "AKAZE", ...), or reason and cure where it has none."""
    try:
        import cv2
    except ImportError as error:
        return f"OpenCV cannot be imported ({error}); {CURE}"
    homes = (cv2, getattr(cv2, "xfeatures2d", None))
    create = next((c for c in (getattr(home, f"{name}_create", None) for home in homes) if c is not None), None)
    if create is None and homes[1] is None:
        return f"OpenCV {cv2.__version__} was installed without its contrib modules; {CURE}"
    if create is None:
        return f"OpenCV {cv2.__version__} has no {name}"
    if name == "SURF":
        try:
            create()
        except cv2.error:
            return (
                f"OpenCV {cv2.__version__} was built without its patented algorithms; "
                "use 'sift' or 'akaze', or build OpenCV with OPENCV_ENABLE_NONFREE"
            )
    found: Callable[..., Any] = create
    return found


def unavailable(name: str) -> str:
    """Return why an algorithm cannot be used here, "" where it can."""
    found = resolve(name)
    return found if isinstance(found, str) else ""


def homes() -> dict[str, str]:
    """Return, for every algorithm known to featreg, the module of OpenCV that holds it or why none does."""
    where = {}
    for name in ALGORITHMS:
        reason = unavailable(name)
        if not reason:
            import cv2

            reason = "cv2" if hasattr(cv2, f"{name}_create") else "cv2.xfeatures2d"
        where[name] = reason
    return where


@contextmanager
def clear_errors(name: str) -> Iterator[None]:
    """Turn what OpenCV raises inside the block into one line of ours."""
    import cv2

    try:
        yield
    except (cv2.error, TypeError) as error:
        text = " ".join(str(error).split("error: ", 1)[-1].split())
        raise InputError(f"OpenCV's {name} refuses this image or these parameters: {text}") from error


def grey(image: Image, normalise: str) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 picture of `image` that OpenCV is given, shared by all stages."""
    if image.all_valid:
        return image.derive(to_uint8, method=normalise)
    return image.derive(to_uint8, method=normalise, fill="median")


def clearance(image: Image) -> NDArray[np.float32]:
    """Return for each pixel the distance in pixels to the nearest invalid one, as ``image.derive(clearance)``."""
    import cv2

    return np.asarray(cv2.distanceTransform(image.mask.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def inside(xy: FloatArray, shape: tuple[int, int]) -> BoolArray:
    """Return (N,) bool: which of the points lie between the outermost pixel centres of an (H, W) image."""
    return np.asarray(np.all((xy >= 0) & (xy <= np.array(shape[::-1]) - 1), axis=1))


def on_data(features: Features, image: Image) -> BoolArray:
    """Return (N,) bool: which of the features lie in the image, with their support on valid pixels."""
    clear = inside(features.xy, image.shape)
    if not image.all_valid:
        column, row = np.clip(np.rint(features.xy).astype(np.int64), 0, np.array(image.shape[::-1]) - 1).T
        distance = image.derive(clearance)[row, column]
        clear &= (distance > 0) & (distance >= features.scale)
    return clear


def orb_to_true(xy: FloatArray, level: NDArray[Any], scale_factor: float, shape: tuple[int, int]) -> FloatArray:
    """Return the positions in the image of the points that ORB reports at `xy` (N, 2) on pyramid levels (N,).

    ORB multiplies a position of level l by ``s = scale_factor**l``. But the level has round(W / s) columns, and
    resizing maps x of the level to ``(x + 0.5) * W / round(W / s) - 0.5``: up to two pixels away at level 7.
    """
    s, ratio = _orb_level(level, scale_factor, shape)
    return np.asarray((xy / s + 0.5) * ratio - 0.5)


def true_to_orb(xy: FloatArray, level: NDArray[Any], scale_factor: float, shape: tuple[int, int]) -> FloatArray:
    """Return where ORB would report the points; the inverse of `orb_to_true`."""
    s, ratio = _orb_level(level, scale_factor, shape)
    return np.asarray(((xy + 0.5) / ratio - 0.5) * s)


def _orb_level(level: NDArray[Any], scale_factor: float, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    s = (scale_factor ** level.astype(np.float64)).astype(np.float32)[:, None]
    size = np.array(shape[::-1], dtype=np.float32)
    columns_and_rows = np.rint(size * (np.float32(1.0) / s))  # in float32 as ORB does, which decides ties
    return s.astype(np.float64), size / np.maximum(columns_and_rows, 1.0).astype(np.float64)


def snake(**defaults: Any) -> dict[str, Option]:
    """Return parameters that OpenCV calls as we do."""
    return {key: option(default, keyword=key) for key, default in defaults.items()}


def camel(**defaults: Any) -> dict[str, Option]:
    """Return parameters that OpenCV calls so in camelCase."""
    return {
        key: option(default, keyword=re.sub("_(.)", lambda found: found[1].upper(), key))
        for key, default in defaults.items()
    }


@dataclass(frozen=True)
class Algorithm(Row):
    """A row of a table of OpenCV's algorithms; every one has a parameter `normalise`.

    Parameters
    ----------
    describes : it is a detector that describes as well, and has a parameter `describe`
    """

    describes: bool = False

    def __post_init__(self) -> None:
        describe = DESCRIBE if self.describes else {}
        object.__setattr__(self, "parameters", {**self.parameters, **describe, **NORMALISE})

    @property
    def unavailable(self) -> str:
        return unavailable(self.creator)

    def make(self, values: Mapping[str, Any]) -> Any:
        """Return a new OpenCV object with these values (creating one costs far less than any use of it)."""
        found = resolve(self.creator)
        if isinstance(found, str):
            raise ParameterError(f"{self.creator} cannot be used here: {found}")
        keywords = {
            p.keyword: p.constants.get(values[key], values[key]) for key, p in self.parameters.items() if p.keyword
        }
        if self.creator == "SimpleBlobDetector":
            import cv2

            options = cv2.SimpleBlobDetector.Params()
            for keyword, value in keywords.items():
                setattr(options, keyword, value)
            return found(options)
        if self.creator == "AffineFeature":
            keywords["backend"] = _backend(values["backend"])
        return found(**keywords)

    def form(self, values: Mapping[str, Any]) -> tuple[str, int]:
        """Norm and length (numbers or bytes) of the descriptors with these values."""
        with clear_errors(self.creator):
            made = self.make(values)
        return "l2" if made.descriptorType() else "hamming", made.descriptorSize()


#: What `AffineFeature` may run on each view, by our name and OpenCV's.
BACKENDS = {"sift": "SIFT", "orb": "ORB", "akaze": "AKAZE", "brisk": "BRISK"}


def _backend(name: str) -> Any:
    create = resolve(BACKENDS[name])
    if isinstance(create, str):
        raise ParameterError(f"AffineFeature cannot run {name} here: {create}")
    if name == "orb":
        return create(nfeatures=5000)
    # Without it the points lie a quarter of a pixel off.
    return create(enable_precise_upscale=True) if name == "sift" else create()


#: What the detector and the descriptor of one name have in common.
HALF_PIXEL = {"half_pixel": option(True, meaning="put right the positions that OpenCV shifts")}
LEVELS = {
    **camel(n_octaves=4, n_octave_layers=4),
    "diffusivity": option(
        "pm-g2", choices={"pm-g1": 0, "pm-g2": 1, "weickert": 2, "charbonnier": 3}, keyword="diffusivity"
    ),
}
KINDS = {"kaze-upright": 2, "kaze": 3, "mldb-upright": 4, "mldb": 5}
MLDB = {
    "descriptor_type": option("mldb", choices=KINDS, keyword="descriptor_type"),
    **snake(descriptor_size=0, descriptor_channels=3),
}
SIZES = camel(extended=False, upright=False)


def onnx_weights() -> File:
    """The parameter `weights` of a network that OpenCV runs itself."""
    return File(None, str, meaning="file of the network in the format ONNX; OpenCV ships none")


@dataclass(frozen=True)
class NetworkRow(Row):
    """One network of OpenCV 5 that is read from a file in the format ONNX.

    Parameters
    ----------
    build : (OpenCV's create function, path, parameters) -> OpenCV's object
    reads_image : it has a parameter `normalise`
    """

    build: Callable[[Any, str, Mapping[str, Any]], Any] = field(kw_only=True)
    reads_image: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        more = NORMALISE if self.reads_image else {}
        object.__setattr__(self, "parameters", {**self.parameters, **more})

    @property
    def unavailable(self) -> str:
        return unavailable(self.creator) or f"OpenCV ships no weights of {self.creator}; give weights=FILE.onnx"

    @property
    def on_demand(self) -> bool:
        return not unavailable(self.creator)

    def network(self, name: str, values: Mapping[str, Any]) -> Any:
        """Return OpenCV's object for these parameters.

        Raises
        ------
        PluginUnavailableError
            This OpenCV has no such network, or no file is given.
        InputError
            OpenCV cannot read the file.
        """
        create = resolve(self.creator)
        if isinstance(create, str) or values["weights"] is None:
            raise PluginUnavailableError(f"{name}: {self.unavailable}")
        path = str(values["weights"])
        if not Path(path).is_file():
            raise InputError(f"weights file {path}: no such file; {name} needs one in the format ONNX")
        with clear_errors(self.creator):
            return self.build(create, path, values)
