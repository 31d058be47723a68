"""One module per command; each has ``run(arguments) -> exit code``."""

INTERRUPTED = 130
"""The exit code of what Ctrl-C has ended."""
