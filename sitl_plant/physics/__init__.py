"""The physics of the plant, compiled: equations first, then the code."""
