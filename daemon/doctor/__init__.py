"""What a user gets wrong on a real support: each thing looked at, judged, and with what to do."""
