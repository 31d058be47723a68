"""Hostile files for every reader; see docs/fuzzing.md."""
