"""Devices and their virtual twins, side by side."""
