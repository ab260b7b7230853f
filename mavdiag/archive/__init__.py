"""An archive of logs: which files arguments name, each judged once by several workers, and the answers kept.

The pure parts are `job` (what is asked and answered) and `windows`; the edges are `paths`, `sources`, `cache`, `work`,
`pool`, `cluster`, `scan` and `tables`.
"""
