"""Pure estimation: records in, estimates out. No clock, no file, no event loop, no device."""
