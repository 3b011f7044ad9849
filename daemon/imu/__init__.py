"""The inertial sensor's side: acquisition in a thread or a process."""
