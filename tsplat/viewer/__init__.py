"""Looking at a scene in a terminal: what keys do, what is said, and the loop that draws."""
