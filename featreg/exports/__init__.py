"""Tie points in the formats of other programs."""
