"""The running daemon as a live source for Foxglove and Lichtblick."""
