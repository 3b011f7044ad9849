"""When a move began and stopped, out of what the inertial sensor feels."""
