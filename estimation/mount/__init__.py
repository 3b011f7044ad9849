"""Which way the sensor sits: its axes, and how a recording tells them."""
