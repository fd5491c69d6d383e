"""Experiences as files: inverse models, their manifests and the layout of their arrays."""
