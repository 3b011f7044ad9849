"""Accuracy on many virtual supports."""
