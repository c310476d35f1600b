"""Whole scenes in blocks: plan, prior, workers, state on disk, and one model over all."""
