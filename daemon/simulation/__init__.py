"""The virtual support joined to the program: live, simulated, with faults."""
