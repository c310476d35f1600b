"""What one job of a comparison is, and the functions that run in its worker process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from featreg.errors import CancelledError
from featreg.matching import keypoints_of
from featreg.pipeline.keywords import bands_of, of_keypoints
from featreg.results.registration import Registration
from featreg.runtime.threads import single_threaded
from featreg.study.truth import Truth
from featreg.types import FloatArray, Image

ROLES = ("reference", "secondary")
#: The stage of a scene in which its blocks are matched.
BLOCKS = "blocks"
#: What says how high the ground of a pair is.
HEIGHTS = ("dem", "height")


@dataclass(frozen=True, eq=False)
class Pair:
    """Two images, what they are called together, where the points of one lie in the other, and how high the ground is.

    `heights` is ``{"dem": file}`` or ``{"height": metres}``, in place of what the protocol says for all pairs.
    """

    name: str
    reference: Any
    secondary: Any
    truth: Truth | None = None
    heights: Mapping[str, Any] = field(default_factory=dict)

    def keywords(self, method: Mapping[str, Any]) -> dict[str, Any]:
        """The keywords of a method on this pair."""
        common = {name: value for name, value in method.items() if not self.heights or name not in HEIGHTS}
        return common | dict(self.heights)


@dataclass(frozen=True)
class Job:
    """One pair, one method (by its label), one seed."""

    pair: int
    method: str
    seed: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a job.

    Parameters
    ----------
    result : a registration, or one line that says why there is none
    act : stage -> seconds, measured in a serial pass; None where it was not
    keypoints : (N, 2) of the reference and of the secondary, where a metric asked for them and the method has any
    """

    result: Registration | str
    act: Mapping[str, float] | None = None
    keypoints: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True)
class Method:
    """A method with the keywords of `match` with which it is run.

    `point` is its place in a grid of parameters, where there is one, and `base` its label without that.
    """

    label: str
    keywords: Mapping[str, Any] = field(default_factory=dict)
    point: Mapping[str, Any] = field(default_factory=dict)
    base: str = ""

    def with_seed(self, seed: int) -> dict[str, Any]:
        """The keywords of one call."""
        return {"seed": seed, **self.keywords}


def load_methods() -> None:
    """Import what every job needs, so that it does not count as the first job's time."""
    import featreg.matching  # noqa: F401
    from featreg.registry import available

    available("detector")


def predict(reference: Any, secondary: Any, keywords: Mapping[str, Any]) -> Registration | str:
    """One registration, or one line that says why there is none."""

    def run() -> Registration:
        from featreg.matching import match

        for image in (reference, secondary):
            if isinstance(image, Image):
                image.release()
        with single_threaded():
            made: Registration = match(reference, secondary, **_one_after_the_other(keywords))
            return made

    return outcome(run)


def _one_after_the_other(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """The blocks of a scene are run serially unless the method says otherwise: the jobs are what is spread."""
    said = any(keywords.get(name) is not None for name in ("executor", "workers", "scheduler"))
    return {**keywords} if said else {**keywords, "executor": "serial"}


def times_of(made: Registration) -> dict[str, float]:
    """Stage -> seconds. Of a scene the stages of all its blocks stand under ``blocks.STAGE`` and count once."""
    times = {name: float(seconds) for name, seconds in made.timings.items()}
    inside = made.provenance.get("block_seconds")
    if not isinstance(inside, Mapping) or "blocks" not in times:
        return times
    parts = {f"{BLOCKS}.{name}": float(seconds) for name, seconds in inside.items()}
    # Blocks that ran side by side took more seconds than the clock shows.
    return times | parts | {BLOCKS: max(0.0, times[BLOCKS] - sum(parts.values()))}


def outcome(call: Callable[[], Registration | str]) -> Registration | str:
    """What `call` returns, or the first line of what it raises: one broken method must not end the comparison."""
    try:
        return call()
    except CancelledError:
        raise
    except Exception as error:
        line = (str(error).splitlines() or [""])[0]
        return f"{type(error).__name__}: {line}" if line else type(error).__name__


def detection(keywords: Mapping[str, Any], role: str) -> dict[str, Any]:
    """The keywords that decide the keypoints of one image, its mask and band under the names "mask" and "band"."""
    mask, band = keywords.get(f"{role}_mask"), bands_of(keywords)[ROLES.index(role)]
    own = {"mask": mask, "band": band}
    return of_keypoints(keywords) | {name: value for name, value in own.items() if value is not None}


def find_keypoints(image: Any, keywords: Mapping[str, Any]) -> FloatArray | None:
    """(N, 2) keypoints of an image by keywords of `detection`; None where the method has no detector."""
    with single_threaded():
        return keypoints_of(image, **keywords)
