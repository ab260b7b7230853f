"""Numerics on uniform grids: alignment, Savitzky-Golay filters, spectra, percentiles. Knows no link and no log."""
