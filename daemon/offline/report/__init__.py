"""A recording as one HTML file that works offline."""
