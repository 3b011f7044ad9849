"""Alignment of resting sensors: recorded, live, virtual; their noise by Allan deviation."""
