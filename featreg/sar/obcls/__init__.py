"""Extended targets: found by CFAR, associated, located."""
