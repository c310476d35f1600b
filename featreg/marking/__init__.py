"""The local page on which homologous points are marked."""
