"""The live view at a terminal."""
