"""Thresholds of healthy flights: the rule, and the scores of flights that a fit did not see."""
