"""The observed displacement: what its sensor is thought to be, and what it says of moves."""
