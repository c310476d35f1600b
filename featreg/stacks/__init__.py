"""Stacks: many images on one grid, by a network of pairs that is adjusted as a whole."""
