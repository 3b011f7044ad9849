"""Tables and pictures of a recording for other programs and for papers."""
