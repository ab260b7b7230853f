"""Shared set-up: hypothesis is reproducible and prints how to repeat a failure."""

from hypothesis import settings

settings.register_profile("repo", deadline=None, print_blob=True, derandomize=True, max_examples=60)
settings.load_profile("repo")
