"""Many logs to answers: which files arguments name, each judged once by several workers, and the answers kept."""
