"""What the page of a comparison holds: packed tie points, lattices and reduced pictures."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import Homography
from featreg.interfaces import FailedFit
from featreg.report import (
    ReportEntry,
)
from featreg.report import pictures as report_pictures
from featreg.report.pictures import picture
from featreg.report.tie_points import INLIER, JUDGED, SCORED, lattice, tie_points
from featreg.results.registration import Registration
from featreg.types import FloatArray, Image, Matches
from made.reported import TRUTH, registration

Make = Any
KINDS = (("rx", "<u2"), ("ry", "<u2"), ("sx", "<u2"), ("sy", "<u2"), ("dx", "<f2"), ("dy", "<f2"), ("error", "<f2"),
         ("score", "<f4"), ("lost", "u1"), ("flags", "u1"))  # fmt: skip


def unpacked(points: Any) -> dict[str, NDArray[Any]]:
    raw, at = zlib.decompress(base64.b64decode(points.packed)), 0
    found: dict[str, NDArray[Any]] = {}
    for name, kind in KINDS:
        dtype = np.dtype(kind)
        planes = np.frombuffer(raw, np.uint8, points.shown * dtype.itemsize, at).reshape(dtype.itemsize, -1)
        found[name] = np.ascontiguousarray(planes.T).view(dtype).ravel()
        at += planes.size
    assert at == len(raw)
    found["ry"] = np.cumsum(found["ry"], dtype=np.uint16)
    for k, side in enumerate("rs"):
        for axis, letter in enumerate("xy"):
            found[side + letter] = points.origins[k][axis] + points.steps[k] * found[side + letter].astype(float)
    return found


@pytest.mark.parametrize("size", [(120, 100), (30_000, 20_000)])
def test_tie_points_come_back_as_they_were(size: tuple[int, int]) -> None:
    made = registration(400, size=size)
    errors = made.model.residuals(made.matches.reference_xy, made.matches.secondary_xy) if made.model else np.zeros(0)
    errors[:10] = np.nan
    points = tie_points(ReportEntry("a", "m", 0, made), errors, 1.5, 5000)
    got = unpacked(points)
    order = np.argsort(made.matches.reference_xy[:, 1], kind="stable")
    for side, wanted, step in zip(
        "rs", (made.matches.reference_xy, made.matches.secondary_xy), points.steps, strict=True
    ):
        assert step <= max(1 / 64, max(size) * 1.2 / 65535)
        read = np.stack([got[side + "x"], got[side + "y"]], axis=1)
        np.testing.assert_allclose(read, wanted[order], atol=0.51 * step)
    np.testing.assert_allclose(got["error"], errors[order], rtol=3e-3)
    np.testing.assert_allclose(got["score"], made.matches.score[order], rtol=1e-3)
    lost = np.where(~made.stages["gms"], 1, np.where(~made.stages["ransac"], 2, 0))
    np.testing.assert_array_equal(got["lost"], lost[order])
    known = np.isfinite(errors)
    assert points.counts == {
        "scored": int((made.stages["gms"] & known).sum()),
        "correct": int((made.stages["gms"] & known & (errors <= 1.5)).sum()),
        "final": int(made.inliers.sum()),
    }
    np.testing.assert_array_equal(got["flags"] & JUDGED > 0, known[order])


def test_of_too_many_tie_points_the_scored_ones_stay() -> None:
    made = registration(300)
    made = replace(made, inliers=~made.stages["gms"])
    scored = int(made.stages["gms"].sum())
    points = tie_points(ReportEntry("a", "m", 0, made), None, 1.5, scored + 20)
    flags = unpacked(points)["flags"]
    assert (points.shown, points.total) == (scored + 20, 300)
    assert int((flags & SCORED > 0).sum()) == points.counts["scored"] == scored
    assert int((flags & INLIER > 0).sum()) == 20


def test_results_without_points_or_model_are_packed_too() -> None:
    empty = Registration(
        Matches.empty(), {"gms": np.zeros(0, np.bool_)}, np.zeros(0, np.bool_), FailedFit("none"), "ok"
    )
    assert tie_points(ReportEntry("a", "m", 0, empty), np.zeros(0), 1.5, 10).counts["scored"] == 0
    made = registration(5, model=FailedFit("too few"))
    assert np.isnan(unpacked(tie_points(ReportEntry("a", "m", 0, made), None, 1.5, 10))["dx"]).all()


def between(nodes: tuple[int, int, list[float | None]], size: tuple[int, int], xy: FloatArray) -> FloatArray:
    """Bilinear interpolation as the page does it."""
    columns, rows, values = nodes
    table = np.array([np.nan if v is None else v for v in values]).reshape(rows, columns, 2)
    uv = xy / (np.array(size) - 1) * (columns - 1, rows - 1)
    k = np.minimum(uv.astype(int), (columns - 2, rows - 2))
    a, b = (uv - k).T[:, :, None]
    i, j = k.T
    return np.asarray(
        (1 - b) * ((1 - a) * table[j, i] + a * table[j, i + 1])
        + b * ((1 - a) * table[j + 1, i] + a * table[j + 1, i + 1])
    )


def test_a_map_is_kept_as_a_lattice() -> None:
    size = (640, 480)
    xy = np.random.default_rng(0).uniform(0, np.array(size) - 1, (200, 2))
    np.testing.assert_allclose(between(lattice(TRUTH, size, affine=True), size, xy), TRUTH(xy), atol=1e-3)
    bent = Homography(np.array([[1.01, 0.02, 3], [-0.01, 0.99, -2], [1e-5, -2e-5, 1]]))
    np.testing.assert_allclose(between(lattice(bent, size, affine=False), size, xy), bent(xy), atol=0.02)
    half_known = lattice(lambda p: np.where(p[:, :1] < 300, p, np.nan), size, affine=False)
    assert any(v is None for v in half_known[2])
    assert json.dumps(half_known, allow_nan=False)


def test_a_picture_is_reduced_until_it_fits(sar_texture: Make) -> None:
    texture = sar_texture(700, 900, 0)
    image = Image(texture, np.ones(texture.shape, np.bool_))
    whole, small = picture(image, 10**9), picture(image, 20_000)
    assert whole.size == small.size == (900, 700)
    assert len(small.webp) <= 20_000 < len(whole.webp)


def test_a_large_scene_is_read_by_overview(sar_texture: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "scene.npy", sar_texture(601, 803, 0))
    monkeypatch.setattr(report_pictures, "LARGE", 1000)
    made = picture(str(tmp_path / "scene.npy"), 10**6)
    assert made.size == (803, 601)
    assert made.extent == (802, 600)
