"""The metrics of a comparison: pure functions of one result and the truth, by name.

Names may carry a number of pixels: ``mma@3``, ``success@1``, ``auc@5``, ``wrong@3``; and ``act.STAGE`` is the time of
one stage. A metric that has no value (no truth, no model, no keypoints) is None.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from featreg.errors import ParameterError, UnknownNameError, suggest
from featreg.geometry import spread
from featreg.interfaces import FailedFit
from featreg.results.json_file import plain
from featreg.study.case import Case
from featreg.study.evaluation import computing_time, stage_mask
from featreg.study.measures import CURVE, area_under_curve, matching_accuracy_curve


@dataclass(frozen=True)
class Metric:
    """One column of a table.

    Parameters
    ----------
    name : of the column
    meaning : one line
    function : `Case` -> value, None where there is none
    better : "higher", "lower" or "" where neither is
    if_failed : what a method that raised, hung or died gets; None for no value
    needs_truth : without a truth there is no value, whatever happened
    needs_keypoints : the keypoints of both images must be kept for it
    count : a whole number
    bounds : least and greatest possible value
    """

    name: str
    meaning: str
    function: Callable[[Case], float | None]
    better: str = ""
    if_failed: float | None = None
    needs_truth: bool = True
    needs_keypoints: bool = False
    count: bool = False
    bounds: tuple[float, float] = (0.0, float("inf"))

    def value(self, case: Case) -> Any:
        """The value as JSON has it: None for NaN."""
        return plain(self.function(case))


def metric_of(name: str) -> Metric:
    """Return a metric by name.

    Raises
    ------
    UnknownNameError
        No such metric; the text suggests the nearest.
    ParameterError
        A number of pixels that is missing or no positive number.
    """
    if name in METRICS:
        return METRICS[name]
    word, _, rest = name.partition("@")
    if name.startswith("act.") and len(name) > len("act."):
        return _time_of(name.removeprefix("act."))
    if word in FAMILIES:
        try:
            pixels = float(rest)
        except ValueError:
            pixels = 0.0
        if not 0 < pixels < float("inf"):
            raise ParameterError(f"metric '{word}' needs a number of pixels > 0, as in '{word}@3', got '{name}'")
        return replace(FAMILIES[word](pixels), name=name)
    known = [*METRICS, *(f"{family}@3" for family in FAMILIES), "act.detect"]
    raise UnknownNameError(f"unknown metric '{name}', {suggest(name, known)}")


def check_metrics(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, each of them known and only once."""
    names = (names,) if isinstance(names, str) else names
    for name in names:
        if not isinstance(name, str):
            raise ParameterError(f"a metric is a name such as 'ncm' or 'auc@3', got {name!r}")
        metric_of(name)
    return tuple(dict.fromkeys(names))


def _score(name: str) -> Callable[[Case], float | None]:
    return lambda case: None if case.scores is None else getattr(case.scores, name)


def _nm(case: Case) -> float:
    return int(stage_mask(case.registration, case.stage).sum()) if case.scores is None else case.scores.nm


def _rotation(case: Case) -> float | None:
    model = case.registration.model
    return None if isinstance(model, FailedFit) else plain(model).get("rotation_deg")


def _spread(case: Case) -> float | None:
    shape = case.shape("reference")
    if shape is None:
        return None
    return spread(case.registration.matches.reference_xy[case.registration.inliers], shape)


def _blocks(case: Case) -> float:
    return int((case.registration.provenance.get("blocks") or {}).get("total") or 1)


def _act(case: Case) -> float | None:
    return None if case.act is None else computing_time(case.act)


def _act_of_one(case: Case) -> float | None:
    """Of a scene the time of its blocks, reading and the check against the prior left out, over the blocks matched."""
    if case.act is None:
        return None
    inside = [value for name, value in case.act.items() if name.startswith("blocks.") and name not in AROUND_A_BLOCK]
    if not inside:
        return computing_time(case.act)
    counts = case.registration.provenance.get("blocks") or {}
    matched = int(counts.get("total", 1)) - int(counts.get("skipped", 0)) - int(counts.get("failed", 0))
    return sum(inside) / max(matched, 1)


def _around(case: Case) -> float | None:
    act = _act_of_one(case)
    if case.act is None or act is None:
        return None
    blocks = case.registration.provenance.get("blocks")
    if not blocks:
        return 0.0
    matched = int(blocks.get("total", 1)) - int(blocks.get("skipped", 0)) - int(blocks.get("failed", 0))
    return max(0.0, computing_time(case.act) - act * max(matched, 1))


def _recall(case: Case) -> float | None:
    if case.found_again is None or case.scores is None or not case.found_again[0]:
        return None
    return min(1.0, case.scores.ncm / case.found_again[0])


def _repeatability(case: Case) -> float | None:
    if case.found_again is None or not min(case.found_again[1:]):
        return None
    return case.found_again[0] / min(case.found_again[1:])


def _matching_score(case: Case) -> float | None:
    if case.found_again is None or case.scores is None or not min(case.found_again[1:]):
        return None
    return min(1.0, case.scores.ncm / min(case.found_again[1:]))


