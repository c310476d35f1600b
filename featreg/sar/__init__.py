"""SAR mathematics: plain functions of arrays and images, without any knowledge of plugins."""
