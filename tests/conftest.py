"""Settings of every test: one thread, and the same examples on every run."""

import os

from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("resync", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("resync")
