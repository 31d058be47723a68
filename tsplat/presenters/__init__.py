"""Ways to show a frame: ``Frame`` in, bytes out. One protocol per file."""
