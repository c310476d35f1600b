"""Whether an alignment is more than chance: refined by its windows together, judged by each of them on its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from featreg.sar.orientation.levels import aligned
from featreg.sar.orientation.search import NEAR, Alignment
from featreg.sar.orientation.windows import correlated, log10_chance, together
from featreg.types import FloatArray, Image

#: Of the ROEWA gradients, in samples of a level.
ALPHA = 2.0
#: Fewest windows that say anything of an alignment.
LEAST_WINDOWS = 4
#: Where the first question gets no better answer than this, the others are not asked.
HOPELESS = -2.5
#: Alignments whose corners lie this near to each other after the first round, as a share of the diagonal, are one.
SAME = 0.03
#: Every further start that ends at an alignment, at most three, counts as so many powers of ten.
MEETING, MOST_MEETINGS = 0.9, 3


@dataclass(frozen=True)
class Round:
    """One round of refinement: samples along the longer side of the reference, side of a window, largest displacement
    of it, and the rotation in degrees and zoom that all have in common, up to which `steps` of each are tried.
    """

    samples: int
    side: int
    reach: int
    rotation_deg: float
    zoom: float
    steps: int


@dataclass(frozen=True)
class Question:
    """By which windows an alignment is judged; `tolerance` as in `log10_chance`."""

    samples: int
    side: int
    reach: int
    tolerance: int


#: From the steps of the search to a few tenths of a sample.
ROUNDS = (Round(160, 32, 12, 5.0, 0.09, 9), Round(256, 32, 6, 1.5, 0.025, 7))
QUESTIONS = (Question(160, 32, 12, 1), Question(256, 48, 16, 2), Question(400, 32, 12, 1))


@dataclass(frozen=True, eq=False)
class Verified:
    """An alignment as its windows have it.

    Parameters
    ----------
    alignment : refined
    answer : mean over the `QUESTIONS` of the probability, as log10, that unrelated windows agree so well with no
        displacement
    meetings : further starts that led here
    """

    alignment: Alignment
    answer: float = 0.0
    meetings: int = 0

    @property
    def log10_chance(self) -> float:
        """The answer less 0.9 for each of at most three meetings.

        A score, not a probability: an alignment was chosen for its agreement, so that unrelated images reach -5.
        """
        return self.answer - MEETING * min(self.meetings, MOST_MEETINGS)


def verified(reference: Image, secondary: Image, starts: Sequence[Alignment]) -> list[Verified]:
    """Refine alignments by their windows and say how likely the agreement of these is by chance, best first.

    Starts that end at the same alignment are one.
    """
    groups: list[Verified] = []
    for start in starts:
        first = _refined(reference, secondary, start, ROUNDS[0])
        if first is not None:
            _join(groups, Verified(first), first.score, reference.shape, SAME)
    judged: list[Verified] = []
    for one in sorted((_judged(reference, secondary, group) for group in groups), key=lambda one: one.answer):
        _join(judged, one, -math.inf, reference.shape, NEAR)
    return sorted(judged, key=lambda one: one.log10_chance)


def _join(groups: list[Verified], one: Verified, score: float, shape: tuple[int, int], near: float) -> None:
    """Add an alignment to those that differ, or count it with the one that it meets; the higher score stands."""
    for i, other in enumerate(groups):
        if one.alignment.alike(other.alignment, shape, near):
            kept = one if score > other.alignment.score else other
            groups[i] = replace(kept, meetings=one.meetings + other.meetings + 1)
            return
    groups.append(one)


def _judged(reference: Image, secondary: Image, group: Verified) -> Verified:
    alignment: Alignment | None = group.alignment
    for one in ROUNDS[1:]:
        if alignment is not None:
            alignment = _refined(reference, secondary, alignment, one)
    if alignment is None:
        return group
    answers: list[float] = []
    for question in QUESTIONS:
        answers.append(_answer(reference, secondary, alignment.affine, question))
        if answers[0] > HOPELESS:
            break
    return replace(group, alignment=alignment, answer=sum(answers) / len(answers))


def _refined(reference: Image, secondary: Image, start: Alignment, one: Round) -> Alignment | None:
    """The alignment after a round; None where too little of the images overlaps."""
    level = aligned(reference, secondary, start.affine, one.samples, ALPHA)
    found = correlated(level, one.side, one.reach)
    if len(found) < LEAST_WINDOWS:
        return None
    score, within = together(found, one.rotation_deg, one.zoom, one.steps)
    return Alignment(level.moved(within), score)


def _answer(reference: Image, secondary: Image, affine: FloatArray, question: Question) -> float:
    level = aligned(reference, secondary, affine, question.samples, ALPHA)
    return log10_chance(correlated(level, question.side, question.reach), question.tolerance)
