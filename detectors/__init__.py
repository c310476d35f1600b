"""Plugin room: one algorithm, one file; found by `featreg.registry`, never imported by name."""
