"""A training run: its folder, its stages step by step, and the pictures and cards that it leaves.

A stage turns a failure into a recovery, and dreams of it into symbols; it ends in a whole library. `learn_stages` is
the walk: `mine` -> `recover` -> `check` -> `dream` -> discover -> save.
"""
