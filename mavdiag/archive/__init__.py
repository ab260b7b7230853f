"""Many logs to answers: which files arguments name, each judged once by several workers, and the answers kept.

The pure parts are `windows` and `figures`; the edges are `paths`, `job`, `cache`, `pool`, `cluster`, `scan`, `tables`.
"""
