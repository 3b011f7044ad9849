"""Initial alignment and strapdown navigation (paper B): attitude of a resting inertial sensor, and what it can know."""
