"""Shortcuts and their price: fewer pixels, fewer Gaussians, how wrong that is, what it saves."""
