"""Maximum index map descriptor of RIFT."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.sar.log_gabor import LogGabor
from featreg.sar.phase_congruency import STEPS, Congruency, congruency_maps
from featreg.types import Features, Image


@register("max-index-map")
@dataclass(frozen=True)
class MaxIndexMap(Descriptor):
    patch: float = 96.0
    grid: int = 6
    overlap: float = 1.0
    soft: bool = True
    least: float = 0.6
    root: float = 1.0
    weight: float = 0.0
    cellnorm: bool = False
    scales: int = 4
    orientations: int = 6
    min_wavelength: float = 3.0
    multiplier: float = 1.6
    bandwidth: float = 0.75
    noise: float = 1.0
    floor: float = 0.3

    def describe_features(self, image: Image, features: Features) -> Features:
        from featreg.sar import index_map_kernels as k

        bank = LogGabor(self.scales, self.orientations, self.min_wavelength, self.multiplier, self.bandwidth)
        largest, _, index, mask = congruency_maps(image, bank, Congruency(self.noise, floor=self.floor))
        n = len(features)
        angle = features.angle
        common = n > 0 and (angle == angle[0]).all()
        # y up angles: image x->y normal angle is clockwise
        shift = angle[0] if common else 0.0
        O = self.orientations
        value = (np.arange(256) / STEPS * O + shift * O / math.pi) % O
        votes = np.zeros((256, O + 1), np.int32)
        if self.soft:
            lo = np.floor(value).astype(int)
            w = np.rint((value - lo) * 16).astype(np.int32)
            votes[np.arange(256), lo % O] += 16 - w
            votes[np.arange(256), (lo + 1) % O] += w
        else:
            votes[np.arange(256), np.rint(value).astype(int) % O] = 16
        votes[:, O] = 16
        sums = np.empty((image.shape[0] + 1, image.shape[1] + 1, O + 1), np.int32)
        if self.weight > 0:

            top = np.quantile(largest[::7, ::7][mask[::7, ::7]], 0.95)
            wt = (
                np.clip(255 * (np.clip(largest / top, 0, 1)) ** np.float32(self.weight), 1, 255).astype(np.uint8) * mask
            )
        else:
            wt = mask.view(np.uint8)
        k.index_sums(index, wt, votes, sums)
        cell = self.patch / self.grid
        half = int(round(self.overlap * cell / 2))
        c = (np.arange(self.grid) - (self.grid - 1) / 2) * cell
        gx, gy = np.meshgrid(c, c)
        base = np.stack([gx.ravel(), gy.ravel()], 1)
        T = 72
        turns = np.zeros(n, np.int64) if common else np.rint(angle * T / (2 * math.pi)).astype(np.int64) % T
        angles = [shift] if common else [2 * math.pi * t / T for t in range(T)]
        tables = np.stack(
            [np.rint(base @ np.array([[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]])) for t in angles]
        ).astype(np.int64)
        xs, ys = np.rint(features.xy).astype(np.int64).T.copy()
        out = np.empty((n, self.grid**2, O + 1), np.float32)
        k.pooled(sums, xs, ys, tables, turns, half, out)
        area = 16 * (2 * half + 1) ** 2
        share = out[:, :, O].mean(axis=1) / area
        keep = np.flatnonzero(share >= self.least)
        hist = out[keep, :, :O]
        if not common:
            s = angle[keep] * O / math.pi
            lo = np.floor(s).astype(int)
            w = (s - lo).astype(np.float32)[:, None, None]
            idx = (np.arange(O)[None] - lo[:, None]) % O
            a = np.take_along_axis(hist, idx[:, None, :].repeat(self.grid**2, 1), 2)
            b = np.take_along_axis(hist, ((idx - 1) % O)[:, None, :].repeat(self.grid**2, 1), 2)
            hist = (1 - w) * a + w * b
        if self.cellnorm:
            hist = hist / np.maximum(hist.sum(axis=2, keepdims=True), 1)
        d = hist.reshape(len(keep), -1)
        if self.root != 1.0:
            d = d ** np.float32(self.root)
        d = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
        f = features.take(keep)
        return Features(f.xy, f.scale, f.angle, f.score, f.level, np.ascontiguousarray(d, np.float32), "l2", keep)
