"""From pictures of a printed board to where each camera is, and how far that can be trusted."""
