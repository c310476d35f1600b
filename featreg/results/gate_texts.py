"""What every gate measures, why its limit is where it is, what fails it and what to try, in plain words.

One entry a name: a new gate is explained by one entry more. Tests hold the tables beside the gates that
`featreg.match` and `featreg.focus` can give, and `docs/unreliable.md` beside the tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class GateText(NamedTuple):
    """One gate in plain words.

    Parameters
    ----------
    measures : what the value is
    limit : why the limit is where it is
    cause : what a value beyond it mostly comes from
    cures : what to try, most promising first
    """

    measures: str
    limit: str
    cause: str
    cures: tuple[str, ...]


OTHER_METHOD = (
    "another method: --method rift or optical-sar where the images look different, sar-sift where they are noisy"
)
SAME_GROUND = "look at both images: do they show the same ground? --plot FILE.png draws what was found"
MASK = "a mask without water, clouds, frames and layover: --mask-reference, --mask-secondary, or --nodata VALUE"
KNOWN = "a model known beforehand: --initial RESULT.json with --search-radius PX"
MORE = "more features: --n-features 20000"
STIFFER = "a model with fewer parameters: --model similarity, rigid or translation"
SOFTER = "a model that can follow: --model homography, polynomial2 or residual-field"
BLOCKS = "matching in blocks, which spreads the tie points: --block 600"
GROUND = "for georeferenced images the heights of the ground: --dem FILE or --height M; --model rpc-bias for RPCs"
SCALE = "say what the samples are: --scale amplitude, intensity or db"

TWO_MOTIONS = "register the parts that moved each by itself: --mask-reference leaves one of them"
REPEATED = "a model known beforehand, within half a period: --initial RESULT.json with --search-radius PX"

#: The gates that look for another model that explains as much, and for agreement that is not the scene.
COMPETING: Mapping[str, GateText] = {
    "rival": GateText(
        "the distinct tie points of the next best model over those of the model",
        "one model explains the scene: of pairs of one place the next best has at most a third of its tie points",
        "two motions (something moved, or relief), a repeated pattern, or a target that looks alike when it is turned",
        (TWO_MOTIONS, REPEATED, SOFTER),
    ),
    "alias": GateText(
        "how well the aligned images correlate at the best other shift, or after half a turn, over that of the model",
        "on pairs of one place the best other shift has at most 0.75 of the model's, repeated patterns 0.86 or more; "
        "where the images agree in a few places only the limit is 0.7",
        "a pattern that repeats (fields, blocks of houses, a grid), moved by a whole period, or a symmetric scene",
        (REPEATED, "larger cut-outs, with something in them that does not repeat"),
    ),
    "local": GateText(
        "the share of the image that moves otherwise than the model, together with its neighbours",
        "parts that move otherwise cover little of a pair of one place, also years apart",
        "a second motion, relief, or a model too stiff for the geometry",
        (SOFTER, TWO_MOTIONS, GROUND),
    ),
    "drift": GateText(
        "how far all windows of the aligned images move together, as a stretch, turn or shift of the whole, px",
        "on pairs of one place, also years apart, within 3 px; a model that is right in one part only leaves more",
        "tie points in one part of the image, from which the model is guessed elsewhere, or one object that all follow",
        (MORE, STIFFER, OTHER_METHOD, BLOCKS),
    ),
    "structure": GateText(
        "how far the directions of structure in the aligned images move together, px (samples where these are larger)",
        "of 202 right models of an optical and a SAR image 201 have less than 5 px, four of five wrong ones more",
        "tie points that agree by chance with a model some pixels off, as between an optical and a SAR image",
        ("another method: --method sar-dense", KNOWN, SAME_GROUND),
    ),
    "scene": GateText(
        "how well the images correlate where the model maps, in the half of the image that agrees least",
        "where both show one ground, the images correlate a little everywhere; unrelated ones do not on the average",
        "the tie points lie on a label, a frame, a legend or one object, while the scene around it disagrees",
        (SAME_GROUND, "a mask of the frame, label or legend: --mask-reference and --mask-secondary", OTHER_METHOD),
    ),
    "identical": GateText(
        "the share of tie points that stand still where pixels are identical in both images",
        "up to half: duplicates and cut-outs of one image are told apart by their surroundings, which agree",
        "frames, labels, dead pixels or a fixed pattern of the sensor, the same in both images",
        ("a mask of them: --mask-reference and --mask-secondary", SAME_GROUND),
    ),
}

#: The gates of `featreg.match` and `featreg.fit`.
REGISTRATION: Mapping[str, GateText] = {
    "inliers": GateText(
        "the final tie points, those within 6 px of each other counted once",
        "240 trials on unrelated crops gave 31 models, of 5 distinct tie points in the median and 16 at most",
        "too few tie points agree: little in common between the images, a mask that leaves little, or too few features",
        (MORE, OTHER_METHOD, MASK, STIFFER),
    ),
    "spread": GateText(
        "the share of an 8 x 8 grid over the reference whose cells hold a final tie point",
        "with fewer than 4 of 64 cells the model is known in one corner and guessed elsewhere",
        "the tie points huddle: a small overlap, one bright group of targets, or a mask",
        (BLOCKS, MORE, "cut both images to their overlap", MASK),
    ),
    "significance": GateText(
        "how many models as well supported, by tie points or by windows, chance alone would give, as a power of ten",
        "the models of 240 trials on unrelated crops reached -4.4; whoever tries many pairs needs the rest",
        "so few of so many tie points agree that chance may have made them agree",
        (SAME_GROUND, OTHER_METHOD, KNOWN, STIFFER),
    ),
    "held_out": GateText(
        "how far tie points lie from a model that was fitted without them (median), px",
        "a right model misses left-out points by their own error, well below 2 px; 3 px "
        "for sar-dense and rawg, whose windows may be 2 px off by themselves",
        "the model does not predict tie points that it has not seen: wrong ones among them, or too many parameters",
        (STIFFER, SOFTER, OTHER_METHOD),
    ),
    "uncertainty": GateText(
        "the standard error of the model over the whole image, from the errors of its tie points, px",
        "2 px show where the images are laid over each other; the models of unrelated crops had 2.9 px and more",
        "few, inaccurate or huddled tie points, which say little about the rest of the image",
        (MORE, BLOCKS, STIFFER, "refinement, where it was switched off: --refine"),
    ),
    "stability": GateText(
        "how far the model moves over the image when the tie points of one region after another are left out, px",
        "what one region moves, the cells without a tie point may move more: of 1104 results on real pairs under hard "
        "warps 18 of the 19 that were 3 to 8 px wrong lay above the limit, and 22 of the 911 within 1 px",
        "one region decides the model alone, or regions contradict each other: relief, a second motion, a false match",
        (BLOCKS, STIFFER, SOFTER, MASK),
    ),
    "distortion": GateText(
        "stretch, shear or zoom between the tie points that a translation, rigid or similarity model cannot hold, px",
        "methods of rotation without zoom state it, because their model turns by about as much as it is stretched",
        "a scene out of focus, different pixel spacings, or different geometry (slant against ground range)",
        ("--model affine", "the same projection and pixel size for both images", "--focus auto for complex images"),
    ),
    "dilution": GateText(
        "the error of the model over the image, px, for an error of one pixel at each place with tie points",
        "methods with few targets state it: their residuals are too few to tell the error",
        "few places with tie points, or places close together or on a line",
        (STIFFER, "a lower threshold of the detector, for more targets (featreg list METHOD)", MORE),
    ),
    "determinant": GateText(
        "the determinant of the model's linear part at the image centre, beside what georeferences state: negative "
        "where it mirrors",
        "two images of one ground are never mirror images, unless a file's rows or columns run backwards",
        "one image is stored mirrored (ascending against descending, slant range against a map), or chance matches",
        ("turn the mirrored image round (numpy.flip, gdal_translate) or give both their georeferencing", SAME_GROUND),
    ),
    "scale": GateText(
        "pixels of the secondary per pixel of the reference at the image centre, beside what both georeferences state",
        "between 1/2.5 and 2.5: beyond, features of one image are hardly found in the other",
        "a wrong model, or images of very different pixel size",
        ("bring both images to about the same pixel size first", KNOWN, OTHER_METHOD),
    ),
    "anisotropy": GateText(
        "the ratio of the model's largest to its smallest scale at the centre, beside what both georeferences state",
        "up to 1.5: two views of one ground rarely differ by more; chance models have 2 in the median",
        "a wrong model, or pixels that are not square (slant range, degrees far from the equator)",
        ("bring both images to square pixels of the same size", STIFFER, KNOWN),
    ),
    "prior": GateText(
        "how far the model lies from the initial one over the tie points (mean), px",
        "the search radius that was given: the result may not contradict what it was told",
        "the initial model is off by more than the search radius, or the tie points agree on something else",
        ("a larger --search-radius, where the initial model may be off", "no --initial", SAME_GROUND),
    ),
    "search": GateText(
        "how far the tie points of the blocks lie from where the prior had them searched (median), px",
        "0.6 of the search: what lies near its edge was probably cut off there",
        "the prior (geolocation, initial model or match of the overviews) is off by more than it states",
        (GROUND, "an initial model with a larger --search-radius", "whole images at once: --whole"),
    ),
    "blocks": GateText(
        "the share of the blocks with content that hold a final tie point",
        "below a tenth the scene is known at a few places only",
        "most blocks found nothing: water, change, a prior that is off, or a mask",
        (GROUND, OTHER_METHOD, "larger blocks: --block 1000", MASK),
    ),
    "block_error": GateText(
        "how far a block's own tie points lie from the model (median), in all blocks but the worst 5 %, px",
        "what the tie points of a block share is no noise: 2 px off in more than a twentieth of the blocks is a model "
        "that does not follow the ground",
        "relief, motion of the platform or a second motion that a model of this kind cannot hold",
        (GROUND, SOFTER, "displacements in place of a model where something moved"),
    ),
    "held_out_rmse": GateText(
        "how far the tie points of each half of the blocks lie from the model of the other half (RMSE), px",
        "a model that holds over the scene predicts the other half to the error of its tie points, well below 2 px; "
        "3 px for sar-dense, whose windows may be 2 px off by themselves",
        "the halves of the scene disagree: relief, wrong blocks, or a model with too many parameters",
        (GROUND, SOFTER, STIFFER),
    ),
    **COMPETING,
}

WHOLE_AXIS = "the other azimuth axis: --azimuth-axis 1 (or 0)"
BRIGHT = "a part of the scene with bright isolated targets, homogeneous clutter left out"
FOCUS_METHOD = "another method: --method auto, pga for isolated targets, legendre for low contrast"

#: The gates of `featreg.focus`.
FOCUS: Mapping[str, GateText] = {
    "pulses": GateText(
        "pulses (azimuth frequencies) that carry signal",
        "fewer than 8 cannot show how a phase runs",
        "an image of a few lines, or one that is almost empty",
        ("an image with more azimuth lines", WHOLE_AXIS),
    ),
    "cells": GateText(
        "range cells that were looked at, of at least two places in range",
        "fewer than 4 leave nothing with which to check the phase",
        "an image of a few range cells, or with everything bright in one of them",
        ("an image with more range cells", "--fraction 1 for all range cells", WHOLE_AXIS),
    ),
    "deviation": GateText(
        "the expected error of the phase, radians RMS, constant and linear part apart",
        "homogeneous speckle, which says nothing of a phase, stays above 0.6 radians; 0.25 is safely below",
        "contrast too low for the phase to be seen",
        (FOCUS_METHOD, BRIGHT, WHOLE_AXIS),
    ),
    "held out": GateText(
        "half the difference between the phases that two halves of the range cells find by themselves, radians RMS",
        "the expected error of the phase: same limit as `deviation`",
        "the halves see different phases: homogeneous speckle, an error that changes over range, a collapsed image",
        ("--range-blocks N where the error changes over range", BRIGHT, FOCUS_METHOD),
    ),
    "settled": GateText(
        "how far the phase moves when minimum entropy goes on from it, radians RMS",
        "the expected error of the phase: same limit as `deviation`",
        "the method stopped before the image was sharp",
        ("more --max-iterations", FOCUS_METHOD),
    ),
    "sharpness": GateText(
        "how much the phase of one half of the range cells sharpens the other half, nats of entropy",
        "where the image is said to become sharper, a phase that is true sharpens cells that it has not seen",
        "the phase fits the noise of its own range cells",
        (BRIGHT, "a method with fewer parameters: --method legendre", WHOLE_AXIS),
    ),
    "entropy": GateText(
        "by how much the entropy of the whole image rose, nats",
        "a right phase never blurs the image; 0.01 nats are rounding",
        "the phase sharpens the range cells that were looked at and blurs the rest",
        ("a larger --fraction of the range cells", "--range-blocks N where the error changes over range"),
    ),
    "blocks": GateText(
        "range blocks with a phase that is trusted by itself",
        "half of them: the others take the phase of their nearest trusted neighbour",
        "contrast too low in most range blocks",
        ("fewer --range-blocks", BRIGHT, FOCUS_METHOD),
    ),
}  # fmt: skip
