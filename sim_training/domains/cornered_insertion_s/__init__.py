"""Cornered Insertion-S: insert studded blocks that may begin in a corner of an open box."""
