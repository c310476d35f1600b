"""Block-based SAR-Harris: the best of each block, and so points everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.geometry import spread
from featreg.io import as_image
from featreg.simulate import sar_pair


@pytest.mark.parametrize("per_block", [1, 3])
def test_each_block_gives_its_best_points(per_block: int) -> None:
    image = as_image(sar_pair((240, 300), looks=4, seed=5).reference)
    detector = registry.create("detector", "block-sar-harris", n_features=20 * per_block, per_block=per_block)
    found = detector.detect_features(image)
    everything = registry.create("detector", "block-sar-harris", n_features=100_000).detect_features(image)

    def blocks(xy: NDArray[np.float64]) -> NDArray[np.int64]:
        x, y = np.rint(xy).astype(np.int64).T
        return np.asarray(y * 4 // 240 * 5 + x * 5 // 300)

    chosen, every = blocks(found.xy), blocks(everything.xy)
    for block in range(20):
        best = np.sort(everything.score[every == block])[::-1][:per_block]
        assert np.allclose(np.sort(found.score[chosen == block])[::-1], best)
    assert len(found) > 15 * per_block


def test_points_are_spread_where_the_strongest_are_not() -> None:
    pixels = sar_pair((256, 256), looks=4, seed=6).reference.copy()
    pixels[:, 128:] = pixels[:, 128:] ** 0.2
    image = as_image(pixels)
    even = registry.create("detector", "block-sar-harris", n_features=64).detect_features(image)
    strongest = registry.create("detector", "sar-harris", n_features=64, scales=1).detect_features(image)
    assert spread(even.xy, image.shape) > 1.5 * spread(strongest.xy, image.shape)
    assert (even.xy[:, 0] >= 128).mean() > 0.35
