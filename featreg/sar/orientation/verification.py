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
ALPHA = 1.2
#: Fewest windows that say anything of an alignment.
LEAST_WINDOWS = 4
#: Where the first question gets no better answer than this, the others are not asked; nor where another alignment is
#: decided, which has an answer below the second, and the first round or question gets no better one than half of that.
HOPELESS, DECIDED = -2.5, -12.0
#: Most windows of a level.
MOST_WINDOWS = 64
#: Alignments whose corners lie this near to each other after the first round, as a share of the diagonal, are one.
SAME = 0.03
#: Every further start that ends at an alignment, at most three, counts as so many powers of ten.
MEETING, MOST_MEETINGS = 0.9, 3
#: Near a known alignment: samples along the longer side at most and at least, the largest displacement in samples that
#: is allowed for, and by how many more windows are correlated, so that a rank says something.
MOST_SAMPLES, LEAST_SAMPLES, NEAR_REACH, NEAR_MARGIN = 256, 128, 12, 4


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
    first: tuple[Alignment, Verified] | None = None
    for start in starts:
        one = _refined(reference, secondary, start, ROUNDS[0])
        if one is None:
            continue
        _join(groups, one, one.alignment.score, reference.shape, SAME)
        if first is None:
            first = one.alignment, _judged(reference, secondary, one, HOPELESS)
    decided = first is not None and first[1].answer <= DECIDED
    hopeless = min(HOPELESS, first[1].answer / 2) if first is not None and decided else HOPELESS
    judged: list[Verified] = []
    for group in groups:
        if first is not None and group.alignment is first[0]:
            judged.append(replace(first[1], meetings=group.meetings))
        elif decided and group.answer > hopeless:
            # What the first round says is enough of those that cannot compete with one that is decided.
            judged.append(group)
        else:
            judged.append(_judged(reference, secondary, group, hopeless))
    distinct: list[Verified] = []
    for one in sorted(judged, key=lambda one: one.answer):
        _join(distinct, one, -math.inf, reference.shape, NEAR)
    return sorted(distinct, key=lambda one: one.log10_chance)


def _join(groups: list[Verified], one: Verified, score: float, shape: tuple[int, int], near: float) -> None:
    """Add an alignment to those that differ, or count it with the one that it meets; the higher score stands."""
    for i, other in enumerate(groups):
        if one.alignment.alike(other.alignment, shape, near):
            kept = one if score > other.alignment.score else other
            groups[i] = replace(kept, meetings=one.meetings + other.meetings + 1)
            return
    groups.append(one)


def _judged(reference: Image, secondary: Image, group: Verified, hopeless: float) -> Verified:
    found: Verified | None = group
    for one in ROUNDS[1:]:
        found = None if found is None else _refined(reference, secondary, found.alignment, one)
    if found is None:
        return replace(group, answer=0.0)
    answers: list[float] = []
    for question in QUESTIONS:
        answers.append(_answer(reference, secondary, found.alignment.affine, question))
        if answers[0] > hopeless:
            break
    return replace(group, alignment=found.alignment, answer=sum(answers) / len(answers))


def _refined(reference: Image, secondary: Image, start: Alignment, one: Round) -> Verified | None:
    """The alignment after a round and what its windows said in it; None where too little of the images overlaps."""
    level = aligned(reference, secondary, start.affine, one.samples, ALPHA)
    found = correlated(level, one.side, one.reach, most=MOST_WINDOWS)
    if len(found) < LEAST_WINDOWS:
        return None
    score, within = together(found, one.rotation_deg, one.zoom, one.steps)
    return Verified(Alignment(level.moved(within), score), log10_chance(found, 1, within))


def _answer(reference: Image, secondary: Image, affine: FloatArray, question: Question) -> float:
    level = aligned(reference, secondary, affine, question.samples, ALPHA)
    found = correlated(level, question.side, question.reach, most=MOST_WINDOWS)
    return log10_chance(found, question.tolerance)


def near(reference: Image, secondary: Image, affine: FloatArray, radius: float) -> Verified | None:
    """As `verified`, of two images that an affine map (2, 3) aligns to within a radius in pixels of the secondary.

    None where the radius is too large a part of the image for windows, so that it has to be searched.
    """
    scale = Alignment(affine, 0.0).scale
    longer = max(reference.shape)
    # A strip is as large in area as a square.
    slender = math.sqrt(longer / min(reference.shape))
    samples = min(MOST_SAMPLES * slender, longer, longer * scale, NEAR_REACH * scale * longer / radius)
    if samples < LEAST_SAMPLES:
        return None
    reach = max(3, math.ceil(radius / scale * samples / longer) + 1)
    # Two ends of the image that are off by the radius against each other.
    turn = min(2 * radius / scale / longer, 0.1)
    level = aligned(reference, secondary, affine, round(samples), ALPHA)
    found = correlated(level, 32, reach + NEAR_MARGIN, most=MOST_WINDOWS)
    if len(found) < LEAST_WINDOWS:
        return None
    score, within = together(found, math.degrees(turn), turn, 5)
    return Verified(Alignment(level.moved(within), score), log10_chance(found, 1, within))
