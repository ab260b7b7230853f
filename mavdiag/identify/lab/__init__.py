"""Tools for looking at a model: order and window sweeps, recursive and frequency-response estimates, the published models."""
