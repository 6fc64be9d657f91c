"""A training run: its folder, its stages step by step, and the pictures and cards that it leaves."""
