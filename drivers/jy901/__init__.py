"""WitMotion JY901: serial inertial sensor, paper B's. No data-ready line, no sample time: what arrives is stamped."""
