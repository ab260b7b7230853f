"""Tools for looking at a model: sweeps, recursive and frequency-response estimates, the published models."""
