"""The keypoints that the blocks of a scene look at."""

from __future__ import annotations

import numpy as np

from featreg.io.source import Source
from featreg.io.window import Window
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.pipeline import Pipeline
from featreg.sar.bridging import bridged, on_sample
from featreg.scene.blocks import SPLITS, halo_of, plan_blocks, suitable_side
from featreg.scene.task import skip_reason
from featreg.types import FloatArray


def scene_keypoints(
    source: Source, pipeline: Pipeline, size: int | None = None, split: str = SPLITS[0]
) -> FloatArray | None:
    """(N, 2) keypoints of a scene, found block by block with a block's halo and budget; None without a detector.

    Parameters
    ----------
    source : the scene
    pipeline : the method, as it is assembled for blocks
    size : of a block, px; None is what suits the scene
    split : "prior" or "proportional" (blocks without halo), see `featreg.match`

    Notes
    -----
    The blocks are those of the whole scene in its own pixels. A pair's lie in the overlap only, and its secondary is
    looked at in the frame of the reference where both say where they lie, so that single points differ there.
    """
    matcher = pipeline.matcher
    if not isinstance(matcher, FeatureMatcher):
        return None
    area = Window(0, 0, source.shape[1], source.shape[0])
    halo = 0 if split == "proportional" else halo_of(matcher, pipeline.locate, pipeline.refine)
    found = [np.zeros((0, 2))]
    for block in plan_blocks(area, size or suitable_side(area, pipeline, split)):
        here = block.window.grown(halo)
        seen = bridged(source.read(here))
        if skip_reason(seen, "scene"):
            continue
        xy = matcher.keypoints(seen)
        xy = xy[on_sample(xy, seen)] + here.origin
        found.append(xy[block.window.holds(xy)])
    return np.concatenate(found)
