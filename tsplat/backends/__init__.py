"""Ways to make a frame; each module offers its rows through ``tsplat.hookspecs``."""
