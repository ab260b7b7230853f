"""Many logs to answers: which files arguments name, each judged once by several workers, and the answers kept.

`figures` is pure; the edges are `paths`, `job`, `pool`, `scan`, `tables`.
"""