def _accuracy(thresholds: Sequence[float]) -> Callable[[Case], float | None]:
    return lambda case: None if case.errors is None else float(matching_accuracy_curve(case.errors, thresholds).mean())


def _success(pixels: float) -> Callable[[Case], float | None]:
    return lambda case: None if case.model_error is None else float(case.model_error <= pixels)


def _auc(pixels: float) -> Callable[[Case], float | None]:
    return lambda case: None if case.model_error is None else area_under_curve([case.model_error], pixels)


def _wrong(pixels: float) -> Callable[[Case], float | None]:
    def wrong(case: Case) -> float | None:
        if case.model_error is None:
            return None
        return float(case.registration.status == "ok" and case.model_error > pixels)

    return wrong


def _time_of(stage: str) -> Metric:
    return Metric(
        f"act.{stage}",
        f"s, computing time of stage {stage}",
        lambda case: None if case.act is None else case.act.get(stage),
        "lower",
        needs_truth=False,
    )


SHARE = (0.0, 1.0)
#: Stages of a block that are no matching.
AROUND_A_BLOCK = ("blocks.read", "blocks.prior")
_LIST = (
    Metric("nm", "matches at the scored stage", _nm, if_failed=0, needs_truth=False, count=True),
    Metric("ncm", "correct ones among them", _score("ncm"), "higher", 0, count=True),
    Metric("precision", "NCM / NM", _score("precision"), "higher", 0.0, bounds=SHARE),
    Metric("rmse", "px, over the correct matches", _score("rmse"), "lower"),
    Metric("grid_rmse", "px, model against truth on 9 x 9 points", _score("grid_rmse"), "lower"),
    Metric("inliers", "final tie points", lambda case: int(case.registration.inliers.sum()), "higher", 0,
           needs_truth=False, count=True),
    Metric("rotation_deg", "degrees, of the model, counter-clockwise", _rotation, needs_truth=False,
           bounds=(-float("inf"), float("inf"))),
    Metric("time_s", "s, sum of the stages", _act, "lower", needs_truth=False),
    Metric("act", "s, mean time of matching one block: detection to the local filter, and locating; of a whole image "
           "time_s", _act_of_one, "lower", needs_truth=False),
    Metric("around_s", "s, the rest of time_s: reading, where the blocks lie, and what is done once over all",
           _around, "lower", needs_truth=False),
    Metric("blocks", "blocks of the images that were matched", _blocks, needs_truth=False, count=True),
    Metric("spread", "share of an 8 x 8 grid's cells that hold a final tie point", _spread, "higher", 0.0,
           needs_truth=False, bounds=SHARE),
    Metric("mma", "share of matches within t px, mean over t = 1 to 10", _accuracy(CURVE), "higher", 0.0, bounds=SHARE),
    Metric("repeatability", "keypoints found in both images / the fewer of the two in the common area",
           _repeatability, "higher", needs_keypoints=True, bounds=SHARE),
    Metric("recall", "NCM / keypoints found in both images", _recall, "higher", 0.0, needs_keypoints=True,
           bounds=SHARE),
    Metric("matching_score", "NCM / the fewer keypoints of the two images in the common area", _matching_score,
           "higher", 0.0, needs_keypoints=True, bounds=SHARE),
    Metric("failed", "1 where the method raised, hung or died", lambda case: 0, "lower", 1, False, bounds=SHARE),
    Metric("refused", "1 where the result says it is not to be trusted",
           lambda case: int(case.registration.status != "ok"), if_failed=0, needs_truth=False, bounds=SHARE),
)  # fmt: skip
METRICS: Mapping[str, Metric] = {metric.name: metric for metric in _LIST}
#: Metrics of a number of pixels.
FAMILIES: Mapping[str, Callable[[float], Metric]] = {
    "mma": lambda t: Metric("mma", f"share of matches within {t:g} px", _accuracy([t]), "higher", 0.0, bounds=SHARE),
    "success": lambda t: Metric(
        "success", f"model trusted and its grid RMSE within {t:g} px", _success(t), "higher", 0.0, bounds=SHARE
    ),
    "auc": lambda t: Metric(
        "auc", f"area under the share of models with a grid RMSE within 0 to {t:g} px", _auc(t), "higher", 0.0,
        bounds=SHARE,
    ),
    "wrong": lambda t: Metric(
        "wrong", f"model trusted and its grid RMSE beyond {t:g} px", _wrong(t), "lower", 0.0, bounds=SHARE
    ),
}  # fmt: skip
#: What a table shows unless asked otherwise.
STANDARD = ("nm", "ncm", "precision", "rmse", "grid_rmse", "inliers", "rotation_deg", "time_s")


def measured(names: Sequence[str], case: Case) -> dict[str, Any]:
    """Name -> value of each metric.

    Raises
    ------
    InputError
        The truth does not fit the images, or the result lacks the stage.
    """
    return {name: metric_of(name).value(case) for name in names}


def of_failure(names: Sequence[str], *, truth: bool) -> dict[str, Any]:
    """Name -> value for a method that gave no result."""
    found = {name: metric_of(name) for name in names}
    return {name: None if m.needs_truth and not truth else m.if_failed for name, m in found.items()}
